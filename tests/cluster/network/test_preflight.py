"""Preflight on real machines: what each lacks is found out before anything is applied."""

from __future__ import annotations

import subprocess
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.app.generation import GENERATIONS
from rigel_k8s.errors import UserError
from rigel_k8s.kube import connect
from rigel_k8s.network.modes import network_objects, wire_pod
from rigel_k8s.network.options import Network
from rigel_k8s.network.plan import network_plan
from rigel_k8s.network.wiring import PodIdentity
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.settings import Settings
from rigel_multus.preflight.examine import examine
from tests.cluster.rights import wait_for_right, write_kubeconfig
from tests.support.preflight import check

pytestmark = [pytest.mark.cluster, pytest.mark.usefixtures("multus")]

SUBNET = "10.202.0.0/24"
Ask = Callable[..., list[str]]


def release(namespace: str, network: Network, **spec: Any) -> list[dict[str, Any]]:
    """A release's objects as the network rooms make them."""
    pod = PodIdentity("talker", "ros:jazzy")
    plan = network_plan(
        network,
        namespace=namespace,
        release="demo",
        ros=GENERATIONS["2"],
        distro="jazzy",
        pods=[pod],
    )
    return [
        *(item for _, item in network_objects(plan)),
        deployment(plan, pod, spec),
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

    def call(*, spec: Any = None, **options: Any) -> list[str]:
        network = Network(**{"mode": "macvlan", "interface": "eth0", "subnet": SUBNET} | options)
        found = examine(release(namespace, network, **(spec or {})), network, cluster)
        return [f"{f.severity} {f.kind}: {f.message}" for f in found]

    return call


@pytest.fixture
def machines(context: str, lab: Any) -> dict[str, str]:
    """The nodes of a local cluster, and their network namespaces, to which a test may add links."""
    name = context.removeprefix("rigel-")
    found = {node: f"rigel-{name}-{node}" for node in lab.nodes}
    if not all(Path("/run/netns", netns).exists() for netns in found.values()):
        pytest.skip("only a local cluster's machines can be added to")
    return found


def ip(netns: str, *words: str) -> None:
    """Run `ip` in a network namespace."""
    subprocess.run(["ip", "-n", netns, *words], check=True)


@pytest.fixture
def link(machines: dict[str, str]) -> Iterator[str]:
    """An Ethernet interface that all machines have but the last one; gone after the test."""
    name = f"pf{uuid.uuid4().hex[:6]}"
    having = list(machines.values())[:-1]
    for one in having:
        ip(one, "link", "add", name, "type", "veth", "peer", "name", f"{name}p")
        ip(one, "link", "set", name, "up")
        ip(one, "link", "set", f"{name}p", "up")
    yield name
    for one in having:
        ip(one, "link", "delete", name)


def test_all_is_well(ask: Ask) -> None:
    """Nothing is found on machines where macvlan works; `static` likewise."""
    assert ask() == []
    assert ask(ipam="static") == []


def test_missing_on_one_machine(ask: Ask, machines: dict[str, str], link: str) -> None:
    """An interface that one of the machines lacks is told with that machine's name, and not where
    pods are kept away from it."""
    *others, last = machines
    assert ask(interface=link) == [
        f"error interface-missing: {last} has no interface {link} (there: eth0)"
    ]
    assert ask(interface=link, spec={"nodeSelector": {"kubernetes.io/hostname": others[0]}}) == []


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
