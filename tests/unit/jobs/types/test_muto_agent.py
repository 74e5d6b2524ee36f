"""The job that deploys Muto's agent."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s import kube
from rigel_k8s.app.rights import PURPOSES, read_rights
from rigel_k8s.commands.rigelfiles import check
from rigel_k8s.errors import ProblemsError
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.objects.rights import find_missing
from rigel_k8s.rigelfile import load
from rigel_k8s.settings import Settings
from rigel_muto.agent.options import MutoAgent
from rigel_muto.job import check_fit
from tests.support.fake_cluster import FakeCluster
from tests.support.recorder import Recorder
from tests.support.running import run_job

AGENT = {"thing": "org:robot", "broker": "mqtt://mosquitto", "job": "deploy", "namespace": "n"}


@pytest.fixture
def run(
    fake: FakeCluster, report: Recorder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., None]:
    """Deploy an agent for a job with these options."""
    monkeypatch.setattr(kube, "connect", lambda settings: fake)
    monkeypatch.setenv("IMAGE", "lab/robot:1")

    def call(plugin: str = "rigel_k8s.OrchestrationPlugin", **options: Any) -> None:
        jobs = {
            "deploy": {"plugin": plugin, "with": {"image": "{{ vars.IMAGE }}", **options}},
            "agent": {"plugin": "rigel_k8s.MutoAgentPlugin", "with": AGENT},
        }
        file = tmp_path / "Rigelfile"
        file.write_text(json.dumps({"application": {"distro": "noetic"}, "jobs": jobs}))
        settings = Settings(rigelfile=file, timeout=60)
        run_job(load(file), "agent", settings=settings, report=report)

    return call


def test_an_agent_has_a_rigelfile_with_the_one_job(
    run: Any, fake: FakeCluster, report: Recorder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It can be read where the variables of this machine are not set."""
    run(ros_master_uri="http://robot:11311")
    text = fake.objects[ObjectRef("v1", "ConfigMap", "n", "muto-agent")]["data"]["Rigelfile"]
    monkeypatch.delenv("IMAGE")
    (tmp_path / "inside").write_text(text)
    found = load(tmp_path / "inside")
    assert list(found.jobs) == ["deploy"]
    assert json.loads(text)["jobs"]["deploy"]["with"]["image"] == "lab/robot:1"
    assert report.lines[-1] == "muto-agent in n accepts commands for org:robot"


def test_an_agent_may_deploy_into_its_namespace(run: Any, fake: FakeCluster) -> None:
    """It is what `rigel rbac deployer` prints, for its own account alone."""
    run()
    rbac = "rbac.authorization.k8s.io/v1"
    role = fake.objects[ObjectRef(rbac, "Role", "n", "muto-agent")]
    assert find_missing(read_rights(PURPOSES["deployer"], "n"), role["rules"]) == []
    binding = fake.objects[ObjectRef(rbac, "RoleBinding", "n", "muto-agent")]
    subject = {"kind": "ServiceAccount", "name": "muto-agent", "namespace": "n"}
    assert binding["subjects"] == [subject]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"plugin": "rigel_k8s.DockerfilePlugin"}, 'no orchestration job "deploy"'),
        ({"nodes": {"a": {"args": "a", "parameter_files": ["a.yaml"]}}}, "parameter_files"),
        ({"nodes": {"a": {"args": "a", "files": {"/a": "a"}}}}, "has files"),
        ({"deployment_name": "muto-agent"}, "a kill would remove the agent"),
        ({"orchestration": {"nodes": {"a": {"parameter_files": ["a.yaml"]}}}}, "parameter_files"),
    ],
)
def test_a_job_that_no_pod_could_run_is_refused(
    run: Any, fake: FakeCluster, tmp_path: Path, options: dict[str, Any], words: str
) -> None:
    """By a check of the file, and before a run begins."""
    with pytest.raises(ProblemsError) as refused:
        run(**options)
    assert words in "".join(refused.value.details)
    assert fake.writes == []
    assert any(words in one.message for one in check(Settings(tmp_path / "Rigelfile")).errors)


@pytest.mark.parametrize(
    ("agent", "job", "words"),
    [
        ({}, {"namespace": "other"}, 'not into "other"'),
        ({}, {"orchestration": {"namespace": "other"}}, 'not into "other"'),
        ({"images": ["lab/other:*"]}, {}, 'no pattern allows "lab/robot:1"'),
        ({"images": ["lab/*"]}, {"namespace": "n"}, None),
    ],
)
def test_what_the_agent_would_do_otherwise_is_a_warning(
    agent: dict[str, Any], job: dict[str, Any], words: str | None
) -> None:
    """Another namespace than `rigel run job` deploys into; no image that commands may use."""
    options = MutoAgent(**{**AGENT, **agent})
    keys = {"image": "lab/robot:1", **job}
    found = [problem.message for problem in check_fit(options, "deploy", keys)]
    assert [words in one for one in found if words] == ([True] if words else [])
    assert len(found) == (words is not None)
