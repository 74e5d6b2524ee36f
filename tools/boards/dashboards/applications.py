"""The first dashboard: what runs where, whether it is healthy, what changed, what it costs."""

from __future__ import annotations

from tools.boards.board import APPLICATION, NAMESPACE, ROS_NODE, Board, Row
from tools.boards.panels import Panel, Query, curves, link, number, states, table, value_names
from tools.boards.selectors import (
    APP,
    HOST_NETWORK,
    NODE,
    OURS,
    by_ros_node,
    graph_link,
    logs_link,
    per_pod,
    to_logs,
)

RUNBOOKS = "https://github.com/rigel-k8s/rigel-k8s/blob/main/docs/runbooks"
NOTHING = "no pod of a rigel application in this choice"
LOGS = [logs_link("namespace", "application", "ros_node"), graph_link("namespace", "application")]
#: For pods without a ROS name.
OTHER_LOGS = [logs_link("namespace", "application"), graph_link("namespace", "application")]
READY = 'kube_pod_status_ready{condition="true"}'


def board() -> Board:
    """Return the dashboard."""
    return Board(
        "rigel-applications",
        "ROS applications",
        "What runs where, is it healthy, what changed, and what it costs.",
        [
            Row("Is it healthy?", [(4, panel) for panel in health()], height=4),
            Row("What is wrong, and what runs where", [(24, alerts()), (24, pods())]),
            Row("What changed", [(12, ready()), (12, changes())]),
            Row("What it costs, by ROS node", [(12, panel) for panel in costs()]),
        ],
        [NAMESPACE, APPLICATION, ROS_NODE],
    )


def health() -> list[Panel]:
    """Return the numbers at the top."""
    return [
        number(
            "Pods ready",
            "Pods whose ROS nodes are registered and answer, as Kubernetes' readiness probes see "
            "them.",
            Query(f"sum({per_pod(READY)})", now=True),
            empty=NOTHING,
        ),
        number(
            "Pods not ready",
            "Pods that start, hang, wait for their image or crash. During a roll-out a few are "
            "normal.",
            Query(f"sum(1 - {per_pod(READY)})", now=True),
            empty=NOTHING,
            yellow=1,
        ),
        number(
            "ROS nodes up",
            "Nodes that are in the ROS graph and answered the exporter.",
            Query(
                f"sum(max by (namespace, application, ros_node) (ros_node_up{{{NODE}}}))", now=True
            ),
            empty="no ROS metrics (ros_metrics is off)",
        ),
        number(
            "ROS nodes gone",
            "Nodes that are expected, or were seen before, and do not answer now.",
            Query(
                f"sum(max by (namespace, application, ros_node) (1 - ros_node_up{{{NODE}}}))",
                now=True,
            ),
            empty="no ROS metrics (ros_metrics is off)",
            red=1,
        ),
        number(
            "Restarts in the last hour",
            "Containers that ended and were started again by Kubernetes; roll-outs do not count.",
            Query(
                f"round(sum({per_pod('increase(kube_pod_container_status_restarts_total[1h])')}))",
                now=True,
            ),
            empty=NOTHING,
            yellow=1,
            red=5,
        ),
        number(
            "Errors logged in 5 minutes",
            "Lines of level error and fatal; click to read them.",
            Query(
                f'sum(count_over_time({{{NODE}, level=~"error|fatal"}}[5m]))',
                source="logs",
                now=True,
            ),
            empty="none",
            yellow=1,
            red=100,
            links=[to_logs(level="error", namespace="$namespace", application="$application")],
        ),
    ]


def alerts() -> Panel:
    """Return the alerts that fire."""
    firing = 'ALERTS{alertstate="firing", namespace=~"$namespace|", application=~"$application|"}'
    runbook = link("What to do", f"{RUNBOOKS}/${{__data.fields.Alert}}.md", new_tab=True)
    return table(
        "Alerts that fire",
        "From Prometheus' rules; click on an alert's name to read what it means and what to do.",
        [Query(firing, now=True)],
        columns={
            "alertname": "Alert",
            "severity": "Severity",
            "application": "Application",
            "ros_node": "ROS node",
            "workload": "Workload",
            "topic": "Topic",
            "node": "Machine",
            "namespace": "Namespace",
        },
        empty="No alert fires.",
        special={"Alert": {"links": [runbook.build()]}},
    )


