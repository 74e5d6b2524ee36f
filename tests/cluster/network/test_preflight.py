"""Preflight on real machines: what each lacks is found out before anything is applied."""

from __future__ import annotations

import json
import subprocess
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import attrs
import pytest

from rigel_k8s.app.generation import GENERATIONS
from rigel_k8s.errors import UserError
from rigel_k8s.kube import connect
from rigel_k8s.network.modes import network_objects, wire_pod
from rigel_k8s.network.options import Network
from rigel_k8s.network.plan import network_plan
from rigel_k8s.network.preflight.examine import examine
from rigel_k8s.network.wiring import PodIdentity
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.settings import Settings
from tests.cluster.rights import wait_for_right, write_kubeconfig
from tests.support.preflight import check

pytestmark = [pytest.mark.cluster, pytest.mark.usefixtures("multus")]

SUBNET = "10.202.0.0/24"
Ask = Callable[..., list[str]]


def release(
    namespace: str, network: Network, *, names: tuple[str, ...] = ("talker",), **spec: Any
) -> list[dict[str, Any]]:
    """A release's objects as the network rooms make them."""
    pods = [PodIdentity(name, "ros:jazzy") for name in names]
    plan = network_plan(
        network,
        namespace=namespace,
        release="demo",
        ros=GENERATIONS["2"],
        distro="jazzy",
        pods=pods,
    )
    return [
        *(item for _, item in network_objects(plan)),
        *(deployment(plan, p, spec) for p in pods),
    ]


def deployment(plan: Any, pod: PodIdentity, spec: dict[str, Any]) -> dict[str, Any]:
    wired = wire_pod(plan, pod)
    return {
        "apiVersion": "apps/v1",
        "kind": "Deployment",
        "metadata": {"name": pod.name, "namespace": plan.namespace},
        "spec": {
            "template": {
                "metadata": {"labels": {"app": pod.name}, "annotations": dict(wired.annotations)},
                "spec": {**wired.pod, **spec},
            }
        },
    }


@pytest.fixture
def ask(cluster: Any, namespace: str) -> Ask:
    """What is found for a network: SEVERITY KIND: MESSAGE."""

    def call(where: str = namespace, **options: Any) -> list[str]:
        spec = options.pop("spec", {})
        names = options.pop("names", ("talker",))
        network = Network(**{"mode": "macvlan", "interface": "eth0", "subnet": SUBNET} | options)
        found = examine(release(where, network, names=names, **spec), network, cluster)
        return [f"{f.severity} {f.kind}: {f.message}" for f in found]

    return call


@attrs.frozen
class Machine:
    """A node of a local cluster, from outside."""

    netns: str
    pid: str

    def ip(self, *words: str) -> None:
        subprocess.run(["ip", "-n", self.netns, *words], check=True)

    def inside(self, *words: str) -> list[str]:
        """Return the command that runs something among the node's files and links."""
        return ["nsenter", "-t", self.pid, "-m", "-n", *words]


@pytest.fixture
def machines(context: str, lab: Any) -> dict[str, Machine]:
    """The nodes of a local cluster, whose links and files a test may add to."""
    name = context.removeprefix("rigel-")
    found = {}
    for node in lab.nodes:
        needle = f"kubelet --config=/var/lib/rigel-k8s/clusters/{name}/{node}/"
        done = subprocess.run(["pgrep", "-of", needle], check=False, capture_output=True, text=True)
        if done.returncode:
            pytest.skip("only a local cluster's machines can be added to")
        found[node] = Machine(f"rigel-{name}-{node}", done.stdout.strip())
    if len(found) < 2:
        pytest.skip("needs two nodes")
    return found


@pytest.fixture
def link(machines: dict[str, Machine]) -> Iterator[str]:
    """An Ethernet interface that all machines have but the last one; gone after the test."""
    name = f"pf{uuid.uuid4().hex[:6]}"
    having = list(machines.values())[:-1]
    for one in having:
        one.ip("link", "add", name, "type", "veth", "peer", "name", f"{name}p")
        one.ip("link", "set", name, "up")
        one.ip("link", "set", f"{name}p", "up")
    yield name
    for one in having:
        one.ip("link", "delete", name)


def test_all_is_well(ask: Ask) -> None:
    """Nothing is found on machines where macvlan works; `static` likewise."""
    assert ask() == []
    assert ask(ipam="static") == []


