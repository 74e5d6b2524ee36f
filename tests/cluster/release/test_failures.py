"""How a roll-out fails, where the message is in the words of a kubelet or a scheduler."""

from __future__ import annotations

import re
from typing import Any

import attrs
import pytest

from rigel_k8s.errors import RolloutFailed
from rigel_k8s.release.revisions import history
from rigel_k8s.release.rollout.patience import Patience
from tests.support.releases import deploy

pytestmark = pytest.mark.cluster

#: What a busy machine may cause for a while, beside what a test is about, has its usual time.
HASTY = Patience(image=3, start=3, crash=5, unschedulable=3)
#: A container that ends is started again by then, on a busy machine too.
UNTIL_RESTARTED = attrs.evolve(HASTY, crash=15)


def failure(cluster: Any, make: Any, report: Any, *objects: Any, **more: Any) -> str:
    """Deploy what cannot become ready; return all that the user is told."""
    options = {"patience": HASTY, "timeout": 90.0, **more}
    with pytest.raises(RolloutFailed) as caught:
        deploy(make.desired(*objects), cluster, report=report, **options)
    assert history(cluster, make.release)[-1].status == "failed"
    error = caught.value
    return "\n".join([error.message, *error.details, f"hint: {error.hint}"])


def test_a_crash_is_told_with_the_last_log_lines(cluster: Any, make: Any, report: Any) -> None:
    """Exit code and the container's own words, though it looks ready between two crashes."""
    node = make.deployment(command="echo the motor is off; exit 3")
    # On a machine with a load of 20 it may run for longer than the usual two seconds.
    node["spec"]["minReadySeconds"] = 10
    told = failure(cluster, make, report, node, patience=UNTIL_RESTARTED)
    assert "container node exited with code 3\n" in told
    assert "    the motor is off" in told
    assert "rigel logs talker" in told


def test_a_pod_that_no_node_takes_is_told(cluster: Any, make: Any, report: Any) -> None:
    """The scheduler's own message."""
    pod = {"nodeSelector": {"robot": "nobody"}}
    told = failure(cluster, make, report, make.deployment(pod=pod))
    assert "no machine can run the pod: 0/" in told
    assert "node affinity/selector" in told


def test_an_unbound_claim_is_told(cluster: Any, make: Any, report: Any) -> None:
    """A storage class that is not there leaves the claim without a volume."""
    volume = {"name": "data", "persistentVolumeClaim": {"claimName": "data"}}
    user = make.deployment(pod={"volumes": [volume]})
    claim = make.claim(storage_class="nowhere")
    patience = attrs.evolve(HASTY, claim=10)  # its event comes a moment later
    told = failure(cluster, make, report, claim, user, patience=patience)
    assert "claim data has no volume" in told
    assert 'storageclass.storage.k8s.io "nowhere" not found' in told


def test_a_failed_mount_is_told(cluster: Any, make: Any, report: Any) -> None:
    """A volume that the kubelet cannot mount."""
    host = {"name": "dev", "hostPath": {"path": "/no/such/device", "type": "CharDevice"}}
    mount = [{"name": "dev", "mountPath": "/dev/motor"}]
    node = make.deployment(pod={"volumes": [host]}, volumeMounts=mount)
    told = failure(cluster, make, report, node, patience=attrs.evolve(HASTY, path=3))
    why = r'is not a character device: path "\S+" does not exist'
    assert re.search(rf"on the machine node\d, /no/such/device {why}", told)


def test_a_node_that_is_never_ready_is_told_with_the_probes_words(
    cluster: Any, make: Any, report: Any
) -> None:
    """At the end of the time the last probe failure is the reason."""
    command = {"command": ["sh", "-c", "echo no master; exit 1"]}
    probe = {"exec": command, "periodSeconds": 1, "timeoutSeconds": 30}
    told = failure(cluster, make, report, make.deployment(readinessProbe=probe), timeout=40.0)
    assert "1 of 1 not ready within 40 s: talker" in told
    assert "Readiness probe failed: no master" in told
