"""Installing Multus without a cluster: whose it is, what is wanted, what options contradict."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

import attrs
import pytest

from rigel_k8s.deploy import deploy
from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.kube.failures import Forbidden
from rigel_k8s.network.options import Install, Network, network_of
from rigel_k8s.release import revisions, survey
from rigel_k8s.release.locking import PROCESS, lease_ref, process
from rigel_k8s.release.look import look_at
from rigel_k8s.release.part import Part
from rigel_k8s.release.types import PROTECTED, DeployOptions
from rigel_k8s.settings import Application, Settings
from rigel_multus import install as installing
from rigel_multus.cli import options_of
from rigel_multus.install import (
    MultusHooks,
    MultusResult,
    complete_options,
    find,
    find_release,
    install,
    requested_multus,
)
from rigel_multus.installation import RELEASE, Installation, Presence
from rigel_multus.job import NetworkJob
from rigel_multus.platform import Group, platform
from rigel_multus.proving import fingerprint
from tests.support.controllers import Controllers
from tests.support.fake_cluster import FakeCluster, Killed, Store
from tests.support.recorder import Recorder

LEASE = lease_ref(RELEASE)


def node(name: str, *, up: bool = True) -> dict[str, Any]:
    ready = {"type": "Ready", "status": "True" if up else "Unknown"}
    return {
        "metadata": {"name": name, "uid": name},
        "status": {"conditions": [ready], "nodeInfo": {"kubeletVersion": "v1.34.4"}},
    }


def daemon_set(
    name: str, image: str, *, namespace: str = "kube-system", ours: bool = False, cni: bool = True
) -> dict[str, Any]:
    path = "/etc/cni/net.d" if cni else "/data"
    spec = {"containers": [{"image": image}], "volumes": [{"hostPath": {"path": path}}]}
    labels = {"rigel-k8s/release": "rigel-network"} if ours else {}
    return {
        "metadata": {"name": name, "namespace": namespace, "labels": labels, "uid": name},
        "spec": {"template": {"spec": spec}},
    }


class Cluster:
    """The few answers that looking takes."""

    def __init__(self, nodes: list[Any], sets: list[Any], definitions: Mapping[str, Any]) -> None:
        self._nodes, self.sets, self.definitions = nodes, sets, definitions

    def nodes(self) -> list[Any]:
        return self._nodes

    def list(self, api: str, kind: str, *_: Any, **__: Any) -> list[Any]:
        return self.sets if kind == "DaemonSet" else []

    def get(self, ref: Any) -> Any:
        return self.definitions.get(ref.name)

    def parallel(self, function: Any, items: Any) -> list[Any]:
        return [function(item) for item in items]


class Refusing(Cluster):
    """Nodes must not be listed."""

    def __init__(self, ground: Any) -> None:
        super().__init__([], [], {})
        self.ground = ground

    def nodes(self) -> list[Any]:
        error = Forbidden("no right to list nodes")
        error.ground = self.ground
        raise error

    def list(self, api: str, kind: str, *_: Any, **__: Any) -> list[Any]:
        return self.nodes()

    def get(self, ref: Any) -> Any:
        return self.nodes()


def test_without_rights_a_job_uses_the_cluster_as_it_is() -> None:
    """As with the observability stack: an administrator and a deployer share a Rigelfile."""
    told, deployer = Recorder(), cast(Any, Refusing("right"))
    network = Network(install=Install())
    assert requested_multus(network, deployer, told) == []
    assert told.warnings == [
        "no right to list nodes: Multus stays as it is;"
        " let an administrator run `rigel network install` once"
    ]
    with pytest.raises(Forbidden):
        install(deployer, Install(), DeployOptions(report=told))
    with pytest.raises(Forbidden):
        requested_multus(network, cast(Any, Refusing("quota")), told)


def found(*sets: Any, nodes: Any = None, **definitions: Any) -> Any:
    """Return what is found on a cluster."""
    cluster: Any = Cluster(nodes or [node("robot")], list(sets), definitions)
    return find(cluster, Install())


@pytest.mark.parametrize(
    ("name", "image"),
    [
        ("kube-multus-ds", "registry.lab/anything:1"),
        ("net", "ghcr.io/k8snetworkplumbingwg/multus-cni:snapshot-thick"),
        ("net", "rancher/hardened-multus-cni:v4.2.1-build20250909"),
        ("multus", "quay.io/openshift/origin@sha256:0123"),
    ],
)
def test_others_multus_is_recognised(name: str, image: str) -> None:
    """By its name or its image, from whatever registry; it is left to whoever has installed it."""
    there = found(daemon_set(name, image, namespace="other"))
    multus = there.parts["multus"]
    assert (multus.ours, multus.where) == (False, f"other/{name}")
    assert there.installs == ["whereabouts"]


@pytest.mark.parametrize(
    "other",
    [
        daemon_set("net", "ghcr.io/k8snetworkplumbingwg/multus-dynamic-networks-controller:1"),
        daemon_set("net", "ghcr.io/lab/multus-cni:1", cni=False),
        daemon_set("flannel", "flannel/flannel:1"),
    ],
)
def test_what_is_no_multus(other: Any) -> None:
    """Neither its companions nor pods that only use its image are Multus."""
    there = found(other)
    assert "multus" not in there.parts
    assert "multus" in there.installs


def test_ours_stays_ours() -> None:
    """A second Multus that appears never makes us take ours away."""
    ours = daemon_set("rigel-multus", "x/multus-cni:1", ours=True)
    there = found(daemon_set("kube-multus-ds", "x/multus-cni:1"), ours)
    multus = there.parts["multus"]
    assert (multus.ours, multus.where) == (True, "kube-system/rigel-multus")


def test_our_second_platform_is_ours() -> None:
    """The DaemonSet of a second platform counts with the first."""
    sets = [daemon_set(n, "i", ours=True) for n in ("rigel-multus", "rigel-multus-k3s-0a1b2c")]
    assert len(found(*sets).parts["multus"].sets) == 2


def test_definitions_of_others_are_known() -> None:
    """A definition that somebody else has made is left as it is."""
    name = "network-attachment-definitions.k8s.cni.cncf.io"
    assert found(**{name: {"metadata": {"name": name}}}).foreign == {name}
    labels = {"rigel-k8s/release": "rigel-network"}
    notes = {"rigel-k8s/namespace": "kube-system"}
    ours = {"metadata": {"name": name, "labels": labels, "annotations": notes}}
    assert found(**{name: ours}).foreign == frozenset()


def test_nodes_that_are_away_are_told_apart() -> None:
    """A robot that is off is neither asked nor waited for."""
    there = found(nodes=[node("a"), node("b", up=False), node("c")])
    up = [one["metadata"]["name"] for one in there.up]
    assert (up, there.away) == (["a", "c"], ("b",))


def test_machines_that_are_away_do_not_stop_an_update() -> None:
    """Kubernetes would wait for their pods; only our own DaemonSets are touched."""
    patched: list[Any] = []

    class Patching(Cluster):
        def patch(self, ref: Any, change: Any) -> None:
            patched.append((ref.name, change["spec"]["updateStrategy"]["rollingUpdate"]))

    def let(*nodes: Any) -> list[Any]:
        ours = daemon_set("rigel-multus", "x/multus-cni:1", ours=True)
        sets = [{**one, "apiVersion": "apps/v1", "kind": "DaemonSet"} for one in (ours, theirs)]
        cluster: Any = Patching(list(nodes), sets, {})
        patched.clear()
        installing.let_be_away(cluster, find(cluster, Install()))
        return patched

    theirs = daemon_set("whereabouts", "x/whereabouts:1", namespace="other")
    assert let(node("a"), node("b")) == []
    away = [node("b", up=False), node("c", up=False)]
    assert let(node("a"), *away) == [("rigel-multus", {"maxUnavailable": 3})]


def test_a_cluster_without_linux() -> None:
    """There is nothing to install it on, and that is said."""
    windows = node("w")
    windows["metadata"]["labels"] = {"kubernetes.io/os": "windows"}
    with pytest.raises(ClusterError, match="no Linux machine"):
        found(nodes=[windows])


@pytest.mark.parametrize(
    ("network", "options"),
    [
        (None, None),
        (network_of("macvlan"), None),
        (Network(), None),
        (Network(install=True), Install()),
        (Network(install=Install(data_dir="/data")), Install(data_dir="/data")),
        (Network(mode="peers", install=True), None),
        (Network(mode="host", install=True), None),
    ],
)
def test_what_a_job_wants_installed(network: Any, options: Install | None) -> None:
    """Only a network that Multus attaches, and that says `install`."""
    parts: list[Any] = requested_multus(network, None, Recorder())
    assert [part.hooks.installation.options for part in parts] == (
        [] if options is None else [options]
    )


def test_a_data_directory_is_k3s() -> None:
    """Where the platform is said to be another one, that is a mistake."""
    jazzy = Application(distro="jazzy")
    assert NetworkJob().check(Install(data_dir="/data"), jazzy) == ()
    assert NetworkJob().check(Install(data_dir="/data", platform="k3s"), jazzy) == ()
    (problem,) = NetworkJob().check(Install(data_dir="/data", platform="kind"), jazzy)
    assert problem.path == ("data_dir",)


def test_one_cluster_is_one_network() -> None:
    """Two branches of a sequence do not install it at once."""
    one, other = Install(), Install(platform="kind")
    keys = {
        NetworkJob().exclusive(options, Application(distro="jazzy"), Settings())
        for options in (one, other)
    }
    assert len(keys) == 1


def test_words_of_the_command_line() -> None:
    """They are checked as a Rigelfile's options are."""
    words: dict[str, str | None] = {"platform": "k3s", "data_dir": "/data", "multus_image": None}
    assert options_of(words) == Install(platform="k3s", data_dir="/data")
    with pytest.raises(UserError) as error:
        options_of({"data_dir": "data"})
    assert error.value.details[0].startswith("--data-dir: ")
    with pytest.raises(UserError):
        options_of({"data_dir": "/data", "platform": "plain"})