def pods() -> Panel:
    """Return each pod with its place, its health and its age."""
    restarts = "kube_pod_container_status_restarts_total"
    words = value_names({0: ("not ready", "red"), 1: ("ready", "green")})
    here = to_logs(
        namespace='${__data.fields["Namespace"]}',
        application='${__data.fields["Application"]}',
        ros_node='${__data.fields["ROS node"]}',
    )
    return table(
        "What runs where",
        "Each pod of the chosen applications: the ROS node in it, the machine it is on, whether "
        "it is "
        "ready, how often it was restarted, how long it has been there. Click on a ROS node for "
        "its logs.",
        [
            Query(per_pod(READY), now=True),
            Query(per_pod(restarts), now=True),
            Query(per_pod("time() - kube_pod_created"), now=True),
        ],
        columns={
            "application": "Application",
            "ros_node": "ROS node",
            "workload": "Workload",
            "pod": "Pod",
            "node": "Machine",
            "Value #A": "Ready",
            "Value #B": "Restarts",
            "Value #C": "Age",
            "namespace": "Namespace",
        },
        empty=NOTHING,
        special={
            "Ready": {"mappings": words, "custom.cellOptions": {"type": "color-text"}},
            "Age": {"unit": "dtdurations"},
            "ROS node": {"links": [here.build()]},
        },
    )


def ready() -> Panel:
    """Return when each ROS node was ready."""
    shown = f"max by (namespace, application, workload, ros_node) ({per_pod(READY)})"
    return states(
        "Ready, by workload",
        "When each workload's pod was ready. In a gap there was no pod: a roll-out, or a lost "
        "machine.",
        [Query(shown, "{{workload}}")],
        names={0: ("not ready", "red"), 1: ("ready", "green")},
        empty=NOTHING,
        links=OTHER_LOGS,
    )


def changes() -> Panel:
    """Return the roll-outs."""
    changed = f"changes(workload:kube_deployment_metadata_generation:max{{{APP}}}[5m])"
    return curves(
        "Roll-outs in 5 minutes",
        "How often each workload was changed: a deploy, an update, a rollback, a scaling. The "
        "blue marks in all curves show the same times.",
        [Query(f"sum by (namespace, application, workload) ({changed})", "{{workload}}")],
        unit="none",
        empty=NOTHING,
        links=[logs_link("namespace", "application")],
    )


def costs() -> list[Panel]:
    """Return CPU, memory, restarts and network by ROS node."""
    return [
        curves(
            "CPU",
            "Cores that each ROS node uses, mean of two minutes; roscore and the exporter have "
            "their workloads' names.",
            by_ros_node("ros_node:container_cpu_usage_seconds:rate2m"),
            unit="suffix: cores",
            empty=NOTHING,
            links=LOGS,
            special={"B": OTHER_LOGS},
        ),
        curves(
            "Memory",
            "The working set, which counts against the container's limit. A line that only rises "
            "is a leak.",
            by_ros_node("ros_node:container_memory_working_set_bytes:sum"),
            unit="bytes",
            empty=NOTHING,
            links=LOGS,
            special={"B": OTHER_LOGS},
        ),
        curves(
            "Restarts in 15 minutes",
            "Containers that ended and were started again.",
            by_ros_node("ros_node:kube_pod_container_status_restarts:increase15m"),
            unit="none",
            empty=NOTHING,
            links=LOGS,
            special={"B": OTHER_LOGS},
        ),
        network(),
    ]


def network() -> Panel:
    """Return what pods send and receive."""

    def flow(direction: str) -> str:
        counted = f"rate(container_network_{direction}_bytes_total[2m])"
        own = f"({counted} unless on (namespace, pod) {HOST_NETWORK})"
        seen = f"sum by (namespace, pod) {own}"
        joined = f"{seen} * on (namespace, pod) group_left (application, workload, ros_node) {OURS}"
        return f"sum by (namespace, application, workload) ({joined})"

    return curves(
        "Network",
        "What each pod sends (above) and receives (below) on all its interfaces together. Pods on "
        "the machine's own network are missing, since their traffic is not counted separately.",
        [
            Query(flow("transmit"), "{{workload}} sends"),
            Query(f"-{flow('receive')}", "{{workload}} receives"),
        ],
        unit="binBps",
        empty="no pod with a network of its own, or its bytes are not counted",
        least=None,
        links=[logs_link("namespace", "application")],
    )
