"""`diff` and `run` refuse the same Rigelfiles with the same words, and write nothing."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s import kube
from rigel_k8s.commands import releases, targets
from rigel_k8s.commands.rigelfiles import check
from rigel_k8s.commands.run import run
from rigel_k8s.errors import JobFailed, RigelK8sError
from rigel_k8s.settings import Settings
from tests.support.fake_cluster import FakeCluster, make_refusal
from tests.support.recorder import Recorder
from tests.support.tag_registry import serve_tags

ROOT = Path(__file__).parents[1]
FILES = sorted((ROOT / "rigelfile" / "err").glob("*.Rigelfile"))
BAD = [path for path in FILES if check(Settings(path)).errors]  # others have only warnings
RIGELFILE = """
application: {distro: noetic}
jobs:
  deploy:
    plugin: rigel_k8s.OrchestrationPlugin
    with:
      namespace: n
      deploy_ros_master: false
      image: lab/app@sha256:DIGEST
      observability: {enabled: true, grafana: {enabled: false}}
      nodes: {talker: {args: [talk], NODE}}
"""
MACHINE = {
    "apiVersion": "v1",
    "kind": "Node",
    "metadata": {
        "name": "n1",
        "labels": {"robot": "arm", "kubernetes.io/arch": "amd64", "kubernetes.io/hostname": "n1"},
    },
    "spec": {"taints": [{"key": "camera", "effect": "NoSchedule"}]},
    "status": {"allocatable": {"cpu": "4", "memory": "8Gi"}},
}
#: What is wrong with the node, as the cluster is, a word of the verdict, and what is at its place.
ON_CLUSTER = {
    "labels": ('placement: {labels: {nope: "1"}}', "no machine of the cluster has", '"1"'),
    "host": ("placement: {node: n7}", "the cluster has no machine n7; its machines are n1", "n7}"),
    "taint": ("placement: {labels: {robot: arm}}", "has a taint: n1 (camera", "{labels: {robot"),
    "cpu": (
        'tolerations: [{key: camera}], resources: {requests: {cpu: "20"}}',
        "largest machine",
        '"20"',
    ),
    "gpu": (
        "tolerations: [{key: camera}], resources: {limits: {nvidia.com/gpu: 1}}",
        "which no machine that it may run on has",
        "1}",
    ),
    "config-map": (
        "tolerations: [{key: camera}], volumes: [{config_map: nowhere, mount_path: /c}]",
        "the ConfigMap nowhere does not exist",
        "nowhere,",
    ),
    "policy": ("tolerations: [{key: camera}], env: {REFUSED: 'yes'}", "not allowed", "{args"),
}


def judge(call: Callable[[], object]) -> tuple[int, str, tuple[str, ...]] | None:
    """Return how a command refuses: its exit code, message and details; None if it does not."""
    try:
        call()
    except RigelK8sError as error:
        found = error.__cause__ if isinstance(error, JobFailed) else error
        assert isinstance(found, RigelK8sError)
        return found.exit_code, found.message, tuple(found.details)
    return None


def read_place(file: Path, details: Iterable[str]) -> str:
    """Return the text of a file from the place of the first finding on."""
    [line, column] = re.findall(rf"{file}:(\d+):(\d+):", "\n".join(details))[0]
    return file.read_text().splitlines()[int(line) - 1][int(column) - 1 :]


@pytest.fixture
def both(
    fake: FakeCluster, report: Recorder, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., Any]:
    """Return the one verdict of `diff` and `run` on a job: both(settings, name)."""
    monkeypatch.setattr(kube, "connect", lambda settings: fake)
    monkeypatch.setattr(releases, "connect", lambda settings: fake)
    monkeypatch.setattr("rigel_k8s.commands.run.require_kubeconfig", lambda *_: None)

    def call(settings: Settings, name: str) -> Any:
        fake.calls.clear()
        looked = judge(lambda: releases.diff(settings, name))
        ran = judge(lambda: run("job", name, settings, report))
        assert looked == ran
        assert fake.writes == []
        return ran

    return call


@pytest.mark.parametrize("path", BAD, ids=lambda path: path.stem)
def test_a_bad_rigelfile_is_refused_alike(both: Any, path: Path) -> None:
    """Each job that deploys, of each file with an error."""
    settings = Settings(path, timeout=0.2)
    try:
        names = targets.names(settings)
    except RigelK8sError:
        names = []
    assert all(both(settings, name) for name in names or ["deploy"])


@pytest.mark.parametrize("case", ON_CLUSTER)
def test_what_the_cluster_lacks_is_refused_alike(
    both: Any, fake: FakeCluster, tmp_path: Path, case: str
) -> None:
    """And nothing of the stack is written, which the job requests too."""
    node, words, there = ON_CLUSTER[case]

    def refuse(live: dict[str, Any], dry_run: bool) -> Any:  # noqa: FBT001
        wrong = "REFUSED" in str(live.get("spec"))
        text = "talkers are not allowed"
        return make_refusal("apply", 422, "Invalid", text) if wrong else None

    fake.store.refuse = refuse
    fake.create(MACHINE)
    file = tmp_path / "Rigelfile"
    file.write_text(RIGELFILE.replace("DIGEST", "ab" * 32).replace("NODE", node))
    code, message, details = both(Settings(file, timeout=1), "deploy")
    assert (code, "nothing was changed" in message) == (2, True)
    assert words in "\n".join(details)
    assert read_place(file, details).startswith(there)


def test_an_image_that_no_registry_has_is_refused_alike(
    both: Any, fake: FakeCluster, tmp_path: Path
) -> None:
    """Beside the machines, none of which has it."""
    fake.create({**MACHINE, "spec": {}})
    with serve_tags() as registry:
        text = RIGELFILE.replace("lab/app@sha256:DIGEST", f"{registry.host}/none:9")
        file = tmp_path / "Rigelfile"
        file.write_text(text.replace(", NODE", ""))
        code, _, details = both(Settings(file, timeout=1), "deploy")
    assert code == 2
    assert f"does not have the image {registry.host}/none:9" in "\n".join(details)
    assert read_place(file, details).startswith(f"{registry.host}/none:9")
