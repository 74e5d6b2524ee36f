"""The orchestration job on a real cluster: valid objects, parameters, secrets, results, places."""

from __future__ import annotations

import base64
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.errors import RigelK8sError
from rigel_k8s.images.credentials import RegistryCredentials
from rigel_k8s.jobs.job import JobContext
from rigel_k8s.jobs.types.orchestration import OrchestrationJob
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.release.revisions import history
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.rigelfile.source import Span, YamlNode, node_of
from rigel_k8s.rigelfile.structure import structure
from rigel_k8s.settings import Application, Settings
from tests.support.recorder import Recorder
from tests.support.releases import down
from tests.unit.app.test_golden import CASES, make

from .conftest import inside

pytestmark = pytest.mark.cluster

PUB = "rostopic pub -r 5 chatter std_msgs/String hello"

Run = Callable[..., "Recorder"]


@pytest.fixture
def run(context: str, namespace: str, base_image: str, tmp_path: Path) -> Run:
    """Run an orchestration job in the test's namespace."""

    def call(raw: Mapping[str, Any], *, fill: bool = True, **more: Any) -> Recorder:
        images = {"ros_master_image": base_image, "image": base_image} if fill else {}
        raw = {**images, **raw}
        found = structure(node_of(raw, YamlNode({}, Span(1, 1, 1, 1))), OrchestrationOptions)
        assert not found.problems
        told = Recorder()
        beside = tmp_path / "Rigelfile"
        settings = Settings(context=context, namespace=namespace, rigelfile=beside)
        application = Application("noetic", tmp_path)
        job = JobContext("deploy", application, told, settings, raw=raw, **more)
        OrchestrationJob().run(found.draft, job)
        return told

    return call


@pytest.mark.parametrize("case", CASES)
def test_kubernetes_accepts_every_golden_shape(
    cluster: Any, multus: None, namespace: str, case: str
) -> None:
    """A server-side dry run takes each object as it is."""
    for item in make(case):
        if "namespace" in item["metadata"]:
            item["metadata"]["namespace"] = namespace
        cluster.apply(item, dry_run=True)


def test_parameters_reach_the_node_as_they_are_meant(
    cluster: Any, namespace: str, run: Run, tmp_path: Path
) -> None:
    """Lists, text that looks like a number, files; under the node's own name and namespace."""
    (tmp_path / "a.yaml").write_text("speed: 1.5\nrate: 99\n")
    node = {
        "args": PUB,
        "namespace": "robot1",
        "parameters": {"gains": [1, 2.5], "serial": "0042", "rate": 3, "deep": {"a": True}},
        "parameter_files": ["a.yaml"],
    }
    plain = {"args": PUB, "parameters": {"rate": 3, "text": "two words"}}
    run({"nodes": {"pub": node, "plain": plain}})
    found = yaml.safe_load(inside(cluster, namespace, "pub", "rosparam", "get", "/robot1/pub"))
    assert found == {
        "gains": [1, 2.5],
        "serial": "0042",
        "rate": 3,
        "deep": {"a": True},
        "speed": 1.5,
    }
    found = yaml.safe_load(inside(cluster, namespace, "pub", "rosparam", "get", "/plain"))
    assert found == {"rate": 3, "text": "two words"}
    assert "/robot1/pub" in inside(cluster, namespace, "pub", "rosnode", "list").split()


def test_a_launch_file_runs_in_its_namespace_with_its_parameters(
    cluster: Any, namespace: str, run: Run, tmp_path: Path
) -> None:
    """From a ConfigMap; arguments, namespace and parameter files reach the nodes in it."""
    text = (
        "<launch><arg name='rate'/><node pkg='rostopic' type='rostopic' name='pub' required='true'"
        " args='pub -r $(arg rate) chatter std_msgs/String hello'/></launch>"
    )
    meta = {"name": "launch", "namespace": namespace}
    cluster.create(
        {"apiVersion": "v1", "kind": "ConfigMap", "metadata": meta, "data": {"a.launch": text}}
    )
    (tmp_path / "a.yaml").write_text("speed: 1.5\n")
    node = {
        "launch": {"file": "/launch/a.launch", "args": {"rate": 7}},
        "namespace": "robot1",
        "parameter_files": ["a.yaml"],
        "volumes": [{"config_map": "launch", "mount_path": "/launch"}],
    }
    run({"nodes": {"bringup": node}})
    assert "/robot1/pub" in inside(cluster, namespace, "bringup", "rosnode", "list").split()
    assert (
        inside(cluster, namespace, "bringup", "rosparam", "get", "/robot1/speed").strip() == "1.5"
    )
    seen = inside(cluster, namespace, "bringup", "cat", "/proc/1/cmdline").split("\0")
    assert "rate:=7" in seen


