"""Multus, its daemons, the CNI programs and the kernel: each finding with its words."""

from __future__ import annotations

import attrs
import pytest

from rigel_k8s.network.options import Network
from rigel_k8s.network.preflight.attachments import attachment

from .cases import found, machine, nad, node, texts, view, workload

INSTALL = "run `rigel network install`, or set `network: {install: true}` in the Rigelfile"


def test_all_is_well() -> None:
    """Nothing is found where nothing is wrong."""
    assert texts(found()) == []


def test_no_multus() -> None:
    """A cluster without Multus is one finding, whatever else cannot be there either."""
    assert texts(found(seen=view(multus=False, daemons={}, machines={}))) == [
        "error cluster multus-missing: Multus is not installed: the cluster has no kind"
        f" NetworkAttachmentDefinition => {INSTALL}"
    ]


def test_no_daemon_on_a_machine() -> None:
    """A machine that pods may run on and Multus does not is named."""
    daemons = {k: v for k, v in (view().daemons or {}).items() if k == "node1"}
    assert texts(found(seen=view(daemons=daemons))) == [
        "error cluster multus-not-on-node: no Multus daemon runs on node2, where pods of the"
        f" release may run => {INSTALL}; or keep the pods away from these machines with"
        " `placement`"
    ]


def test_no_whereabouts() -> None:
    """A cluster without whereabouts gives no addresses by it; others need none."""
    seen = view(whereabouts=False)
    assert texts(found(seen=seen)) == [
        "error cluster whereabouts-missing: whereabouts is not installed: the cluster has no"
        f" kind IPPool => {INSTALL}; or use another `network.ipam`"
    ]
    assert found(nad(ipam={"type": "static"}), workload(), seen=seen) == []


def test_only_machines_that_pods_may_run_on_count() -> None:
    """A machine that the pods' selector or a taint keeps away may lack everything."""
    tainted = node("node2")
    tainted["spec"]["taints"] = [{"key": "gpu", "effect": "NoSchedule"}]
    bare = view(daemons={"node1": (view().daemons or {})["node1"]})
    pinned = workload(nodeSelector={"kubernetes.io/hostname": "node1"})
    assert found(nad(), pinned, seen=bare) == []
    keeps = attrs.evolve(bare, nodes=[node("node1"), tainted])
    assert found(seen=keeps) == []
    tolerant = workload(tolerations=[{"key": "gpu", "operator": "Exists"}])
    assert [f.kind for f in found(nad(), tolerant, seen=keeps)] == ["multus-not-on-node"]


def test_a_machine_that_is_off_lacks_nothing() -> None:
    """A robot that is off keeps nobody from deploying."""
    seen = view(
        nodes=[node("node1"), node("node2", ready=False)],
        daemons={"node1": (view().daemons or {})["node1"]},
    )
    assert found(seen=seen) == []


def test_a_daemon_that_is_not_ready() -> None:
    """Pods that start while the daemon is away come up without their network: it is told why."""
    daemons = dict(view().daemons or {})
    daemons["node2"] = attrs.evolve(daemons["node2"], state="CrashLoopBackOff")
    assert texts(found(seen=view(daemons=daemons))) == [
        "error cluster multus-not-ready: the Multus daemon on node2 is not ready: CrashLoopBackOff"
        " => kubectl -n kube-system logs multus-node2 -c kube-multus"
    ]


def test_an_attachment_that_is_not_there() -> None:
    """A missing attachment is named with its namespace, beside those that are there."""
    there = attachment(nad("lab", "nets"))
    found_here = found(workload(), seen=view(attachments={there.key: there}))
    assert texts(found_here) == [
        "error rigelfile attachment-missing: the NetworkAttachmentDefinition robot/lan does"
        " not exist (the cluster has: nets/lab) => set `network.attachment` to an existing"
        " one, as NAMESPACE/NAME, or create it"
    ]


def test_an_attachment_that_could_not_be_read_may_be_there() -> None:
    """What may not be read is not called missing."""
    assert found(workload(), seen=view(unread=frozenset({"robot/lan"}))) == []


@pytest.mark.parametrize(
    ("lacking", "remedy"),
    [
        (
            ["macvlan", "whereabouts"],
            "on k3s and kind, set `network: {install: true}`; elsewhere, set"
            " `network.install.plugins_image` to an image that has them, or unpack the CNI"
            " plugins' release in that directory",
        ),
        (["whereabouts"], INSTALL),
    ],
)
def test_a_program_that_a_machine_lacks(lacking: list[str], remedy: str) -> None:
    """The program, the machine and the directory that was looked into are named."""
    recorded = machine().programs["/opt/cni/bin"]
    poor = machine(programs={"/opt/cni/bin": recorded - set(lacking)})
    assert texts(found(seen=view(machines={"node1": machine(), "node2": poor}))) == [
        f"error cluster program-missing: CNI programs are missing on node2: {', '.join(lacking)}"
        f" (looked into /opt/cni/bin) => {remedy}"
    ]


def test_all_programs_of_a_chain_count() -> None:
    """In a list of plugins each of them must be there, and the first one's of addresses."""
    item = nad()
    item["spec"]["config"] = (
        '{"cniVersion": "0.3.1", "plugins": [{"type": "macvlan", "master": "eth0",'
        ' "ipam": {"type": "static"}}, {"type": "tc"}]}'
    )
    assert texts(found(item, workload())) == [
        "error cluster program-missing: CNI programs are missing on node1, node2: tc (looked into"
        " /opt/cni/bin) => put them into that directory on each of these machines"
    ]


def test_a_kernel_without_ipvlan() -> None:
    """A kernel without ipvlan (recorded here), which an existing attachment may use."""
    assert texts(found(nad(type="ipvlan"), workload())) == [
        "error cluster kernel: the kernel of node1, node2 was built without ipvlan => install"
        " a kernel with CONFIG_IPVLAN, or use `mode: peers` or `discovery-server`"
    ]


def test_the_machines_own_network_needs_no_multus() -> None:
    """Nothing of all this is asked of a release on the machines' own network."""
    seen = view(multus=False, daemons={}, machines={})
    host = workload(networks=None, hostNetwork=True)
    assert found(host, seen=seen, network=Network(mode="host")) == []
