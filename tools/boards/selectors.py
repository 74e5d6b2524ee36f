"""Common parts of the dashboards' queries: the variables as selectors, and links between them.

The names of labels and recorded series come from docs/observability.md and the rule files.
"""

from __future__ import annotations

from grafana_foundation_sdk.builders.dashboard import DashboardLink

from tools.boards.panels import Query, link

#: The chosen applications, and the chosen ROS nodes of them.
APP = 'namespace=~"$namespace", application=~"$application"'
NODE = f'{APP}, ros_node=~"$ros_node"'
#: The chosen pods, each 1.
OURS = f"pod:rigel_identity:info{{{NODE}}}"

#: Pods on the machine's own network: their counters contain the whole machine's traffic.
HOST_NETWORK = 'kube_pod_info{host_network="true"}'


def per_pod(expr: str) -> str:
    """Return `expr`, a value by namespace and pod, with all labels of our pods."""
    return (
        f"max by (namespace, pod) ({expr}) * on (namespace, pod) "
        f"group_left (application, workload, ros_node, node) {OURS}"
    )


def to_logs(**values: str) -> DashboardLink:
    """Return a link to the logs of the clicked value, in the same time; values by variable."""
    return link("Logs of this", address("rigel-logs", values))


def to_graph(**values: str) -> DashboardLink:
    """Return a link to the ROS graph around the clicked value, in the same time."""
    return link("ROS graph and topics", address("rigel-ros-graph", values))


def address(uid: str, values: dict[str, str]) -> str:
    """Return a dashboard's address, relative to Grafana's own; the sources stay as chosen."""
    asked = "".join(f"&var-{name}={value}" for name, value in values.items())
    return f"/d/{uid}?${{__url_time_range}}&${{metrics:queryparam}}&${{logs:queryparam}}{asked}"


def logs_link(*names: str) -> DashboardLink:
    """Return a link to logs that takes these labels of the series clicked on."""
    return to_logs(**{name: f"${{__field.labels.{name}}}" for name in names})


def graph_link(*names: str) -> DashboardLink:
    """Return a link to the ROS graph that takes these labels of the series clicked on."""
    return to_graph(**{name: f"${{__field.labels.{name}}}" for name in names})


def by_ros_node(expr: str) -> list[Query]:
    """Return a recorded value by ROS node, and by workload for pods without a ROS name."""
    named = f'{expr}{{{NODE}, ros_node!=""}}'
    unnamed = f'{expr}{{{NODE}, ros_node=""}}'
    return [Query(named, "{{ros_node}}"), Query(unnamed, "{{workload}}")]