def test_a_proof_holds_for_one_start_of_one_installation() -> None:
    """A node that was started again, or whose Multus was changed, has to show it again."""
    sets = [{"metadata": {"uid": "u", "generation": 1}}]
    mark = fingerprint(node("a"), sets)
    assert mark == fingerprint(node("a"), sets)
    started = node("a")
    started["status"]["nodeInfo"]["bootID"] = "other"
    assert mark != fingerprint(started, sets)
    assert mark != fingerprint(node("a"), [{"metadata": {"uid": "u", "generation": 2}}])


def test_definitions_hold_data() -> None:
    """With a definition goes every object of its kind: no release takes one away unasked."""
    assert "CustomResourceDefinition" in PROTECTED


def test_what_is_not_said_stays_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    """A second Rigelfile's `install: true` takes nothing back; what is said wins; a first
    installation has nothing to keep."""
    before = {"multus_image": "registry.lab/multus:1", "data_dir": "/data"}

    class Last:
        options = before

    monkeypatch.setattr(installing, "find_last_good", lambda *_: Last)
    cluster: Any = None
    assert complete_options(cluster, Install()) == Install(**before)
    said = Install(data_dir="/var/lib/rancher/k3s")
    assert complete_options(cluster, said) == Install(
        multus_image="registry.lab/multus:1", data_dir="/var/lib/rancher/k3s"
    )
    monkeypatch.setattr(installing, "find_last_good", lambda *_: None)
    assert complete_options(cluster, Install()) == Install()


