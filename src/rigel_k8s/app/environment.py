"""The environment of a container: what ROS needs, what the network adds, what the user sets."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rigel_k8s.app.generation import GENERATIONS
from rigel_k8s.objects.overlay import simplify
from rigel_k8s.objects.podoptions import EnvVar
from rigel_k8s.objects.pods import SCRIPTS_PATH, Object
from rigel_k8s.objects.workloads import ReleaseContext
from rigel_k8s.option_text import text_of

Extra = Mapping[Any, Any] | Sequence[EnvVar]


def environment(
    defaults: Mapping[str, Object], wired: Mapping[str, Object], extra: Extra = ()
) -> list[Object]:
    """Return a container's variables; the network wins over the defaults, the user over both."""
    own = dict(entries(extra))
    env = {**defaults, **wired}
    if "ROS_HOSTNAME" in own:
        env.pop("ROS_IP", None)  # ROS_HOSTNAME wins in ROS; both would be misleading
    env |= own
    # The empty text is a value, too.
    given = ((name, source) for name, source in env.items() if None not in source.values())
    return [{"name": name, **source} for name, source in given]


def ros_variables(
    release: ReleaseContext, *, namespace: str | None = None, host_network: bool = False
) -> dict[str, Object]:
    """Return ROS' own variables; a program without ROS has none."""
    if not release.ros.nodes:
        return {}
    own = GENERATIONS[release.ros.name].variables(
        release, namespace, "status.hostIP" if host_network else "status.podIP"
    )
    return own | {"PROMPT_COMMAND": {"value": f". {SCRIPTS_PATH}/rc.sh"}}


def find_literal(extra: Extra, name: str) -> str | None:
    """Return the text that the user sets for a variable, None if it is not known here."""
    found = dict(entries(extra)).get(name, {}).get("value")
    return None if found is None else str(found)


def entries(extra: Extra) -> Iterator[tuple[str, Object]]:
    """Yield the user's variables, written as a mapping or as Kubernetes writes them."""
    if isinstance(extra, Mapping):
        for name, value in extra.items():
            yield str(name), {"value": text_of(value)}
        return
    for item in extra:
        if item.value_from is not None:
            yield str(item.name), {"valueFrom": simplify(item.value_from)}
        else:
            yield str(item.name), {"value": "" if item.value is None else text_of(item.value)}
