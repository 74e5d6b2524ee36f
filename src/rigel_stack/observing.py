"""observe: services of the stack at ports of this machine, even after their pods are replaced."""

from __future__ import annotations

import base64
import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from typing import Any

import attrs

from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.kube import Cluster, connect
from rigel_k8s.objects.facts import stays_ready
from rigel_k8s.observability.names import (
    GRAFANA,
    GRAFANA_PORT,
    LOKI,
    LOKI_PORT,
    PROMETHEUS,
    PROMETHEUS_PORT,
)
from rigel_k8s.observability.reading.stack import InstalledStack, find_stack
from rigel_k8s.settings import Settings
from rigel_stack.password import administrator_ref

LOOK = 1.0  # seconds between two checks of the doors
#: The parts with a page or API for users, and their usual local ports.
USUAL = {GRAFANA: GRAFANA_PORT, PROMETHEUS: PROMETHEUS_PORT, LOKI: LOKI_PORT}


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


class Door:
    """A local port that leads to a ready pod of a Service."""

    def __init__(self, cluster: Cluster, service: Mapping[str, Any]) -> None:
        self._cluster = cluster
        self._service = service
        self._context = ExitStack()
        self._errors: list[str] = []
        self._away = False
        self._pod: Mapping[str, Any] = {}
        self.name: str = service["metadata"]["name"]
        self.port = 0

    @property
    def url(self) -> str:
        """Its address on this machine."""
        return f"http://127.0.0.1:{self.port}"

    def open(self, port: int | None) -> None:
        """Listen on a local port; None is the usual one or, if that is taken, any.

        Raises:
            UserError: the port is taken.
            ClusterError: no pod is ready.
        """
        if port is not None:
            return self._listen(port)
        try:
            self._listen(USUAL[self.name])
        except UserError:
            self._listen(0)

    def close(self) -> None:
        """Stop listening."""
        self._context.close()

    def look(self) -> Iterator[str]:
        """Connect to another pod if this one has ended; yield what has happened."""
        if not self._errors and not self._away:
            return
        errors, self._errors[:] = list(self._errors), []
        if not self._away and self._is_there():
            yield from (f"{self.name}: {text}" for text in errors)
            return
        self.close()
        try:
            self._listen(self.port)
        except (ClusterError, UserError) as error:
            if not self._away:
                yield f"{self.name} is unreachable: {error.message}"
            self._away = True
        else:
            self._away = False
            yield f"{self.name} is reachable again at {self.url}, in {self._pod['name']}"

    def _listen(self, port: int) -> None:
        pod = next(iter(self._ready_pods()), None)
        if pod is None:
            raise ClusterError("none of its pods is ready")
        meta = pod["metadata"]
        remote = target_port(self._service, pod)
        forward = self._context.enter_context(
            self._cluster.port_forward(meta["namespace"], meta["name"], {remote: port})
        )
        self._pod, self._errors = meta, forward.errors
        self.port = forward.ports[remote]

    def _is_there(self) -> bool:
        return any(pod["metadata"]["uid"] == self._pod["uid"] for pod in self._ready_pods())

    def _ready_pods(self) -> list[dict[str, Any]]:
        labels, namespace = (
            self._service["spec"]["selector"],
            self._service["metadata"]["namespace"],
        )
        pods = self._cluster.list("v1", "Pod", namespace, labels=labels)
        return [pod for pod in pods if stays_ready(pod)]


def doors(
    stack: InstalledStack, ports: Mapping[str, int | None], opened: ExitStack
) -> tuple[list[Door], dict[str, str]]:
    """Open all parts that exist; return them, and why others are closed.

    Raises:
        UserError: a requested port is taken.
    """
    found, closed = [], {}
    for name in USUAL:
        if name not in stack.services:
            continue
        door = Door(stack.cluster, stack.services[name])
        opened.callback(door.close)
        try:
            door.open(ports.get(name))
        except ClusterError as error:
            closed[name] = error.message
        else:
            found.append(door)
    return found, closed


def target_port(service: Mapping[str, Any], pod: Mapping[str, Any]) -> int:
    """Return the pod's port that a Service's first port leads to."""
    port = service["spec"]["ports"][0]
    target = port.get("targetPort", port["port"])
    for container in pod["spec"]["containers"]:
        for own in container.get("ports") or []:
            if own.get("name") == target:
                return int(own["containerPort"])
    return int(target)