def test_a_partial_job_changes_only_what_it_names(
    cluster: Any, namespace: str, run: Run, base_image: str
) -> None:
    """src.plugin's update_k8s: strategy and readiness; image, volumes and master stay."""
    args = PUB.split()
    spec = {"template": {"spec": {"containers": [{"name": "ros-app", "args": args}]}}}
    volumes = {"volumes": [{"name": "data"}]}
    run(
        {
            "application_image": base_image,
            "persistent_storage": volumes,
            "additional_k8s_params": {"application": {"spec": spec}},
        }
    )
    run(
        {"readiness": {"command": "test -d /persistent/data"}, "rolling_update": {"max_surge": 1}},
        fill=False,
    )
    live = cluster.get(ObjectRef("apps/v1", "Deployment", namespace, "rigel-k8s-application"))
    (container,) = live["spec"]["template"]["spec"]["containers"]
    assert live["spec"]["strategy"]["rollingUpdate"] == {"maxSurge": 1, "maxUnavailable": 0}
    assert container["readinessProbe"]["exec"]["command"] == ["test", "-d", "/persistent/data"]
    assert container["args"] == args
    for kind, name in (("PersistentVolumeClaim", "data-pvc"), ("Service", "ros-master")):
        assert cluster.get(ObjectRef("v1", kind, namespace, name)) is not None


def test_results_are_copied_out_of_the_application(
    cluster: Any, namespace: str, run: Run, base_image: str, tmp_path: Path
) -> None:
    """They are waited for where the job says so, and a warning where it does not."""
    script = "sleep 2; mkdir -p /tmp/out/deep; echo 42 >/tmp/out/deep/answer; exec sleep 1000"
    container = {"name": "ros-app", "command": ["/bin/sh", "-c", script]}
    spec = {"template": {"spec": {"containers": [container]}}}
    job = {
        "application_image": base_image,
        "deploy_ros_master": False,
        "readiness": "none",
        "additional_k8s_params": {"application": {"spec": spec}},
    }
    told = run({**job, "results": {"source_path": "/tmp/none"}})
    # On a busy machine the roll-out may have warnings of its own.
    assert any("/tmp/none does not exist" in text for text in told.warnings)
    run({**job, "results": {"source_path": "/tmp/out", "wait": "3m"}})
    assert (tmp_path / "results" / "out" / "deep" / "answer").read_text() == "42\n"
    with pytest.raises(RigelK8sError, match=r"does not exist in pod .* after 1 s"):
        run({**job, "results": {"source_path": "/tmp/none", "wait": "1s"}})


def test_the_pull_secret_is_written_beside_the_release(
    cluster: Any, namespace: str, run: Run, base_image: str
) -> None:
    """Pods get it, no revision has it, an unchanged one is not written again, down takes it."""
    registry = base_image.split("/")[0]
    providers = {"registry": RegistryCredentials(registry, "me", "pa55word")}
    job = {"nodes": {"pub": {"args": PUB}}}
    run(job, providers=providers)
    ref = ObjectRef("v1", "Secret", namespace, "rigel-k8s-application-registry")
    first = cluster.get(ref)
    config = json.loads(base64.b64decode(first["data"][".dockerconfigjson"]))
    assert list(config["auths"]) == [registry]
    (pod,) = cluster.list("v1", "Pod", namespace, labels={"app.kubernetes.io/name": "pub"})
    assert pod["spec"]["imagePullSecrets"] == [{"name": ref.name}]
    release = ReleaseId(namespace, "rigel-k8s-application")
    token = base64.b64encode(b"me:pa55word").decode()
    assert all(token not in json.dumps([r.objects, r.options]) for r in history(cluster, release))
    run(job, providers=providers)
    assert cluster.get(ref)["metadata"]["resourceVersion"] == first["metadata"]["resourceVersion"]
    down(cluster, release, volumes=False, report=Recorder())
    assert cluster.get(ref) is None


def test_a_digest_is_deployed_and_a_second_run_writes_nothing(
    cluster: Any, namespace: str, run: Run
) -> None:
    """The registry tells the tag's digest."""
    job = {"nodes": {"pub": {"args": PUB, "ports": [8080]}}}
    run(job)
    ref = ObjectRef("apps/v1", "Deployment", namespace, "pub")
    first = cluster.get(ref)
    assert "@sha256:" in first["spec"]["template"]["spec"]["containers"][0]["image"]
    run(job)
    assert cluster.get(ref)["metadata"]["generation"] == first["metadata"]["generation"]
    assert len(history(cluster, ReleaseId(namespace, "rigel-k8s-application"))) == 1
