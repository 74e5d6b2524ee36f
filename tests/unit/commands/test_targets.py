"""Which job a command is about where it is not named."""

from __future__ import annotations

from pathlib import Path

import attrs
import pytest

from rigel_k8s.commands import status, targets
from rigel_k8s.commands.targets import job_of, list_namespaces, names, node_names, release
from rigel_k8s.errors import ClusterError, ProblemsError, RigelK8sError, UserError
from rigel_k8s.jobs.deploying import HasRelease
from rigel_k8s.kube import Cluster, connect
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.release.listing import ReleaseSummary
from rigel_k8s.release.types import Desired, ReleaseId
from rigel_k8s.settings import Settings
from tests.support.fake_cluster import FakeCluster
from tests.support.recorder import Recorder
from tests.support.releases import deploy

KUBECONFIG = """
apiVersion: v1
kind: Config
current-context: lab
contexts: [{name: lab, context: {cluster: lab, user: lab, namespace: from-context}}]
clusters: [{name: lab, cluster: {server: "http://127.0.0.1:1"}}]
users: [{name: lab, user: {}}]
"""
DEPLOY = """
  deploy:
    plugin: rigel_k8s.OrchestrationPlugin
    with: {nodes: {talker: {image: "a:1", args: [talker]}}}
"""
UPDATE = """
  update:
    plugin: src.plugin.OrchestrationPlugin
    with: {orchestration: {rolling_update: {strategy: Recreate}}}
"""
OTHER = """
  other:
    plugin: orchestration
    with: {deployment_name: other, nodes: {camera: {image: "b:1", args: [camera]}}}
"""
BUILD = """
  build:
    plugin: rigel_k8s.BuildXPlugin
    with: {image: "a"}
"""
FOREIGN = """
  foreign:
    plugin: somebody.elses.Plugin
"""


@pytest.fixture
def kubeconfig(tmp_path: Path) -> Path:
    path = tmp_path / "kubeconfig"
    path.write_text(KUBECONFIG)
    return path


def settings(tmp_path: Path, *jobs: str, namespace: str | None = None) -> Settings:
    file = tmp_path / "Rigelfile"
    file.write_text("application: {distro: noetic}\njobs:" + "".join(jobs))
    return Settings(file, kubeconfig=tmp_path / "kubeconfig", namespace=namespace)


def test_jobs_of_one_release_count_as_one(tmp_path: Path) -> None:
    """The one that says what the release is is meant, wherever it stands."""
    assert job_of(settings(tmp_path, BUILD, UPDATE, FOREIGN, DEPLOY), None).context.name == "deploy"
    assert names(settings(tmp_path, BUILD, UPDATE, FOREIGN, DEPLOY)) == ["update", "deploy"]


def test_a_partial_job_alone_is_meant_too(tmp_path: Path) -> None:
    """Nothing else could be."""
    assert job_of(settings(tmp_path, UPDATE), None).context.name == "update"


def test_several_releases_need_a_name(tmp_path: Path) -> None:
    """A command does not guess; it lists one job of each."""
    found = settings(tmp_path, DEPLOY, OTHER)
    with pytest.raises(UserError, match="several releases") as caught:
        job_of(found, None)
    assert caught.value.hint == "name a job, one of: deploy, other"
    assert job_of(found, "other").context.name == "other"


def test_a_node_says_which_release_is_meant(tmp_path: Path, kubeconfig: Path) -> None:
    """By its key or its ROS name, where only one release has it."""
    found = settings(tmp_path, DEPLOY, OTHER, UPDATE)
    assert release(found, nodes=["camera"]).id.name == "other"
    assert release(found, nodes=["/talker"]).id.name == "rigel-k8s-application"
    for nodes in (["ros-master"], ["camera", "talker"], ["nowhere"]):
        with pytest.raises(UserError, match="several releases"):
            release(found, nodes=nodes)
    with pytest.raises(UserError, match='none has a node "talkr", did you mean "talker"'):
        release(found, nodes=["talker", "talkr"])


