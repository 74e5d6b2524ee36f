"""Every error that a user can meet; it imports nothing of the package.

RigelK8sError            something went wrong (exit code 1)
├── UserError            what the user wrote is wrong (exit code 2)
│   └── ProblemsError    problems of a Rigelfile, already placed and worded (rigel_k8s.rigelfile)
├── JobFailed            a job of a sequence failed; names the job
├── ClusterError         the Kubernetes API refused or could not be reached
│   ├── ConflictError    another field manager owns fields that we want to write
│   └── NotFoundError    an object that must exist does not
├── RolloutFailed        objects were applied and did not become ready; carries the causes
├── CommandFailed        a program that we ran (docker, podman, go) failed; carries its last lines
├── LocalClusterError    the local cluster could not be built, started or ended
└── Interrupted          the user asked to stop (exit code 130)

An error says what went wrong, where, and what to do next: `message` is one line, `hint` is what to
do, `details` are further lines that help to understand (the API server's message, log lines).
The command line prints them without a traceback; anything that is not a RigelK8sError is a bug and
keeps its traceback.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence


class RigelK8sError(Exception):
    """Base of all errors a user can meet.

    Args:
        message: one line: what went wrong and where.
        hint: what to do next, one line, or None.
        details: further lines, printed indented below the message.
    """

    exit_code = 1

    def __init__(
        self, message: str, *, hint: str | None = None, details: Sequence[str] = ()
    ) -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint
        self.details = tuple(details)

    def fit_details(self, width: int) -> Sequence[str]:
        """Return the details for lines of that width, shortened if possible."""
        return self.details


class UserError(RigelK8sError):
    """What the user wrote (a Rigelfile, flags, the environment) is wrong."""

    exit_code = 2


class ProblemsError(UserError):
    """Problems of one Rigelfile; `message` counts them.

    Args:
        render: returns the problems as text, with lines of the file in that many columns.
        width: the columns of `details`, for callers that do not pass a width.
    """

    def __init__(self, message: str, render: Callable[[int], Sequence[str]], *, width: int) -> None:
        super().__init__(message, details=render(width))
        self._render = render

    def fit_details(self, width: int) -> Sequence[str]:
        """Return the problems with lines of the file in that many columns."""
        return self._render(width)


class JobFailed(RigelK8sError):
    """A job of a sequence failed; `message` names it and the cause is chained."""


class ClusterError(RigelK8sError):
    """The Kubernetes API refused a request or could not be reached."""


class ConflictError(ClusterError):
    """Another field manager owns fields that we want to write."""


class NotFoundError(ClusterError):
    """An object that must exist does not."""


class RolloutFailed(RigelK8sError):
    """Objects were applied and did not become ready; `details` are the causes."""


class CommandFailed(RigelK8sError):
    """A program that we ran failed; `details` are its last lines."""


class LocalClusterError(RigelK8sError):
    """The local cluster could not be built, started or ended."""


class Interrupted(RigelK8sError):
    """The user asked to stop."""

    exit_code = 130