def multus_beside_theirs() -> Part:
    """Return the installation on a cluster on which others have installed whereabouts."""
    theirs = Presence((daemon_set("whereabouts", "whereabouts"),), ours=False)
    asked = Installation([Group(platform("plain"))], parts={"whereabouts": theirs})
    hooks = MultusHooks(installation=asked)
    return Part(desired=find_release(None, asked), shared=True, hooks=hooks)


def roll_out(fake: FakeCluster) -> Recorder:
    """Install on a cluster whose machines are all still to come."""
    report = Recorder()
    deploy([multus_beside_theirs()], cast(Any, fake), DeployOptions(report=report, timeout=60))
    return report


def test_an_unchanged_installation_says_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """A deploy that requests what is there neither waits for it nor reports it."""
    nothing = MultusResult((), (), "", ours=True)
    monkeypatch.setattr(installing, "prove_nodes", lambda *_: nothing)
    fake = FakeCluster(Store(controllers=Controllers()))
    meta = {"name": RELEASE.namespace}
    fake.create({"apiVersion": "v1", "kind": "Namespace", "metadata": meta})
    assert "rigel-multus" in str(roll_out(fake).entries)
    ((_, _, line),) = roll_out(fake).entries  # of what others have installed
    assert line.startswith("whereabouts is already installed")


