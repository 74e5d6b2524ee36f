"""The option `muto` of a job that deploys."""

from __future__ import annotations

from collections.abc import Mapping

import attrs

from rigel_k8s.objects.fields import option, required_field
from rigel_k8s.option_text import Scalar


@attrs.frozen(kw_only=True)
class Muto:
    """A stack of Eclipse Muto."""

    stack: str = required_field(
        "a file with a stack, from the application's directory; or the id (stackId, thingId) of a"
        " stack in one of the files there"
    )
    args: Mapping[str, Scalar] = option("values of the stack's arguments, `$(arg NAME)`", {})
    strict: bool = option("refuse a stack of which something is not carried over", default=False)


def muto_of(written: Muto | str | None) -> Muto | None:
    """Return the options; a word is short for its `stack`."""
    return Muto(stack=written) if isinstance(written, str) else written
