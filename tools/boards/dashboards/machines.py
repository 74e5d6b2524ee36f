"""The dashboard of the cluster's nodes, called machines here: for robotics, a node is a ROS node.

Each query reads from node_exporter, or else from cAdvisor, which every kubelet has.
"""

from __future__ import annotations

from tools.boards.board import Board, Row, choice
from tools.boards.panels import Panel, Query, curves, number, table, value_names
from tools.boards.selectors import HOST_NETWORK

MACHINE = 'node=~"$node"'
NOTHING = "no machine in this choice, or kube-state-metrics and cAdvisor are not read"


def board() -> Board:
    """Return the dashboard."""
    node = choice("node", "Machine", "label_values(kube_node_info, node)", ".+")
    return Board(
        "rigel-machines",
        "Cluster nodes",
        "CPU, memory, disk and network of the machines that Kubernetes runs on, and the nodes on "
        "them.",
        [
            Row("Now", [(6, panel) for panel in numbers()], height=4),
            Row("Machines", [(24, machines())]),
            Row("What is used", [(12, panel) for panel in used()]),
            Row("Network and volumes", [(12, panel) for panel in moved()]),
        ],
        [node],
        rollouts=False,
    )


def capacity(resource: str) -> str:
    """Return each machine's capacity of a resource, in its base unit."""
    return f'max by (node) (kube_node_status_capacity{{{MACHINE}, resource="{resource}"}})'


def share(used: str, resource: str) -> str:
    """Return the part of a machine's resource that is used, 0 to 1."""
    return f"{used}{{{MACHINE}}} / on (node) {capacity(resource)}"


def asked_for(resource: str) -> str:
    """Return the part of a machine's resource that pods reserve, 0 to 1."""
    asked = f'kube_pod_container_resource_requests{{{MACHINE}, resource="{resource}"}}'
    return f"sum by (node) ({asked}) / on (node) {capacity(resource)}"


def numbers() -> list[Panel]:
    """Return the numbers at the top."""
    ready = f'kube_node_status_condition{{{MACHINE}, condition="Ready", status="true"}}'
    pressure = f'kube_node_status_condition{{{MACHINE}, condition=~".*Pressure", status="true"}}'
    return [
        number(
            "Machines ready",
            "Machines whose kubelet reports that it can run pods.",
            Query(f"sum(max by (node) ({ready}))", now=True),
            empty=NOTHING,
        ),
        number(
            "Machines not ready",
            "After five minutes, their pods start on other machines.",
            Query(f"sum(1 - max by (node) ({ready}))", now=True),
            empty=NOTHING,
            red=1,
        ),
        number(
            "Under pressure",
            "Machines short of memory, disk or process ids: Kubernetes evicts pods from them.",
            Query(f"sum(max by (node) ({pressure}))", now=True),
            empty=NOTHING,
            red=1,
        ),
        number(
            "Fullest disk",
            "Of all chosen machines; at 90 % the alert DiskNearlyFull fires.",
            Query(f"max(node:filesystem_used:ratio{{{MACHINE}}})", now=True),
            unit="percentunit",
            empty="neither node_exporter nor cAdvisor reports disks",
            yellow=0.8,
            red=0.9,
        ),
    ]


def machines() -> Panel:
    """Return each machine with what is on it."""
    condition = f'kube_node_status_condition{{{MACHINE}, condition="Ready", status="true"}}'
    ours = f'pod:rigel_identity:info{{{MACHINE}, ros_node!=""}}'
    return table(
        "Machines",
        "Requested is what pods reserve with their requests; the rest is free for new pods.",
        [
            Query(f"max by (node) ({condition})", now=True),
            Query(f"count by (node) ({ours}) or 0 * max by (node) ({condition})", now=True),
            Query(share("node:cpu_used:rate2m", "cpu"), now=True),
            Query(share("node:memory_used_bytes:sum", "memory"), now=True),
            Query(asked_for("cpu"), now=True),
        ],
        columns={
            "node": "Machine",
            "Value #A": "Ready",
            "Value #B": "ROS nodes",
            "Value #C": "CPU",
            "Value #D": "Memory",
            "Value #E": "CPU requested",
        },
        empty=NOTHING,
        special={
            "Ready": {"mappings": value_names({0: ("no", "red"), 1: ("yes", "green")})},
            "CPU": {"unit": "percentunit"},
            "Memory": {"unit": "percentunit"},
            "CPU requested": {"unit": "percentunit"},
        },
    )


def used() -> list[Panel]:
    """Return CPU, memory, disk and ROS nodes over time."""
    return [
        curves(
            "CPU",
            "The busy part of all cores, mean of two minutes.",
            [Query(share("node:cpu_used:rate2m", "cpu"), "{{node}}")],
            unit="percentunit",
            empty=NOTHING,
            most=1,
            red=0.9,
        ),
        curves(
            "Memory",
            "The part that is in use and cannot be reclaimed.",
            [Query(share("node:memory_used_bytes:sum", "memory"), "{{node}}")],
            unit="percentunit",
            empty=NOTHING,
            most=1,
            red=0.9,
        ),
        curves(
            "Fullest disk",
            "The fullest of each machine's disks.",
            [Query(f"node:filesystem_used:ratio{{{MACHINE}}}", "{{node}}")],
            unit="percentunit",
            empty="neither node_exporter nor cAdvisor reports disks",
            most=1,
            red=0.9,
        ),
        curves(
            "ROS nodes on it",
            "Pods with a ROS node, by machine.",
            [
                Query(
                    f'count by (node) (pod:rigel_identity:info{{{MACHINE}, ros_node!=""}})',
                    "{{node}}",
                )
            ],
            unit="none",
            empty="no ROS node runs",
            stacked=True,
        ),
    ]


def moved() -> list[Panel]:
    """Return network by machine and the fill of volumes."""

    def flow(direction: str) -> str:
        machine = (
            f'node_network_{direction}_bytes_total{{{MACHINE}, device!~"lo|veth.*|cni.*|cali.*"}}'
        )
        counted = f'rate(container_network_{direction}_bytes_total{{{MACHINE}, pod!=""}}[2m])'
        pods = f"{counted} unless on (namespace, pod) {HOST_NETWORK}"
        return f"sum by (node) (rate({machine}[2m])) or on (node) sum by (node) ({pods})"

    return [
        curves(
            "Network",
            "What each machine sends (above) and receives (below): its own interfaces where "
            "node_exporter "
            "runs, else its pods' traffic.",
            [
                Query(flow("transmit"), "{{node}} sends"),
                Query(f"-({flow('receive')})", "{{node}} receives"),
            ],
            unit="binBps",
            empty="neither node_exporter nor cAdvisor reports networks",
            least=None,
        ),
        curves(
            "Volumes",
            "How full each claim is; the kubelet does not report all kinds of storage.",
            [
                Query(
                    "1 - max by (namespace, persistentvolumeclaim) "
                    "(kubelet_volume_stats_available_bytes)"
                    " / max by (namespace, persistentvolumeclaim) "
                    "(kubelet_volume_stats_capacity_bytes)",
                    "{{namespace}}/{{persistentvolumeclaim}}",
                )
            ],
            unit="percentunit",
            empty="no volume whose storage reports its use",
            most=1,
            red=0.9,
        ),
    ]
