"""What `anonymous` does to updates, and what its absence does to names, unlike a user expects."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePosixPath

from rigel_k8s.app.options import NodeOptions
from rigel_k8s.app.programs import SHELLS, find_program, full_name
from rigel_k8s.app.updating import find_clash, is_rolling
from rigel_k8s.generation import Generation
from rigel_k8s.objects.podoptions import Volume
from rigel_k8s.problems import Problem

#: Subcommands of `ros2` that start a user's own nodes.
STARTERS = ("run", "launch")


def check_anonymous(
    key: str, node: NodeOptions, ros: Generation, volumes: Mapping[str, Volume]
) -> Iterator[Problem]:
    """Yield a warning of two pods at once, or of a name that no node has.

    Args:
        key: the node's key in `nodes`.
        ros: the node's own.
        volumes: the release's persistent volumes, by name.
    """
    line = find_program(ros, node) if ros.nodes else []
    if node.anonymous:
        yield from check_update(node, find_clash(node, volumes) or find_group(line))
    elif line[:1] == ["ros2"] and line[1:] and line[1] not in STARTERS:
        message = (
            f"no ROS node is called {full_name(key, node)}, since ros2 {line[1]} names its node"
            " itself: set anonymous: true, with update: {strategy: Recreate} if two pods must not"
            " run at once"
        )
        path = "command" if node.command is not None else "args"
        yield Problem((path,), message, "own-name", severity="warning", at_key=True)


def check_update(node: NodeOptions, reason: str | None) -> Iterator[Problem]:
    """Yield that an anonymous node's default update runs two pods that disturb each other.

    Args:
        reason: why two of them do; None if they do not.
    """
    update = node.update
    if reason is None or is_rolling(update) or (update is not None and update.strategy):
        return
    if node.replicas is not None and node.replicas > 1:
        return
    message = (
        f"the node is anonymous, so an update runs its old and its new pod at once, but {reason}:"
        " set update: {strategy: Recreate}, or {strategy: Rolling} if two pods may run at once"
    )
    yield Problem(("anonymous",), message, "two-at-once", severity="warning", at_key=True)


def find_group(line: Sequence[str]) -> str | None:
    """Return what a command line starts that is more than one node."""
    name = PurePosixPath(line[0]).name if line else ""
    if name == "roslaunch" or (name == "ros2" and line[1:2] == ["launch"]):
        return "each pod starts all nodes of the launch file"
    return f"each pod starts all that {name} starts" if name in SHELLS else None