def test_the_namespaces_of_a_rigelfile(tmp_path: Path, kubeconfig: Path) -> None:
    """Those of its jobs, the context's for one that names none; the user's own word wins."""
    elsewhere = OTHER.replace("{deployment_name", "{namespace: lab, deployment_name")
    found = settings(tmp_path, DEPLOY, elsewhere, UPDATE, BUILD)
    with connect(found) as cluster:
        assert list_namespaces(found, cluster) == ["from-context", "lab"]
        found = settings(tmp_path, elsewhere, namespace="mine")
        assert list_namespaces(found, cluster) == ["mine"]
        found = settings(tmp_path, "\n  broken: [")
        assert list_namespaces(found, cluster) == ["from-context"]
        found.rigelfile.unlink()
        assert list_namespaces(found, cluster) == ["from-context"]


def test_list_looks_where_the_rigelfile_deploys(
    tmp_path: Path, kubeconfig: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the namespaces of its jobs, unless the user names one or all."""
    looked: list[str | None] = []

    def list_releases(_: Cluster, name: str | None) -> list[ReleaseSummary]:
        looked.append(name)
        return []

    monkeypatch.setattr(status, "list_releases", list_releases)
    elsewhere = OTHER.replace("{deployment_name", "{namespace: lab, deployment_name")
    found = settings(tmp_path, elsewhere)
    assert status.releases(found, everywhere=False) == (["lab"], [])
    assert status.releases(found, everywhere=True) == ([], [])
    assert status.releases(attrs.evolve(found, namespace="mine"), everywhere=False)[0] == ["mine"]
    found.rigelfile.unlink()
    assert status.releases(found, everywhere=False)[0] == ["from-context"]
    assert looked == ["lab", None, "mine", "from-context"]


def test_a_wrong_name_tells_the_nearest(tmp_path: Path) -> None:
    """A job of another type is told apart from one that is not there."""
    found = settings(tmp_path, DEPLOY, BUILD)
    with pytest.raises(UserError, match='unknown job "deplo", did you mean "deploy"'):
        job_of(found, "deplo")
    with pytest.raises(UserError, match='the job "build" deploys nothing'):
        job_of(found, "build")
    with pytest.raises(UserError, match="has no orchestration job"):
        job_of(settings(tmp_path, BUILD), None)


def test_render_and_diff_tell_what_a_run_would_tell(tmp_path: Path) -> None:
    """Options that Kubernetes or ROS would refuse are refused with their place."""
    twice = DEPLOY.replace("args: [talker]", "args: [talker], replicas: 2")
    with pytest.raises(ProblemsError) as caught:
        job_of(settings(tmp_path, twice), None)
    assert "Rigelfile:5:" in "".join(caught.value.details)


def test_data_of_other_jobs_is_asked_for_only_where_it_matters(
    tmp_path: Path, kubeconfig: Path
) -> None:
    """`status` needs two names; `render` needs everything, and says what it lacks."""
    hole = DEPLOY.replace('"a:1"', '"{{ data.image }}"')
    found = release(settings(tmp_path, hole))
    assert (found.id.namespace, found.id.name) == ("from-context", "rigel-k8s-application")
    with pytest.raises(ProblemsError) as caught:
        job_of(settings(tmp_path, hole), None)
    assert "data.image" in "".join(caught.value.details)
    unnamed = DEPLOY.replace("{nodes", '{deployment_name: "{{ data.robot }}", nodes')
    with pytest.raises(ProblemsError) as caught:
        release(settings(tmp_path, unnamed, namespace="lab"))
    assert "data.robot" in "".join(caught.value.details)
    assert "name the release" in str(caught.value.hint)


def test_a_robot_of_a_fleet_is_named_by_its_namespace(tmp_path: Path, kubeconfig: Path) -> None:
    """Its job takes it from a matrix, which only a sequence has."""
    fleet = DEPLOY.replace("{nodes", '{namespace: "{{ data.robot }}", nodes')
    for name in (None, "deploy"):
        found = release(settings(tmp_path, fleet, namespace="robot-01"), name).id
        assert (found.namespace, found.name) == ("robot-01", "rigel-k8s-application")
    assert "talker" in node_names(settings(tmp_path, fleet, namespace="robot-01"))
    with pytest.raises(ProblemsError) as caught:
        release(settings(tmp_path, fleet))
    assert "data.robot" in "".join(caught.value.details)
    assert "-n" in str(caught.value.hint)


def test_the_namespace_of_the_command_line_wins(tmp_path: Path, kubeconfig: Path) -> None:
    """-n, else the Rigelfile's, else the context's."""
    own = DEPLOY.replace("{nodes", "{namespace: own, nodes")
    assert release(settings(tmp_path, own, namespace="given")).id.namespace == "given"
    assert release(settings(tmp_path, own)).id.namespace == "own"
    assert release(settings(tmp_path, DEPLOY)).id.namespace == "from-context"
    both = own.replace("deploy:", "elsewhere:").replace("own", "else")
    with pytest.raises(UserError, match="several releases"):
        release(settings(tmp_path, own, both))
    assert release(settings(tmp_path, own, both, namespace="given")).id.namespace == "given"


#: A registry and a tag that are said when it is deployed, plainly and in an expression.
FROM_OUTSIDE = """
  deploy:
    plugin: rigel_k8s.OrchestrationPlugin
    with:
      deployment_name: "{{ vars.NOWHERE_NAME | default('rover') }}"
      image: "{{ vars.NOWHERE_REGISTRY }}/rover:{{ vars.NOWHERE_TAG | lower }}"
      nodes: {talker: {args: [talker]}}
"""


def test_what_only_deploying_needs_may_be_unknown_to_status(
    tmp_path: Path, kubeconfig: Path
) -> None:
    """`rigel status` in a new shell works without the variables that `rigel run` had."""
    found = release(settings(tmp_path, FROM_OUTSIDE))
    assert (found.id.namespace, found.id.name) == ("from-context", "rover")
    assert "talker" in node_names(settings(tmp_path, FROM_OUTSIDE))
    with pytest.raises(ProblemsError) as told:
        job_of(settings(tmp_path, FROM_OUTSIDE), None)
    assert "vars.NOWHERE_REGISTRY is neither in vars nor in the environment" in str(
        told.value.details
    )


def test_a_name_that_comes_from_nowhere_is_told(tmp_path: Path, kubeconfig: Path) -> None:
    """Without the release's name there is nothing to look for."""
    job = FROM_OUTSIDE.replace(" | default('rover')", "")
    with pytest.raises(ProblemsError) as told:
        release(settings(tmp_path, job))
    assert "vars.NOWHERE_NAME is neither in vars nor in the environment" in str(told.value.details)


def test_a_release_needs_no_rigelfile(
    tmp_path: Path, kubeconfig: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its name says it all; without -n it is in the context's namespace."""
    monkeypatch.chdir(tmp_path)
    found = release(Settings(kubeconfig=kubeconfig), "arm")
    assert (found.id.namespace, found.id.name) == ("from-context", "arm")
    found = release(Settings(kubeconfig=kubeconfig, namespace="lab"), "arm")
    assert (found.id.namespace, found.id.name) == ("lab", "arm")


def test_without_a_rigelfile_the_only_release_is_meant(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By what reads; what writes would do it in a wrong directory. Of several, one is named."""
    monkeypatch.chdir(tmp_path)
    fake = FakeCluster()
    monkeypatch.setattr(targets, "connect", lambda _: fake)
    with pytest.raises(UserError, match="no release is named: none exists in the namespace n"):
        release(Settings(namespace="n"))
    deploy(Desired(ReleaseId("n", "one"), (), create_namespace=True), fake, report=Recorder())
    assert release(Settings(namespace="n")).id == ReleaseId("n", "one")
    with pytest.raises(UserError, match="no release is named") as caught:
        release(Settings(namespace="n"), named=True)
    assert "rigel list" in str(caught.value.hint)
    deploy(Desired(ReleaseId("n", "two"), (), create_namespace=True), fake, report=Recorder())
    with pytest.raises(UserError, match="there are one, two in the namespace n"):
        release(Settings(namespace="n"))


def test_a_rigelfile_that_was_named_and_is_missing_is_an_error(tmp_path: Path) -> None:
    """`-f` says where the release's names are: another meaning of the word would surprise."""
    with pytest.raises(UserError, match=r"Robots does not exist"):
        release(Settings(tmp_path / "Robots"), "arm")


@pytest.mark.usefixtures("kubeconfig")
def test_a_job_wins_over_a_release_of_its_name(tmp_path: Path) -> None:
    """The job `other` deploys the release `other` of its own namespace, whatever runs elsewhere."""
    found = release(settings(tmp_path, DEPLOY, OTHER), "deploy")
    assert found.id.name == "rigel-k8s-application"


def test_a_release_beside_a_rigelfile_is_found_by_its_name(
    tmp_path: Path, fake: FakeCluster, report: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is neither a job nor a release is told as a job that is not there."""
    deploy(Desired(ReleaseId("lab", "arm"), (), create_namespace=True), fake, report=report)
    monkeypatch.setattr(targets, "connect", lambda settings: fake)
    words = settings(tmp_path, DEPLOY, namespace="lab")
    assert release(words, "arm").id == ReleaseId("lab", "arm")
    with pytest.raises(UserError, match='unknown job "amr"'):
        release(words, "amr")


@pytest.mark.parametrize(
    ("connect", "kind", "told"),
    [
        (ClusterError("cannot reach the cluster", hint="start it"), ClusterError, "cannot reach"),
        (UserError("no such context", hint="name another"), UserError, "no such context"),
    ],
)
def test_a_release_that_cannot_be_looked_up_is_told_why(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    connect: RigelK8sError,
    kind: type[RigelK8sError],
    told: str,
) -> None:
    """Except where the name is nearly that of a job: then that is what was meant."""

    def refuse(settings: Settings) -> None:
        raise connect

    monkeypatch.setattr(targets, "connect", refuse)
    words = settings(tmp_path, DEPLOY, namespace="lab")
    with pytest.raises(kind, match=rf'"arm" is not a job.*{told}') as caught:
        release(words, "arm")
    assert caught.value.hint == connect.hint
    assert caught.value.details == ("jobs that deploy: deploy",)
    with pytest.raises(UserError, match='did you mean "deploy"'):
        release(words, "deplyo")


def test_a_viewer_names_a_release_beside_a_rigelfile(
    tmp_path: Path, fake: FakeCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Who may not list Secrets, as a viewer, means a release by a name that is no job."""

    def refuse(*_: object) -> None:
        raise Forbidden("cannot list Secrets")

    monkeypatch.setattr(targets, "connect", lambda settings: fake)
    monkeypatch.setattr(targets.revisions, "records", refuse)
    found = settings(tmp_path, DEPLOY, namespace="lab")
    assert release(found, "arm").id == ReleaseId("lab", "arm")
    with pytest.raises(UserError, match='did you mean "deploy"'):
        release(found, "deplyo")


AGENT = """
  agent:
    plugin: rigel_k8s.MutoAgentPlugin
    with: {namespace: own, thing: "a:b", broker: "mqtt://broker", job: deploy}
"""


def test_the_agent_of_muto_is_a_release(tmp_path: Path, kubeconfig: Path) -> None:
    """By its job's name, and never by itself: without a name the application is meant."""
    found = settings(tmp_path, AGENT, DEPLOY, BUILD)
    assert release(found, "agent").id == ReleaseId("own", "muto-agent")
    assert release(found).id.name == "rigel-k8s-application"
    assert names(found, HasRelease) == ["agent", "deploy"]
    with pytest.raises(UserError, match='the job "build" deploys nothing'):
        release(found, "build")
    with pytest.raises(ProblemsError):
        release(settings(tmp_path, AGENT.replace("own", "Own_"), DEPLOY), "agent")
