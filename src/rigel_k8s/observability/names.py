"""The names that the stack, its dashboards, the exporter and the command line share.

Dashboards and rules contain the queries; the names in them are defined here and documented in
docs/observability.md. A changed name is a changed contract: people have dashboards of their own.
"""

from __future__ import annotations

#: The stack's release.
RELEASE = "rigel-observability"
#: Where it is unless an option says otherwise, and where to look for it without the right to list
#: all namespaces.
NAMESPACE = "monitoring"
#: On all pods that watch ROS but are not ROS nodes.
COMPONENT = {"app.kubernetes.io/component": "observability"}

#: The Services of the stack, in its namespace, and their ports.
LOKI, LOKI_PORT = "loki", 3100
PROMETHEUS, PROMETHEUS_PORT = "prometheus", 9090
GRAFANA, GRAFANA_PORT = "grafana", 3000

#: The ROS exporter: a workload of each application's release, beside its nodes.
EXPORTER, EXPORTER_PORT = "ros-exporter", 9419

#: The labels of pods' log streams and metrics, the same in Loki and Prometheus, and where
#: Prometheus finds each in a pod: `rigel-k8s/release`, `app.kubernetes.io/name`,
#: `rigel-k8s/ros-name`, and parts of its metadata.
LABELS = {
    "application": "__meta_kubernetes_pod_label_rigel_k8s_release",
    "workload": "__meta_kubernetes_pod_label_app_kubernetes_io_name",
    "ros_node": "__meta_kubernetes_pod_annotation_rigel_k8s_ros_name",
    "namespace": "__meta_kubernetes_namespace",
    "pod": "__meta_kubernetes_pod_name",
    "container": "__meta_kubernetes_pod_container_name",
    "node": "__meta_kubernetes_pod_node_name",
}

#: The label `level` of a log line, read from ROS 1's and ROS 2's formats; "" if none is found.
LEVELS = ("debug", "info", "warn", "error", "fatal")
