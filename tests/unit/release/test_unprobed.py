"""Which containers are ready because they run, and which workloads a look finds ended."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import attrs

from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.rollout.standing import find_ended, find_unprobed_in

TALKER = ObjectRef("apps/v1", "Deployment", "n", "talker")
JOB = ObjectRef("batch/v1", "Job", "n", "calibrate")
PROBED = {"name": "probed", "readinessProbe": {"exec": {"command": ["true"]}}}
STARTS = {"name": "starts", "startupProbe": {"exec": {"command": ["true"]}}}


def pod(name: str, **meta: str) -> dict[str, Any]:
    containers = [PROBED, {"name": "plain"}, STARTS]
    return {"metadata": {"name": name, "uid": name, **meta}, "spec": {"containers": containers}}


@attrs.frozen
class Runtime:
    """What container runtimes say of the containers that have ended."""

    gone: frozenset[str]

    def runs(self, namespace: str, pod: str, container: str, *, seconds: float) -> bool:
        assert (namespace, container) == ("n", "plain")
        return pod not in self.gone

    def parallel(self, function: Callable[..., Any], items: Iterable[Any], *, width: int) -> Any:
        return list(map(function, items))


def test_only_what_nobody_probes_in_pods_that_stay_is_asked() -> None:
    """A container with a probe speaks for itself; a Job's may end; an old pod shall."""
    pods = [pod("a"), pod("b", deletionTimestamp="2026-01-01T00:00:00Z")]
    assert [(one.pod, one.container) for one in find_unprobed_in(TALKER, pods)] == [("a", "plain")]
    assert not list(find_unprobed_in(JOB, pods))


def test_a_workload_has_ended_where_one_of_its_containers_has() -> None:
    """One of three pods is enough."""
    found = list(find_unprobed_in(TALKER, [pod("a"), pod("b"), pod("c")]))
    assert find_ended(Runtime(frozenset({"b"})), found) == {TALKER}  # type: ignore[arg-type]
    assert find_ended(Runtime(frozenset()), found) == set()  # type: ignore[arg-type]
