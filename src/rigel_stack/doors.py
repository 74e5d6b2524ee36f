"""Services of the stack at ports of this machine, even after their pods are replaced."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from typing import Any

from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.kube import Cluster
from rigel_k8s.objects.facts import stays_ready
from rigel_k8s.observability.names import (
    GRAFANA,
    GRAFANA_PORT,
    LOKI,
    LOKI_PORT,
    PROMETHEUS,
    PROMETHEUS_PORT,
)
from rigel_k8s.observability.reading.stack import InstalledStack

#: The parts with a page or API for users, and their usual local ports.
USUAL = {GRAFANA: GRAFANA_PORT, PROMETHEUS: PROMETHEUS_PORT, LOKI: LOKI_PORT}


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
        pod = self._ready_pod()
        meta = pod["metadata"]
        remote = target_port(self._service, pod)
        forward = self._context.enter_context(
            self._cluster.port_forward(meta["namespace"], meta["name"], {remote: port})
        )
        self._pod, self._errors = meta, forward.errors
        self.port = forward.ports[remote]

    def _is_there(self) -> bool:
        return any(pod["metadata"]["uid"] == self._pod["uid"] for pod in self._ready_pods())

    def _ready_pod(self) -> dict[str, Any]:
        for pod in self._ready_pods():
            return pod
        raise ClusterError("none of its pods is ready")

    def _ready_pods(self) -> list[dict[str, Any]]:
        labels, namespace = (
            self._service["spec"]["selector"],
            self._service["metadata"]["namespace"],
        )
        pods = self._cluster.list("v1", "Pod", namespace, labels=labels)
        return [pod for pod in pods if stays_ready(pod)]


def target_port(service: Mapping[str, Any], pod: Mapping[str, Any]) -> int:
    """Return the pod's port that a Service's first port leads to."""
    port = service["spec"]["ports"][0]
    target = port.get("targetPort", port["port"])
    for container in pod["spec"]["containers"]:
        for own in container.get("ports") or []:
            if own.get("name") == target:
                return int(own["containerPort"])
    return int(target)
