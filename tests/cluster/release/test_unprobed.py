"""Nodes without a readiness probe: a crash at the start is a failure, every time."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
import yaml

from rigel_k8s.app.desired import draft
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.errors import RolloutFailed
from rigel_k8s.generation import Texts
from rigel_k8s.release.rollout.patience import Patience
from rigel_k8s.release.types import Desired, ReleaseId
from rigel_k8s.rigelfile import Source, structure
from rigel_k8s.rigelfile.parse import parse
from rigel_k8s.settings import Application
from tests.support.releases import deploy

pytestmark = pytest.mark.cluster

LIVES = (0.0, 0.15, 0.3, 0.45)  # seconds until each run's node crashes
AT_ONCE = 2  # a machine that is overloaded starts programs later than it says


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


def test_a_crash_at_the_start_fails_the_deploy_each_time(
    cluster: Any, make: Any, report: Any
) -> None:
    """Each run: the kubelet may have seen it run, and it is Ready for a second or more."""

    def run(life: float) -> list[str]:
        made = release(make, f"n{life * 20:g}", f"echo the motor is off; sleep {life}; exit 3")
        with pytest.raises(RolloutFailed, match="did not become ready") as caught:
            deploy(made, cluster, report=report, patience=Patience(crash=5), timeout=90)
        return [caught.value.message, *caught.value.details]

    with ThreadPoolExecutor(AT_ONCE) as pool:
        for told in pool.map(run, LIVES):
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
