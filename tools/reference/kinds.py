"""docs/errors.md: exit codes, and the words that have more to explain than a message has."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from rigel_k8s.kinds import KUBECTL, PODS, Kind
from rigel_k8s.release.rollout.causes import CAUSES
from rigel_k8s.release.rollout.patience import Patience
from rigel_multus.preflight.checks import KINDS
from tools.reference.tables import draw_table, join_page

HEAD = """# Errors and warnings

A message names the value, the place and what to do. The kind stands in brackets behind it, and is
the same for all messages of one sort, for scripts.

```
Rigelfile:15:24: unknown key "apart_form", did you mean "apart_from"? [unknown-key]
```

`rigel check` reports all of a file's problems at once; a warning begins with `warning:` and does
not stop a command. This page has what messages have no room for, and is generated from the code.
`rigel explain crash` prints the same in a terminal.

In the output of `-o json`, a problem of a cluster or a graph is
`{kind, message, remedy, severity, path, subjects}`: `severity` is `error` or `warning`, `subjects`
are the pods, nodes or machines that it is about, and `path` is where in the output it is, if that
is a single place."""

#: What the exit codes of `rigel` mean. A command that runs another one (`exec`) passes its code on.
EXIT_CODES: Mapping[int, Kind] = {
    0: Kind("everything that was requested is done", ""),
    1: Kind(
        "something failed on the cluster or in another program, or something is not ready",
        "read the cause and the hint below it; the same command continues where this one ended",
    ),
    2: Kind(
        "the Rigelfile, an argument or a setting is wrong",
        "change what the message names, then run the command again",
    ),
    130: Kind(
        "the command was interrupted by Ctrl-C (SIGINT)",
        "run it again; it prints what state it left",
    ),
    143: Kind("the command was ended by SIGTERM", "the same"),
}

EXITS = """Some commands differ. `status`, `graph` and `doctor` also exit with 1 if they report
that something is wrong. `diff --exit-code` exits with 0 if nothing would change, with 1 if
something would, and with 2 after any error. `exec` exits with the code of the command that it
ran."""

NOT_READY = """What `rigel run` and `rigel status` report about a workload that is not ready. A
deploy shows a cause as the workload's state, and gives up when the cause lasts for the time in the
last column. A cause that passes before becomes a warning. A workload that has no cause and does
not become ready fails at `--timeout`."""

PROBE = """If the message is a line of the readiness probe,
[this list](runbooks/RosNodeGone.md#the-lines-of-a-probe) explains it.
[A robot is offline](offline.md) describes a machine that Kubernetes cannot reach."""

NETWORK = """What [the checks before a deploy](network-modes.md#checks-before-a-deploy) find on
the cluster and its machines. If a problem needs a change of the Rigelfile, the exit code is 2,
otherwise 1; a warning stops nothing. Each message has its remedy."""


def write_kinds() -> str:
    """Return the page."""
    return join_page(_list_parts())


def _list_parts() -> Iterator[str]:
    yield HEAD
    yield "## Exit codes"
    yield _draw("code", {str(code): kind for code, kind in EXIT_CODES.items()})
    yield EXITS
    yield "## Not ready"
    yield NOT_READY
    yield _draw_causes()
    yield PROBE
    yield "The `kind` of a pod in `rigel status -o json` is one of these, or:"
    yield _draw("kind", PODS)
    yield "`kubectl get pods` has words of its own, which `rigel explain` takes, too:"
    yield _draw("word", KUBECTL)
    yield "## The network of a release"
    yield NETWORK
    yield draw_table(
        ("kind", "cause", "to change", "found by"),
        ((f"`{k.name}`", k.cause, k.changes, k.found_by) for k in KINDS.values()),
    )


def _draw(what: str, kinds: Mapping[str, Kind]) -> str:
    rows = ((f"`{name}`", kind.cause, kind.remedy) for name, kind in kinds.items())
    return draw_table((what, "cause", "remedy"), rows)


def _draw_causes() -> str:
    rows = (
        (f"`{name}`", kind.cause, kind.remedy, _describe_patience(name))
        for name, kind in CAUSES.items()
    )
    return draw_table(("kind", "cause", "remedy", "a deploy gives up after"), rows)


def _describe_patience(name: str) -> str:
    patience = Patience()
    if name == "restarted":
        return "-"
    seconds = patience.of(name)
    if name == "crash":
        return f"{seconds:g} s without other progress, {patience.crash_limit:g} s at most"
    if seconds == float("inf"):
        return "`--timeout`"
    return f"{seconds:g} s" if seconds else "at once"
