"""What only the cluster would refuse has its place in the Rigelfile."""

from __future__ import annotations

import pytest

from .shapes import problems

LAN = "ros: '2', network: {mode: macvlan, interface: eth0, subnet: 10.20.0.0/24}"
NETWORKS = "k8s.v1.cni.cncf.io/networks"
MULTUS = f"patch: {{spec: {{template: {{metadata: {{annotations: {{{NETWORKS}: %s}}}}}}}}}}"
POD = "patch: {spec: {template: {spec: {%s}}}}"
STORE = "persistent_storage: {volumes: [{name: v}, {name: w, mount_path: /w}]}"
MEMORY = "{memory: 1Mi, mount_path: %s}"
#: The job, a node, the kind, and the place below the node; "" for none.
CASES = [
    ("", f"volumes: [{MEMORY % '/a'}, {MEMORY % '/a/'}]", "conflict", "volumes.1"),
    ("", f"volumes: [{MEMORY % '/a'}, {MEMORY % '/a/b'}]", "", ""),
    (STORE, f"volumes: [v, {MEMORY % '/persistent/v'}]", "conflict", "volumes.1"),
    (STORE, "volumes: [w, {name: v, mount_path: /w}]", "conflict", "volumes.1"),
    ("", f"volumes: [{MEMORY % '/rigel-k8s'}]", "conflict", "volumes.0"),
    (LAN, f"volumes: [{MEMORY % '/etc/machine-id'}]", "conflict", "volumes.0"),
    (f"{LAN}, middleware: cyclonedds", f"volumes: [{MEMORY % '/etc/machine-id'}]", "", ""),
    ("", f"volumes: [{MEMORY % '/etc/machine-id'}]", "", ""),
    (
        "",
        f"devices: [/dev/a, /dev/a], {'security_context: {privileged: true}'}",
        "conflict",
        "devices.1",
    ),
    ("", "ports: [80, 80]", "conflict", "ports.1"),
    ("", "ports: [80, {port: 80, protocol: UDP}]", "", ""),
    ("", "ports: [{port: 80, name: a}, {port: 81, name: a}]", "conflict", "ports.1"),
    ("", "ports: [80, {port: 81, service_port: 80}]", "conflict", "ports.1"),
    ("", "service_type: NodePort", "incomplete", "service_type"),
    ("", "ports: [80], service_type: NodePort", "", ""),
    ("", "resources: {limits: {gpu: 1}}", "bad-resource", "resources.limits.gpu"),
    ("", "resources: {limits: {memmory: 1Gi}}", "bad-resource", "resources.limits.memmory"),
    ("", "resources: {limits: {hugepages-2Mi: 4Mi, nvidia.com/gpu: 1}}", "", ""),
    ("", "resources: {limits: {memory: 512m}}", "bad-quantity", "resources.limits.memory"),
    (
        "",
        "resources: {requests: {cpu: 2}, limits: {cpu: 1}}",
        "conflict",
        "resources.requests.cpu",
    ),
    (
        "",
        "security_context: {capabilities: {add: [NET_ADMIN, CAP_SYS_NICE]}}",
        "bad-name",
        "security_context.capabilities.add.1",
    ),
    ("", "security_context: {privileged: 'true'}", "wrong-type", "security_context.privileged"),
    ("", "security_context: {runAsUser: robot}", "wrong-type", "security_context.runAsUser"),
    ("", "security_context: {priviledged: true}", "unknown-key", "security_context.priviledged"),
    ("", "security_context: {runAsUser: 1000, seccompProfile: {type: x}}", "", ""),
    (
        "",
        "volumes: [{secret: s, mount_path: /a, sub_path: ../x}]",
        "bad-path",
        "volumes.0.sub_path",
    ),
    ("", "volumes: [{secret: s, mount_path: /a, sub_path: x/..y}]", "", ""),
    ("", "patch: {kind: DaemonSet}", "fixed-field", "patch.kind"),
    ("", "patch: {kind: Deployment, apiVersion: apps/v1}", "", ""),
    ("", POD % "hostnetwork: true", "unknown-key", "patch.spec.template.spec.hostnetwork"),
    ("", POD % "hostNetwork: true, newField: 1", "", ""),
    (
        "",
        POD % "containers: [{name: ros-node, workdir: /a}]",
        "unknown-key",
        "patch.spec.template.spec.containers.0.workdir",
    ),
    (
        "",
        "patch: {metadata: {annotations: {a: 1}}}",
        "wrong-type",
        "patch.metadata.annotations.a",
    ),
    ("", "patch: {metadata: {annotations: {a: '1', b: null}}}", "", ""),
    ("", "patch: {hostNetwork: true}", "unknown-key", "patch.hostNetwork"),
    ("", "patch: {spec: {nodeName: r}}", "unknown-key", "patch.spec.nodeName"),
    (LAN, MULTUS % "other", "conflict", "patch.spec.template.metadata.annotations." + NETWORKS),
    (LAN, MULTUS % "other@net1", "", ""),
    ("", MULTUS % "other", "", ""),
]


@pytest.mark.parametrize(("job", "node", "kind", "place"), CASES)
def test_it_is_refused_before(job: str, node: str, kind: str, place: str) -> None:
    text = f"{{image: a, {job}{',' * bool(job)} nodes: {{n: {{args: x, {node}}}}}}}"
    found = [p for p in problems(text) if p.severity == "error"]
    expected = [(kind, f"nodes.n.{place}")] if kind else []
    assert [(p.kind, ".".join(map(str, p.path))) for p in found] == expected


@pytest.mark.parametrize(
    ("job", "node", "words"),
    [
        ("", "host_network: true", "ports of its machine already"),
        ("network: host", "", "ports of its machine already"),
        (LAN, "", "the second network reaches the node"),
        ("", "", None),
    ],
)
def test_a_node_that_is_reached_anyway_needs_no_type(
    job: str, node: str, words: str | None
) -> None:
    """Of its Service; one that is reached from the cluster alone opens nothing."""
    for kind, expected in (("NodePort", words), ("LoadBalancer", words), ("ClusterIP", None)):
        text = f"{{image: a, {job}{',' * bool(job)} nodes: {{n: {{args: x, ports: [80], {node}"
        found = problems(f"{text}{',' * bool(node)} service_type: {kind}}}}}}}")
        messages = [p.message for p in found if p.kind == "reachable"]
        assert [expected in one for one in messages if expected] == [True] * bool(expected)
        assert len(messages) == bool(expected)
