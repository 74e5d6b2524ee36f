"""The API server's refusals, as errors with what, where and what to do next."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Literal, TypeAlias

import attrs

from rigel_k8s.errors import ClusterError, ConflictError, Interrupted, NotFoundError
from rigel_k8s.kube.answers import find_mapping, find_mappings, parse

CONFLICT = 'conflict with "'
LOGIN = "the credentials of context {context} are missing or have expired: log in again"
#: An API server's answer to an unknown path: a kind that does not exist.
NO_PATH = b"404 page not found"
SHOWN = 100  # first bytes of an answer that an error shows
#: What an answer of 403 is about: the caller ("right"), or the content of the object.
Ground: TypeAlias = Literal[
    "right", "pod-security", "quota", "no-resources", "limit-range", "policy", "other"
]
#: How Kubernetes' authorizers and admission plugins begin their reasons. The first match counts.
GROUNDS: tuple[tuple[Ground, str], ...] = (
    ("policy", r"admission webhook \"|ValidatingAdmissionPolicy '"),
    ("pod-security", r"violates PodSecurity"),
    ("quota", r"exceeded quota: "),
    ("no-resources", r"failed quota: "),
    ("limit-range", r"(maximum|minimum) [\w./-]+ usage per|limit to request ratio per"),
    ("right", r"[Uu]ser \".*\" .*?(cannot \w+ (resource|path)|is attempting to grant)"),
)
#: How an API server reports that it has no connection to a kubelet.
UNREACHED = re.compile(r"dial tcp [^ ]+: (?:connect: )?(.+)$")
#: What to do about a refusal that is not about rights, by a word of its message.
REMEDIES = (
    ("being terminated", "the namespace is being deleted: wait for its end, then run it again"),
    ("exceeded quota: ", "delete what is no longer needed, or have the quota raised"),
)
RIGHTS = "ask for the right, or use other credentials: `kubectl auth can-i --list` shows yours"


@attrs.frozen
class StatusCause:
    """One of the reasons that the API server adds to its message."""

    reason: str
    message: str
    field: str = ""

    def __str__(self) -> str:
        return f"{self.field}: {self.message}" if self.field else self.message


@attrs.frozen
class FieldConflict:
    """A field that we want to write and another manager owns."""

    manager: str
    field: str


class Refusal(ClusterError):
    """The API server refused.

    Attributes:
        status: the HTTP code, 0 if there was no answer.
        reason: Kubernetes' own word for it (`Invalid`, `AlreadyExists`), "" if it gave none.
        words: its message, "" if it gave none.
        causes: its reasons, one for each field.
        doubtful: the request was sent more than once, and an earlier one may have been carried out.
    """

    status: int = 0
    reason: str = ""
    words: str = ""
    causes: tuple[StatusCause, ...] = ()
    doubtful: bool = False


class Garbled(Refusal):
    """The answer is not valid: it is not from an API server, or was damaged on its way."""

    reason = "Garbled"


class Cancelled(Refusal, Interrupted):
    """The user asked to stop while we waited for an unreachable API server."""

    reason = "Cancelled"


class Missing(Refusal, NotFoundError):
    """The object, its namespace or its kind does not exist."""


class Forbidden(Refusal):
    """The right is missing, or the object's content is not allowed (a quota, for example).

    Attributes:
        ground: which of them.
    """

    status = 403
    ground: Ground = "right"


class Conflict(Refusal, ConflictError):
    """The object was changed meanwhile, exists already, or has fields of another manager.

    Attributes:
        fields: which fields another manager owns; empty for the other two.
    """

    fields: tuple[FieldConflict, ...] = ()


def refusal(status: int, body: bytes, what: str, *, context: str, server: str) -> Refusal:
    """Return the error for an answer of 400 or more.

    Args:
        what: the action, as a phrase: `apply Deployment robot/talker`.
        context: the kubeconfig's context, for the hint.
    """
    answer = kubernetes_status(body)
    message = str(answer.get("message") or f"HTTP status {status}")
    kinds: Mapping[int, type[Refusal]] = {403: Forbidden, 404: Missing, 409: Conflict}
    kind = kinds.get(status, Refusal) if is_of_kubernetes(body) else Refusal
    error = kind(f"cannot {what}: {message}", hint=hint(status, message, context, server))
    error.words = message
    error.status, error.reason = status, str(answer.get("reason") or "")
    error.causes = tuple(status_causes(answer))
    if isinstance(error, Forbidden):
        grounds = (ground for ground, words in GROUNDS if re.search(words, message))
        error.ground = next(grounds, "other")
    if isinstance(error, Conflict):
        error.fields = tuple(
            FieldConflict(cause.message.removeprefix(CONFLICT).partition('"')[0], cause.field)
            for cause in error.causes
            if cause.reason == "FieldManagerConflict"
        )
    return error


def is_of_kubernetes(body: bytes) -> bool:
    """Whether an error comes from an API server: a proxy's 404 does not say what is missing."""
    try:
        return isinstance(parse(body), dict)
    except ValueError:
        return body.strip() == NO_PATH


def kubernetes_status(body: bytes) -> Mapping[str, Any]:
    """Return an answer's `Status` object; any other text becomes its message."""
    try:
        answer = parse(body)
    except ValueError:
        answer = None
    if isinstance(answer, dict):
        return answer
    return {"message": " ".join(body.decode("utf-8", "replace").split())[:500]}


def status_causes(answer: Mapping[str, Any]) -> list[StatusCause]:
    """Return the causes of a `Status` object."""
    found = find_mappings(find_mapping(answer, "details"), "causes")
    words = [[str(cause.get(key, "")) for key in ("reason", "message", "field")] for cause in found]
    return [StatusCause(*three) for three in words]


def garbled_error(what: str, url: str, body: bytes, reason: str) -> Garbled:
    """Return the error for an invalid answer.

    Args:
        reason: what is wrong with it: `it is not JSON`.
    """
    shown = body[:SHOWN].decode("utf-8", "backslashreplace")
    if "/secrets" in url:
        shown = "not shown, since it may contain a secret"
    return Garbled(
        f"cannot {what}: the answer of {url} is not valid: {reason}",
        hint="check that this is the API server: a proxy or a login page may answer instead",
        details=[f"the answer has {len(body)} bytes: {shown}"] if body else [],
    )


def hint(status: int, message: str, context: str, server: str) -> str | None:
    """Return what to do about an HTTP status and its message, if that is known."""
    if status == 401:
        return LOGIN.format(context=context or "this pod") + f" (server {server})"
    if status == 403:
        return next((remedy for word, remedy in REMEDIES if word in message), RIGHTS)
    return None


def unreachable_error(what: str, reason: str, *, context: str, server: str) -> Refusal:
    """Return the error for a server that gave no answer."""
    error = Refusal(
        f"cannot {what}: the cluster at {server} does not answer: {reason}",
        hint=(
            f"context {context or 'of this pod'}: check that the cluster runs and that this machine"
            " can reach it; `rigel cluster status` shows a local one, `--context` chooses another"
        ),
    )
    error.reason = "Unreachable"
    return error


def explain_exec(error: ClusterError) -> str:
    """Return why a Python program could not be run in a pod, in few words."""
    if isinstance(error, Forbidden):
        return "commands in pods are not allowed (the right `create pods/exec` is missing)"
    if "executable file not found" in error.message or "no such file" in error.message:
        return "its image has no python3, which this needs"
    if unreached := UNREACHED.search(error.message):
        return f"the API server cannot reach its machine ({unreached[1]})"
    return error.message
