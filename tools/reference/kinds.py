"""docs/errors.md: exit codes, and every kind of problem with its cause and its remedy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from rigel_k8s.discovery.kinds import GRAPH
from rigel_k8s.kinds import EXIT_CODES, KUBECTL, PODS, PROBLEMS, Kind
from rigel_k8s.network.preflight.kinds import PREFLIGHT, PreflightKind
from rigel_k8s.release.rollout.kinds import CAUSES
from rigel_k8s.release.rollout.patience import Patience
from rigel_k8s.rosgraph.kinds import ROS_GRAPH
from rigel_muto.agent.kinds import REFUSALS
from tools.reference.tables import draw_table, join_page

HEAD = """# Errors and warnings

Every kind of problem that `rigel` reports, with its cause and its remedy. A message names the
value and the place; the kind stands in brackets behind it, and is the same for all messages of
one sort. This page is generated from the code.

```
Rigelfile:15:24: unknown key "apart_form", did you mean "apart_from"? [unknown-key]
```

`rigel explain unknown-key` prints the same in a terminal."""

EXITS = """Some commands differ. `status`, `graph` and `doctor` also exit with 1 if they report
that something is wrong. `diff --exit-code` exits with 0 if nothing would change, with 1 if
something would, and with 2 after any error. `exec` exits with the code of the command that it
ran."""

RIGELFILE = """`rigel check` reports all of a file's problems at once. A warning begins with
`warning:` and does not stop a command. Kinds that begin with `unknown-` often come with the
nearest name that exists."""

NOT_READY = """What `rigel run` and `rigel status` report about a workload that is not ready. A
deploy shows a cause as the workload's state, and gives up when the cause lasts for the time in the
last column: the error then has the cause and its remedy. A cause that passes before becomes a
warning. A workload that has no cause and does not become ready fails at `--timeout`."""

PROBE = """If the message is a line of the readiness probe, [Probes](probes.md) explains it.
[A robot is offline](offline.md) describes a machine that Kubernetes cannot reach."""

NETWORK = """What [the checks before a deploy](preflight.md) find on the cluster and its
machines. If a problem needs a change of the Rigelfile, the exit code is 2, otherwise 1; a
warning stops nothing."""

DDS = """What [the checks after a deploy](graph.md) and `rigel status` find between the pods of
ROS 2 and DDS applications."""

ROS = """What [`rigel graph`](rosgraph.md) finds. It exits with 1 for each of these except
`no-publisher`. If it reports none of them and a ROS 1 node receives nothing, see
[why a ROS 1 node hears nothing](ros1-hears-nothing.md)."""

AGENT = """Why [Muto's agent](muto-agent.md) refuses a message. Nothing is deployed; the sender
gets the message."""


def write_kinds() -> str:
    """Return the page."""
    return join_page(_list_parts())


def _list_parts() -> Iterator[str]:
    yield HEAD
    yield "## Exit codes"
    yield _draw("code", {str(code): kind for code, kind in EXIT_CODES.items()})
    yield EXITS
    yield "## In a Rigelfile or a stack"
    yield RIGELFILE
    for title, kinds in PROBLEMS.items():
        yield f"### {title}"
        yield _draw("kind", kinds)
    yield "## Not ready"
    yield NOT_READY
    yield _draw_causes()
    yield PROBE
    yield "Two of them are also the `kind` of a pod in `rigel status -o json`:"
    yield _draw("kind", PODS)
    yield "`kubectl get pods` has words of its own, which `rigel explain` takes, too:"
    yield _draw("word", KUBECTL)
    yield "## The network of a release"
    yield NETWORK
    for title, found in PREFLIGHT.items():
        yield f"### {title}"
        yield _draw_preflight(found)
    yield "## The DDS graph"
    yield DDS
    yield _draw("kind", GRAPH)
    yield "## The ROS graph"
    yield ROS
    yield _draw("kind", ROS_GRAPH)
    yield "## Muto's agent"
    yield AGENT
    yield _draw("kind", REFUSALS)


def _draw(what: str, kinds: Mapping[str, Kind]) -> str:
    rows = ((f"`{name}`", kind.cause, kind.remedy) for name, kind in kinds.items())
    return draw_table((what, "cause", "remedy"), rows)


def _draw_preflight(kinds: Mapping[str, PreflightKind]) -> str:
    rows = (
        (f"`{name}`", kind.cause, kind.remedy, kind.changes, kind.found_by)
        for name, kind in kinds.items()
    )
    return draw_table(("kind", "cause", "remedy", "to change", "found by"), rows)


def _draw_causes() -> str:
    rows = ((kind.cause, kind.remedy, _describe_patience(name)) for name, kind in CAUSES.items())
    return draw_table(("cause", "remedy", "a deploy gives up after"), rows)


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
