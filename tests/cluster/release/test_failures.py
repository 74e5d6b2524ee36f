"""Each way a roll-out fails, with the message that the user gets; all seen on a real cluster."""

from __future__ import annotations

from typing import Any

import attrs
import pytest

from rigel_k8s.errors import RolloutFailed
from rigel_k8s.objects.steady import SECONDS
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


def test_a_missing_image_is_told(cluster: Any, make: Any, report: Any) -> None:
    """The image is named, with the registry's own words: while it waits, and once at the end."""
    registry = make.image.partition("/")[0]
    told = failure(cluster, make, report, make.deployment(image=f"{registry}/no/such:1"))
    assert f"talker did not become ready: image {registry}/no/such:1 cannot be pulled" in told
    assert "not found" in told
    assert told.count("cannot be pulled") == 1
    assert "hint: push it, correct its name, or give the namespace a pull secret; " in told
    assert any("cannot be pulled" in state for _, state, _ in report.states)
    assert report.warnings == []


def test_an_image_name_that_is_none_is_told_at_once(cluster: Any, make: Any, report: Any) -> None:
    """There is nothing to wait for."""
    told = failure(cluster, make, report, make.deployment(image="Not//An:Image:name"))
    assert "invalid image name" in told


def test_a_crash_is_told_with_the_last_log_lines(cluster: Any, make: Any, report: Any) -> None:
    """Exit code and the container's own words, though it looks ready between two crashes."""
    node = make.deployment(command="echo the motor is off; exit 3")
    # On a machine with a load of 20 it may run for longer than the usual two seconds.
    node["spec"]["minReadySeconds"] = 10
    told = failure(cluster, make, report, node, patience=UNTIL_RESTARTED)
    assert "container node exited with code 3\n" in told
    assert "    the motor is off" in told
    assert "rigel logs talker" in told


def test_a_lack_of_memory_is_told(cluster: Any, make: Any, report: Any) -> None:
    """OOMKilled is no mere exit code 137."""
    hog = make.deployment(
        command="x=0123456789; while true; do x=$x$x; done",
        readinessProbe={"exec": {"command": ["false"]}},
        resources={"limits": {"memory": "16Mi"}},
    )
    assert "OOMKilled" in failure(cluster, make, report, hog)


def test_a_missing_key_of_a_config_map_is_told(cluster: Any, make: Any, report: Any) -> None:
    """A container that cannot be made says what it lacks, where a deploy does not look before."""
    source = {"configMapKeyRef": {"name": "config", "key": "nothing"}}
    node = make.deployment(env=[{"name": "A", "valueFrom": source}])
    told = failure(cluster, make, report, make.config(a="1"), node)
    assert f"couldn't find key nothing in ConfigMap {make.namespace}/config" in told


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
    told = failure(cluster, make, report, node, patience=attrs.evolve(HASTY, mount=3))
    assert "/no/such/device is not a character device on the machine node" in told


def test_a_node_that_is_never_ready_is_told_with_the_probes_words(
    cluster: Any, make: Any, report: Any
) -> None:
    """At the end of the time the last probe failure is the reason."""
    command = {"command": ["sh", "-c", "echo no master; exit 1"]}
    probe = {"exec": command, "periodSeconds": 1, "timeoutSeconds": 30}
    told = failure(cluster, make, report, make.deployment(readinessProbe=probe), timeout=40.0)
    assert "1 of 1 not ready within 40 s: talker" in told
    assert "Readiness probe failed: no master" in told


def test_a_failed_job_is_told(admin: Any, make: Any, report: Any) -> None:
    """A Job at its end does not get better."""
    job = {
        "apiVersion": "batch/v1",
        "kind": "Job",
        "metadata": {"name": "calibrate", "namespace": make.namespace},
        "spec": {
            "backoffLimit": 0,
            "template": {
                "spec": {
                    "restartPolicy": "Never",
                    "containers": [
                        {"name": "c", "image": make.image, "command": ["sh", "-c", "exit 4"]}
                    ],
                }
            },
        },
    }
    assert "calibrate did not succeed: failed" in failure(admin, make, report, job)


def test_what_looks_ready_between_two_crashes_is_not_ready(
    cluster: Any, make: Any, report: Any
) -> None:
    """A container without probes counts as available while it lives; its crashes count more."""
    dying = "if [ -e /state/seen ]; then sleep 3; fi; touch /state/seen; exit 1"
    volume = {"name": "state", "emptyDir": {}}
    mount = {"name": "state", "mountPath": "/state"}
    node = make.deployment(command=dying, pod={"volumes": [volume]}, volumeMounts=[mount])
    node["spec"]["minReadySeconds"] = SECONDS
    told = failure(cluster, make, report, node, patience=UNTIL_RESTARTED)
    assert "container node exited with code 1\n" in told
    [pod] = cluster.list("v1", "Pod", make.namespace)
    assert pod["status"]["containerStatuses"][0]["restartCount"] > 0


def test_a_crash_that_heals_is_no_failure(cluster: Any, make: Any, report: Any) -> None:
    """A node that ends once, as without a master, and then stays, is waited for."""
    once = (
        "if [ -e /state/seen ]; then trap 'exit 0' TERM; while true; do sleep 0.1; done; fi; "
        "touch /state/seen; exit 1"
    )
    volume = {"name": "state", "emptyDir": {}}
    mount = {"name": "state", "mountPath": "/state"}
    node = make.deployment(command=once, pod={"volumes": [volume]}, volumeMounts=[mount])
    node["spec"]["minReadySeconds"] = SECONDS
    revision = deploy(make.desired(node), cluster, report=report)
    assert revision.status == "good"
    assert any("exited with code 1" in text for text in report.warnings)