def test_missing_on_one_machine(ask: Ask, machines: dict[str, Machine], link: str) -> None:
    """An interface that one of the machines lacks is told with that machine's name, and not where
    pods are kept away from it."""
    *others, last = machines
    assert ask(interface=link) == [
        f"error interface-missing: {last} has no interface {link} (there: eth0)"
    ]
    assert ask(interface=link, spec={"nodeSelector": {"kubernetes.io/hostname": others[0]}}) == []


def test_down(ask: Ask, machines: dict[str, Machine], link: str) -> None:
    """An interface that is switched off."""
    first = next(iter(machines))
    spec = {"nodeSelector": {"kubernetes.io/hostname": first}}
    machines[first].ip("link", "set", link, "down")
    assert ask(interface=link, spec=spec) == [
        f"error interface-down: {link} of {first} is down: pods would start and receive nothing"
    ]


def test_mtu(ask: Ask) -> None:
    """More than the machines' MTU."""
    assert [line.partition(":")[0] for line in ask(mtu=65000)] == ["error mtu"]


def test_a_program_that_one_machine_has(
    cluster: Any, namespace: str, machines: dict[str, Machine]
) -> None:
    """CNI programs are looked for on each machine, in the directory that its runtime uses."""
    first, *others = machines
    program = f"pf-{uuid.uuid4().hex[:6]}"
    path = f"/opt/cni/bin/{program}"
    if subprocess.run(machines[first].inside("test", "-d", "/opt/cni/bin"), check=False).returncode:
        pytest.skip("this cluster keeps its CNI programs elsewhere")
    network = Network(mode="macvlan", interface="eth0", subnet=SUBNET)
    objects = release(namespace, network)
    config = json.loads(objects[0]["spec"]["config"])
    objects[0]["spec"]["config"] = json.dumps({**config, "type": program})
    subprocess.run(machines[first].inside("cp", "/opt/cni/bin/macvlan", path), check=True)
    try:
        found = [f.message for f in examine(objects, network, cluster)]
    finally:
        subprocess.run(machines[first].inside("rm", path), check=True)
    assert found[0] == (
        f"CNI programs are missing on {', '.join(others)}: {program} (looked into /opt/cni/bin)"
    )


def test_overlapping_the_pods_and_the_services(cluster: Any, ask: Ask) -> None:
    """The pod network is that of the nodes, the Services' what the cluster says."""
    node = cluster.nodes()[0]
    pods = node["spec"]["podCIDR"]
    assert f"{pods} ({node['metadata']['name']})" in ask(subnet=pods)[0]
    service = cluster.get(ObjectRef("v1", "Service", "default", "kubernetes"))
    subnet = service["spec"]["clusterIP"].rpartition(".")[0] + ".0/24"
    assert [line.partition(":")[0] for line in ask(subnet=subnet)] == ["error service-network"]


def test_on_the_machines_own_subnet(cluster: Any, ask: Ask) -> None:
    """whereabouts would give out the machines' addresses; from behind them on it would not."""
    addresses = sorted(
        one["address"]
        for node in cluster.nodes()
        for one in node["status"]["addresses"]
        if one["type"] == "InternalIP"
    )
    subnet = addresses[0].rpartition(".")[0] + ".0/24"
    told = ask(subnet=subnet)
    assert [line.partition(":")[0] for line in told] == ["error machine-address"]
    assert all(address in told[0] for address in addresses)
    assert ask(subnet=subnet, range_start=subnet.replace(".0/24", ".200")) == []


def test_an_attachment_that_is_not_there(lab: Any, ask: Ask) -> None:
    """`mode: attachment` is looked up, in other namespaces too."""
    missing = ask(mode="attachment", interface=None, subnet=None, attachment="default/no-such")
    assert missing[0].startswith(
        "error attachment-missing: the NetworkAttachmentDefinition default/no-such does not exist"
        " (the cluster has: "
    )
    lab.attachment("10.202.3.0/24")
    there = f"{lab.namespace}/lan"
    assert ask(mode="attachment", interface=None, subnet=None, attachment=there) == []


def test_all_findings_are_one_error(cluster: Any, namespace: str, said: Any) -> None:
    """Everything at once with its remedy, and nothing written; exit code 2."""
    network = Network(
        mode="macvlan", interface="eth9", subnet=cluster.nodes()[0]["spec"]["podCIDR"]
    )
    with pytest.raises(UserError) as raised:
        check(release(namespace, network), network, cluster, said)
    assert raised.value.message == "2 things keep the network of this release from working"
    kinds = [line.rpartition("[")[2] for line in raised.value.details[::2]]
    assert kinds == ["interface-missing]", "pod-network]"]
    assert cluster.list("k8s.cni.cncf.io/v1", "NetworkAttachmentDefinition", namespace) == []


