"""observe: the stack's parts at ports of this machine, its state, and its removal."""

from __future__ import annotations

import base64
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, suppress

import attrs

from rigel_k8s.commands.interruption import writing
from rigel_k8s.errors import ClusterError
from rigel_k8s.kube import Cluster, connect
from rigel_k8s.observability.names import GRAFANA
from rigel_k8s.observability.reading.stack import NoStack, find_stack
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.report import Reporter
from rigel_k8s.settings import Settings
from rigel_stack import removal as observability_removal
from rigel_stack.doors import Door, doors
from rigel_stack.password import administrator_ref

LOOK = 1.0  # seconds between two checks of the doors


@attrs.frozen
class Administrator:
    """The user of Grafana; or why the password is not known."""

    user: str = ""
    password: str = ""
    why_not: str = ""


@attrs.frozen
class Opened:
    """What is served.

    Attributes:
        urls: by the part's name.
        closed: why a part is not served, by its name.
        administrator: None without Grafana, or if its password is not requested.
    """

    namespace: str
    urls: Mapping[str, str]
    closed: Mapping[str, str]
    administrator: Administrator | None


def observe(
    settings: Settings, ports: Mapping[str, int | None], *, password: bool
) -> Iterator[Opened | str]:
    """Serve the stack's parts on this machine; yield what is served, and then messages.

    Ends when it is closed.

    Args:
        ports: the local port of each part; 0 is any, None its usual one or, if that is in use,
            any.
        password: read Grafana's.

    Raises:
        NoStack: no stack is found, or several and none is named.
        ClusterError: nothing of it can be reached.
    """
    with connect(settings) as cluster, ExitStack() as open_doors:
        stack = find_stack(cluster, settings.namespace)
        opened, closed = doors(stack, ports, open_doors)
        if not opened:
            raise ClusterError(
                f"cannot reach any part of the observability stack in {stack.namespace}",
                details=[f"{name}: {reason}" for name, reason in closed.items()],
                hint="see its state with `rigel observe status`",
            )
        wanted = password and GRAFANA in stack.services
        yield Opened(
            stack.namespace,
            {door.name: door.url for door in opened},
            closed,
            administrator(cluster, stack.namespace) if wanted else None,
        )
        yield from watch_doors(opened)


def watch_doors(opened: list[Door]) -> Iterator[str]:
    """Yield what happens to the doors, until closed."""
    while True:
        time.sleep(LOOK)
        for door in opened:
            yield from door.look()


def administrator(cluster: Cluster, namespace: str) -> Administrator:
    """Return Grafana's administrator, as far as we may read it."""
    ref = administrator_ref(namespace)
    try:
        secret = cluster.get(ref)
    except ClusterError:
        return Administrator(why_not=f"you may not read the Secret {ref.name}")
    if secret is None:
        return Administrator(why_not=f"the Secret {ref.name} does not exist")
    data = {name: base64.b64decode(text).decode() for name, text in secret["data"].items()}
    return Administrator(data.get("admin-user", ""), data.get("admin-password", ""))


def remove(settings: Settings, report: Reporter, *, volumes: bool) -> tuple[ReleaseId, int, int]:
    """Remove the stack; return its release, and how many objects were deleted and how many stayed.

    Args:
        volumes: delete its data too.

    Raises:
        NoStack: neither a stack nor its data exist.
    """
    cluster = connect(settings)
    with writing(cluster, settings, report) as options:
        namespace = settings.namespace
        with suppress(NoStack):  # its data may still exist
            namespace = find_stack(cluster, namespace).namespace
        plan = observability_removal.remove(
            cluster,
            options,
            volumes=volumes,
            namespace=namespace,
        )
    counts = [sum(step.action == action for step in plan.steps) for action in ("prune", "forget")]
    return plan.release, counts[0], counts[1]
