"""What the API server refuses, as errors that say what, where and what to do next."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import attrs

from rigel_k8s.errors import ClusterError, ConflictError, NotFoundError

CONFLICT = 'conflict with "'
LOGIN = "the credentials of context {context} are missing or have expired: log in again"
RIGHTS = "ask for the right, or use other credentials: `kubectl auth can-i --list` shows yours"


@attrs.frozen
class Cause:
    """One of the reasons that the API server gives beside its message."""

    reason: str
    message: str
    field: str = ""


@attrs.frozen
class FieldConflict:
    """A field that we want to write and another manager owns."""

    manager: str
    field: str


class Refusal(ClusterError):
    """The API server said no.

    Attributes:
        status: the HTTP code, 0 where there was no answer.
        reason: Kubernetes' own word for it (`Invalid`, `AlreadyExists`), "" if it gave none.
        causes: its reasons, one for each field.
    """

    status: int = 0
    reason: str = ""
    causes: tuple[Cause, ...] = ()


class Missing(Refusal, NotFoundError):
    """The object, its namespace or its kind is not there."""


class Forbidden(Refusal):
    """We lack the right, or what an object asks for is not allowed (a quota, say)."""

    status = 403


class Conflict(Refusal, ConflictError):
    """The object was changed meanwhile, exists already, or has fields of another manager.

    Attributes:
        fields: which fields another manager owns; empty for the other two.
    """

    fields: tuple[FieldConflict, ...] = ()


def refusal(status: int, body: bytes, what: str, *, context: str, server: str) -> Refusal:
    """Return the error for an answer of 400 or more.

    Args:
        what: what was asked, for people: `apply Deployment robot/talker`.
        context: the kubeconfig's context, for the hint.
    """
    answer = kubernetes_status(body)
    message = str(answer.get("message") or f"HTTP status {status}")
    kind = {403: Forbidden, 404: Missing, 409: Conflict}.get(status, Refusal)
    error = kind(f"cannot {what}: {message}", hint=hint(status, context, server))
    error.status, error.reason = status, str(answer.get("reason") or "")
    error.causes = tuple(causes(answer))
    if isinstance(error, Conflict):
        error.fields = tuple(
            FieldConflict(cause.message.removeprefix(CONFLICT).partition('"')[0], cause.field)
            for cause in error.causes
            if cause.reason == "FieldManagerConflict"
        )
    return error


def kubernetes_status(body: bytes) -> Mapping[str, Any]:
    """Return an answer's `Status` object; text that is none becomes its message."""
    try:
        answer = json.loads(body)
    except ValueError:
        answer = None
    if isinstance(answer, dict):
        return answer
    return {"message": body.decode("utf-8", "replace").strip()[:500]}


def causes(answer: Mapping[str, Any]) -> list[Cause]:
    """Return the causes of a `Status` object."""
    found = (answer.get("details") or {}).get("causes") or []
    return [Cause(c.get("reason", ""), c.get("message", ""), c.get("field", "")) for c in found]


def hint(status: int, context: str, server: str) -> str | None:
    """Return what to do about an HTTP status, where that is known."""
    if status == 401:
        return LOGIN.format(context=context or "this pod") + f" (server {server})"
    if status == 403:
        return RIGHTS
    return None


def unreachable_error(what: str, reason: str, *, context: str, server: str) -> Refusal:
    """Return the error for a server that gave no answer."""
    error = Refusal(
        f"cannot {what}: the cluster at {server} does not answer: {reason}",
        hint=(
            f"context {context or 'of this pod'}: is the cluster running, and is this machine in "
            "its network? `rigel cluster status` tells about a local one; `--context` names another"
        ),
    )
    error.reason = "Unreachable"
    return error
