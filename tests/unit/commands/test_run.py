"""What `rigel run` finds before the first job runs."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import attrs
import pytest

from rigel_k8s.commands.run import prepare, run
from rigel_k8s.errors import JobFailed, UserError
from rigel_k8s.settings import Settings
from rigel_k8s.system.trust import trust
from tests.support.recorder import Recorder

BUILD_AND_DEPLOY = """
application: {distro: noetic}
jobs:
  dockerfile: {plugin: rigel_k8s.DockerfilePlugin, with: {command: [a]}}
  deploy:
    plugin: rigel_k8s.OrchestrationPlugin
    with: {image: a, deploy_ros_master: true, nodes: {a: {args: [a]}}}
  ours: {plugin: mine.Nothing}
sequences:
  s: {stages: [{jobs: [dockerfile, deploy]}]}
  nested: {matrix: {x: [1]}, stages: [{jobs: [dockerfile, deploy]}]}
  created: {stages: [{jobs: [ours, dockerfile, deploy]}]}
  without: {stages: [{jobs: [dockerfile]}]}
"""


OWN = """
class Nothing:
    options = dict
    def check(self, options, application): return ()
    def run(self, options, job): pass
"""


@pytest.fixture
def nowhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A Rigelfile on a machine on which no cluster is configured."""
    monkeypatch.setenv("KUBECONFIG", str(tmp_path / "kubeconfig"))
    monkeypatch.delenv("KUBERNETES_SERVICE_HOST", raising=False)
    (tmp_path / "Rigelfile").write_text(BUILD_AND_DEPLOY)
    (tmp_path / "mine.py").write_text(OWN)
    trust(tmp_path)
    yield tmp_path
    sys.modules.pop("mine", None)


def start(name: str, directory: Path) -> None:
    run("sequence", name, Settings(rigelfile=directory / "Rigelfile"), Recorder())


@pytest.mark.parametrize("name", ["s", "nested"])
def test_a_missing_kubeconfig_ends_the_run_before_its_first_job(name: str, nowhere: Path) -> None:
    """A build takes minutes, and would be for nothing."""
    with pytest.raises(UserError, match=r"job deploy needs a cluster: no cluster is conf") as error:
        start(name, nowhere)
    assert "rigel cluster up" in (error.value.hint or "")
    assert not (nowhere / "Dockerfile").exists()


def test_a_malformed_kubeconfig_ends_the_run_before_its_first_job(nowhere: Path) -> None:
    """It is read, without a connection."""
    (nowhere / "kubeconfig").write_text("a: [")
    with pytest.raises(UserError, match=r"job deploy needs a cluster: .*kubeconfig"):
        start("s", nowhere)
    assert not (nowhere / "Dockerfile").exists()


def test_a_job_of_unknown_effect_may_create_the_cluster(nowhere: Path) -> None:
    """Its own kubeconfig is there only after it has run."""
    with pytest.raises(JobFailed):
        start("created", nowhere)
    assert (nowhere / "Dockerfile").exists()


def test_a_run_without_a_cluster_needs_no_kubeconfig(nowhere: Path) -> None:
    """Only a job that connects needs it."""
    start("without", nowhere)
    assert (nowhere / "Dockerfile").exists()


FLEET = """
application: {distro: noetic}
jobs:
  dockerfile: {plugin: rigel_k8s.DockerfilePlugin, with: {command: [a]}}
  deploy: {plugin: rigel_k8s.OrchestrationPlugin, with: {image: a, namespace: "{{ data.robot }}"}}
sequences:
  alone: {stages: [{jobs: [deploy]}]}
  after: {stages: [{jobs: [dockerfile, deploy]}]}
  fleet: {matrix: {robot: [a, b]}, stages: [{jobs: [deploy]}]}
  other: {matrix: {robot: [a, b]}, stages: [{jobs: [dockerfile]}]}
"""


def test_a_job_of_a_fleet_names_the_sequences_that_pass_its_data(nowhere: Path) -> None:
    """It is refused before it runs."""
    (nowhere / "Rigelfile").write_text(FLEET)
    report = Recorder()
    with pytest.raises(UserError) as caught:
        run("job", "deploy", Settings(rigelfile=nowhere / "Rigelfile"), report)
    assert "no earlier job has stored data.robot" in "\n".join(caught.value.details)
    names = "`rigel run sequence after`, `rigel run sequence fleet`"
    assert caught.value.hint == f"a sequence passes it to the job: {names}"
    assert report.entries == []


def test_a_name_that_only_one_has_is_enough(nowhere: Path) -> None:
    """`rigel run deploy` is what everyone types first."""
    settings = Settings(rigelfile=nowhere / "Rigelfile")
    with pytest.raises(UserError, match="the job deploy needs a cluster"):
        run(None, "deploy", settings, Recorder())
    with pytest.raises(UserError, match="the job deploy needs a cluster"):
        run(None, "nested", settings, Recorder())
    with pytest.raises(UserError, match='no job and no sequence is called "deplyo", did you mean'):
        run(None, "deplyo", settings, Recorder())
    text = (nowhere / "Rigelfile").read_text().replace("  nested:", "  deploy:")
    (nowhere / "Rigelfile").write_text(text)
    with pytest.raises(UserError, match='a job and a sequence are called "deploy"') as caught:
        run(None, "deploy", settings, Recorder())
    assert "rigel run sequence deploy" in str(caught.value.hint)
    with pytest.raises(UserError, match='a job and a sequence are called "deploy"') as caught:
        prepare(None, "deploy", attrs.evolve(settings, tests=True))
    assert "`rigel test job deploy` or `rigel test sequence deploy`" in str(caught.value.hint)
