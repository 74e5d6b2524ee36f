"""Which containers are ready because they run, and what their logs tell of them."""

from __future__ import annotations

from typing import Any

import attrs
import pytest

from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.rollout import unprobed
from rigel_k8s.release.rollout.unprobed import LEAST, LONG, LogWatch, find_unprobed_in

TALKER = ObjectRef("apps/v1", "Deployment", "n", "talker")
PROBED = {"name": "probed", "readinessProbe": {"exec": {"command": ["true"]}}}
STARTS = {"name": "starts", "startupProbe": {"exec": {"command": ["true"]}}}


def pod(name: str, ready: str = "True", **meta: str) -> dict[str, Any]:
    containers = [PROBED, {"name": "plain"}, STARTS]
    status = {"conditions": [{"type": "Ready", "status": ready}]}
    meta = {"name": name, "uid": name, **meta}
    return {"metadata": meta, "spec": {"containers": containers}, "status": status}


def workload(kind: str = "Deployment", **spec: Any) -> dict[str, Any]:
    api_version = "batch/v1" if kind == "Job" else "apps/v1"
    meta = {"name": "talker", "namespace": "n"}
    return {"apiVersion": api_version, "kind": kind, "metadata": meta, "spec": spec}


def containers(*names: str, **spec: Any) -> list[unprobed.Unprobed]:
    return list(find_unprobed_in(workload(**spec), map(pod, names)))


@attrs.define
class Log:
    """A log that is followed."""

    seconds: float
    ended: bool = False
    settled: bool = False
    aborted: bool = False

    def abort(self) -> None:
        self.aborted = True


@attrs.define
class Runtime:
    """The logs that were opened, by pod."""

    logs: dict[str, list[Log]] = attrs.field(factory=dict)

    def follow_end(self, namespace: str, pod: str, container: str, *, seconds: float) -> Log:
        assert (namespace, container) == ("n", "plain")
        self.logs.setdefault(pod, []).append(Log(seconds))
        return self.logs[pod][-1]


@pytest.fixture
def runtime() -> Runtime:
    return Runtime()


@pytest.fixture
def watch(runtime: Runtime) -> LogWatch:
    return LogWatch(runtime)  # type: ignore[arg-type]


def test_only_what_nobody_probes_in_ready_pods_that_stay_is_asked() -> None:
    """A container with a probe speaks for itself; a Job's may end; an old pod shall."""
    pods = [pod("a"), pod("b", deletionTimestamp="2026-01-01T00:00:00Z"), pod("c", ready="False")]
    found = find_unprobed_in(workload(), pods)
    assert [(one.pod, one.container) for one in found] == [("a", "plain")]
    assert not list(find_unprobed_in(workload("Job"), pods))


def test_a_log_is_followed_while_kubernetes_waits(watch: LogWatch, runtime: Runtime) -> None:
    """Nothing is left to wait for if it has gone on long enough when all else is ready."""
    ready = containers("a", minReadySeconds=2)
    assert not watch.look(ready, 10.0, last=False)
    (log,) = runtime.logs["a"]
    assert log.seconds == LEAST
    log.settled = True
    assert not watch.look(ready, 12.0, last=False)
    assert not watch.is_sure_of(ready), "it may end until all is ready"
    assert not watch.look(ready, 12.5, last=True)
    assert watch.is_sure_of(ready)
    assert log.aborted


@pytest.mark.parametrize(("minimum", "seconds"), [(None, 0.5), (0, 0.5), (2, 1.5), (10, 9.5)])
def test_what_kubernetes_calls_available_early_is_followed_longer(
    watch: LogWatch, runtime: Runtime, minimum: int | None, seconds: float
) -> None:
    """It may wait a second less than it is told to."""
    ready = containers("a", minReadySeconds=minimum)
    watch.look(ready, 10.0, last=True)
    runtime.logs["a"][0].settled = True
    watch.look(ready, 10.0 + seconds - 0.1, last=True)
    assert not watch.is_sure_of(ready)
    watch.look(ready, 10.0 + seconds, last=True)
    assert watch.is_sure_of(ready)


def test_what_is_seen_late_is_followed_for_a_moment(watch: LogWatch, runtime: Runtime) -> None:
    ready = containers("a", minReadySeconds=2)
    watch.since[ready[0]] = 10.0
    watch.look(ready, 20.0, last=True)
    watch.look(ready, 20.1, last=True)
    assert not watch.is_sure_of(ready)


def test_a_workload_has_ended_where_one_of_its_containers_has(
    watch: LogWatch, runtime: Runtime
) -> None:
    """One of three pods is enough; it is told once, and at once."""
    ready = containers("a", "b", "c")
    watch.look(ready, 10.0, last=False)
    runtime.logs["b"][0].ended = runtime.logs["b"][0].settled = True
    assert watch.look(ready, 10.1, last=False) == {TALKER}
    assert watch.look(ready, 10.2, last=False) == set()


def test_so_many_logs_at_a_time(
    watch: LogWatch, runtime: Runtime, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The others follow when these are known."""
    monkeypatch.setattr(unprobed, "WIDTH", 2)
    ready = containers("a", "b", "c")
    watch.look(ready, 10.0, last=True)
    assert sorted(runtime.logs) == ["a", "b"]
    runtime.logs["a"][0].settled = True
    watch.look(ready, 10.5, last=True)
    assert sorted(runtime.logs) == ["a", "b", "c"]
    assert not watch.is_sure_of(ready)


def test_a_long_roll_out_does_not_read_logs_all_the_time(watch: LogWatch, runtime: Runtime) -> None:
    """A node may log much; at the end it is looked at again."""
    ready = containers("a")
    watch.look(ready, 10.0, last=False)
    runtime.logs["a"][0].settled = True
    for now in (10.0 + LONG, 11.0 + LONG):
        watch.look(ready, now, last=False)
    assert [log.aborted for log in runtime.logs["a"]] == [True]
    watch.look(ready, 12.0 + LONG, last=True)
    assert len(runtime.logs["a"]) == 2


def test_a_pod_that_is_no_longer_ready_tells_why_itself(watch: LogWatch, runtime: Runtime) -> None:
    with watch:
        watch.look(containers("a", "b"), 10.0, last=False)
        watch.look(containers("b"), 10.1, last=False)
        assert runtime.logs["a"][0].aborted
        assert not runtime.logs["b"][0].aborted
    assert runtime.logs["b"][0].aborted
