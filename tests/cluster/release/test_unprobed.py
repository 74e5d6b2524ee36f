"""Nodes without a readiness probe: a crash at the start is a failure, every time."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from datetime import datetime
from typing import Any

import pytest
import yaml

from rigel_k8s.app.desired import draft
from rigel_k8s.app.generation import Texts
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.errors import RolloutFailed
from rigel_k8s.release.rollout.patience import Patience
from rigel_k8s.release.types import Desired, ReleaseId
from rigel_k8s.rigelfile import Source, structure
from rigel_k8s.rigelfile.parse import parse
from rigel_k8s.settings import Application
from tests.support.releases import deploy
from tests.support.until import until

pytestmark = pytest.mark.cluster

LIVES = (0.0, 0.15, 0.3, 0.45)  # seconds until each run's node crashes
AT_ONCE = 2
TRIES = 4  # deploys for each: on an overloaded machine a node lives longer than it says
OVERLOAD = 10  # programs that want to run, for each processor: the runtime may answer too late


def release(make: Any, name: str, command: str) -> Desired:
    """Return a release of one node whose Rigelfile says `readiness: none`."""
    node = {"readiness": "none", "command": ["sh", "-c", command]}
    said = {"ros": "none", "image": make.image, "nodes": {name: node}}
    tree, findings = parse(Source("Rigelfile", yaml.safe_dump(said)))
    assert tree is not None, findings
    found = structure(tree, OrchestrationOptions)
    assert isinstance(found.draft, OrchestrationOptions), found.problems
    drafted = draft(found.draft, ReleaseId(make.namespace, name), Application("jazzy"), Texts())
    return drafted.finish()


def seconds_lived(cluster: Any, made: Desired) -> int:
    """Return the longest life of the node, as Kubernetes stores it: between two whole seconds."""

    def lives() -> list[int]:
        found = []
        for pod in cluster.list("v1", "Pod", made.release.namespace):
            if pod["metadata"]["name"].startswith(f"{made.release.name}-"):
                for one in pod["status"].get("containerStatuses", []):
                    states = (one["state"], one.get("lastState", {}))
                    found += [state["terminated"] for state in states if "terminated" in state]
        times = [(one["startedAt"], one["finishedAt"]) for one in found]
        return [
            (datetime.fromisoformat(end) - datetime.fromisoformat(begin)).seconds
            for begin, end in times
        ]

    return max(until(lives, "end of the node"))


def test_a_crash_at_the_start_fails_the_deploy_each_time(
    cluster: Any, make: Any, report: Any
) -> None:
    """Each run: the kubelet may have seen it run, and it is Ready for a second or more."""

    def run(life: float) -> list[str]:
        for attempt in range(TRIES):
            name = f"n{life * 20:g}-{attempt}"
            made = release(make, name, f"echo the motor is off; sleep {life}; exit 3")
            try:
                deploy(made, cluster, report=report, patience=Patience(crash=5), timeout=90)
            except RolloutFailed as error:
                return [error.message, *error.details]
            lived = seconds_lived(cluster, made)
            busy = os.getloadavg()[0] > OVERLOAD * (os.cpu_count() or 1)
            assert lived > 1 or busy, f"{name} counted as ready, and ended within a second"
        raise AssertionError(f"no node ended within {life} s: the machine is overloaded")

    with ThreadPoolExecutor(AT_ONCE) as pool:
        for told in pool.map(run, LIVES):
            assert "did not become ready" in told[0]
            assert "exited with code 3" in "\n".join(told)
            assert "    the motor is off" in told


def test_a_pod_that_runs_is_not_started_anew_for_that(cluster: Any, make: Any, report: Any) -> None:
    """A release from before it had its seconds gets them, and its pods stay."""
    made = release(make, "talker", "trap 'exit 0' TERM; while true; do sleep 0.1; done")
    before = [dict(item) for item in made.objects]
    for item in before:
        item["spec"] = {k: v for k, v in item.get("spec", {}).items() if k != "minReadySeconds"}
        if not item["spec"]:
            del item["spec"]
    deploy(Desired(made.release, tuple(before)), cluster, report=report)
    own = {"app.kubernetes.io/name": "talker"}
    (first,) = cluster.list("v1", "Pod", make.namespace, labels=own)
    deploy(made, cluster, report=report)
    (second,) = cluster.list("v1", "Pod", make.namespace, labels=own)
    (live,) = cluster.list("apps/v1", "Deployment", make.namespace, labels=own)
    assert live["spec"]["minReadySeconds"] > 0
    assert second["metadata"]["uid"] == first["metadata"]["uid"]