def test_a_machine_that_is_away_is_named_each_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """By `rigel network install`; a deploy that only requests Multus names it where it writes."""
    nothing = MultusResult((), (), "", ours=True)
    monkeypatch.setattr(installing, "prove_nodes", lambda *_: nothing)
    fake = FakeCluster(Store(controllers=Controllers()))
    meta = {"name": RELEASE.namespace}
    fake.create({"apiVersion": "v1", "kind": "Namespace", "metadata": meta})
    warnings = []
    for own in (True, True, False):
        part, report = multus_beside_theirs(), Recorder()
        part.away, part.own = ("arm",), own
        deploy([part], cast(Any, fake), DeployOptions(report=report, timeout=60))
        warnings.append(report.warnings)
    told = "machine arm is not ready: the installation does not wait for it"
    assert warnings == [[told], [told], []]


def test_objects_that_another_deploy_has_just_written_are_waited_for(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A look that meets another deploy's beginning, the old revisions and the new objects, does not
    take them for an installation that is complete."""
    nothing = MultusResult((), (), "", ours=True)
    monkeypatch.setattr(installing, "prove_nodes", lambda *_: nothing)
    fake = FakeCluster(Store(controllers=Controllers()))
    meta = {"name": RELEASE.namespace}
    fake.create({"apiVersion": "v1", "kind": "Namespace", "metadata": meta})
    before = multus_beside_theirs()
    objects = [one for one in before.desired.objects if one["kind"] != "DaemonSet"]
    before.desired = attrs.evolve(before.desired, objects=objects)
    deploy([before], cast(Any, fake), DeployOptions(report=Recorder()))
    old = revisions.records(fake, RELEASE)
    assert old[-1].status == "good"
    roll_out(fake)
    part = multus_beside_theirs()
    assert not look_at(part, cast(Any, fake), adopt=False).writes
    monkeypatch.setattr(survey, "records", lambda *_: old)
    assert look_at(part, cast(Any, fake), adopt=False).writes


def test_a_killed_installation_is_completed_by_the_next(monkeypatch: pytest.MonkeyPatch) -> None:
    """Killed after any of its writes and run again: no Lease stays, the last revision is good."""
    nothing = MultusResult((), (), "", ours=True)  # no machine is there to prove anything
    monkeypatch.setattr(installing, "prove_nodes", lambda *_: nothing)
    kills = 0
    for limit in range(1, 60):
        fake = FakeCluster(Store(controllers=Controllers()))
        meta = {"name": RELEASE.namespace}
        fake.create({"apiVersion": "v1", "kind": "Namespace", "metadata": meta})
        fake.store.die_after = limit
        try:
            roll_out(fake)
        except Killed:
            kills += 1
            fake.revive()
            if LEASE in fake.objects:
                boot, space, pid, _ = process().split()
                dead = {PROCESS: f"{boot} {space} {pid} 0"}
                fake.objects[LEASE]["metadata"]["annotations"] = dead
            roll_out(fake)
            assert LEASE not in fake.objects
            assert revisions.records(fake, RELEASE)[-1].status == "good"
        else:
            break
    assert kills > 10