RIGELFILE = """
application: {{distro: jazzy}}
jobs:
  deploy:
    plugin: rigel_k8s.OrchestrationPlugin
    with:
      namespace: {namespace}
      network: {{mode: macvlan, interface: no-such, subnet: {subnet}}}
      nodes:
        talker: {{image: "ros:jazzy", args: [talker]}}
"""


def test_a_deploy_is_refused(cluster: Any, namespace: str, rigel: Any, tmp_path: Path) -> None:
    """`rigel run` ends with exit code 2, says which interface lacks where, and writes nothing."""
    text = RIGELFILE.format(namespace=namespace, subnet=SUBNET)
    (tmp_path / "Rigelfile").write_text(text, "utf-8")
    done = rigel("run", "job", "deploy", check=False, cwd=tmp_path)
    assert done.returncode == 2
    assert "have no interface no-such (there: eth0) [interface-missing]" in done.stderr
    assert "hint: set `network.interface` to one that exists on every machine" in done.stderr
    for kind in (("apps/v1", "Deployment"), ("v1", "Secret")):
        assert cluster.list(*kind, namespace) == []


@pytest.fixture
def as_user(
    cluster: Any, namespace: str, context: str, tmp_path: Path
) -> Iterator[Callable[..., Any]]:
    """Connect as somebody who has some rights only: as_user({"apiGroups": ..., ...}, ...)."""
    name = f"pf-{uuid.uuid4().hex[:8]}"
    made: list[Any] = []

    def connected(*rules: dict[str, Any]) -> Any:
        account = {"kind": "ServiceAccount", "name": name, "namespace": namespace}
        meta = {"name": name}
        rbac = "rbac.authorization.k8s.io"
        for item in (
            {
                "apiVersion": "v1",
                "kind": "ServiceAccount",
                "metadata": {**meta, "namespace": namespace},
            },
            {
                "apiVersion": f"{rbac}/v1",
                "kind": "ClusterRole",
                "metadata": meta,
                "rules": list(rules),
            },
            {
                "apiVersion": f"{rbac}/v1",
                "kind": "ClusterRoleBinding",
                "metadata": meta,
                "roleRef": {"apiGroup": rbac, "kind": "ClusterRole", "name": name},
                "subjects": [account],
            },
        ):
            cluster.create(item)
        user = f"system:serviceaccount:{namespace}:{name}"
        for rule in rules:
            wait_for_right(cluster, user, rule)
        config = write_kubeconfig(cluster, namespace, name, context, tmp_path)
        made.append(connect(Settings(kubeconfig=config)))
        return made[-1]

    yield connected
    for one in made:
        one.close()
    for kind in ("ClusterRole", "ClusterRoleBinding"):
        cluster.delete(ObjectRef("rbac.authorization.k8s.io/v1", kind, "", name))


def test_who_may_not_look_is_not_kept_from_deploying(
    namespace: str, as_user: Callable[..., Any], said: Any
) -> None:
    """With rights in one's own namespace only, what could not be looked at is one warning."""
    user = as_user({"apiGroups": [""], "resources": ["configmaps"], "verbs": ["*"]})
    network = Network(mode="macvlan", interface="no-such", subnet=SUBNET)
    check(release(namespace, network), network, user, said)
    (warning,) = said.warnings
    assert warning == (
        "preflight could not check Multus' daemons, NetworkAttachmentDefinitions of other"
        " namespaces, Services, nodes (forbidden); problems there appear when pods start [unseen]"
    )


def test_who_may_not_exec_sees_the_rest(
    namespace: str, as_user: Callable[..., Any], said: Any
) -> None:
    """Without the right to exec, machines are not looked at, and what objects tell is found."""
    seen = ["nodes", "pods", "daemonsets", "network-attachment-definitions", "servicecidrs"]
    user = as_user({"apiGroups": ["*"], "resources": seen, "verbs": ["get", "list"]})
    node = user.nodes()[0]
    network = Network(mode="macvlan", interface="no-such", subnet=node["spec"]["podCIDR"])
    with pytest.raises(UserError, match=r"\[pod-network\]$"):
        check(release(namespace, network), network, user, said)
    (warning,) = said.warnings
    assert f"interfaces and CNI programs of {node['metadata']['name']}" in warning
    assert warning.endswith(" (forbidden); problems there appear when pods start [unseen]")
