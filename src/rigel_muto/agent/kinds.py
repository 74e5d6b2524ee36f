"""What each kind of refusal of Muto's agent means; docs/errors.md is generated from it."""

from __future__ import annotations

from collections.abc import Mapping

from rigel_k8s.kinds import Kind

REFUSALS: Mapping[str, Kind] = {
    "malformed": Kind(
        "the message is not what its protocol requires", "correct what the answer names"
    ),
    "too-large": Kind("the payload exceeds 1 MiB, or has too many components", "split the stack"),
    "not-a-stack": Kind("the message has no stack, or several ones", "send one stack"),
    "unknown-command": Kind("the command does not exist", "use `start`, `apply` or `kill`"),
    "unsupported": Kind(
        "the message is for another device, or requests what the agent does not do",
        "do not send it",
    ),
}
