"""kube-state-metrics (Kubernetes' pods and nodes) and node_exporter (the machines)."""

from __future__ import annotations

from collections.abc import Iterator

from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.naming import NAME_LABEL, ROS_NAME_ANNOTATION
from rigel_k8s.objects.podsecurity import pod_context
from rigel_k8s.observability.manifests.frame import (
    Object,
    container,
    http_probes,
    mount,
    rule,
)
from rigel_k8s.observability.manifests.images import KUBE_STATE_METRICS_IMAGE, NODE_EXPORTER_IMAGE
from rigel_k8s.observability.manifests.scraping import KUBE_STATE_METRICS, NODE_EXPORTER
from rigel_k8s.observability.manifests.stack import Stack

USER = 65534
KUBE_STATE_METRICS_PORT, NODE_EXPORTER_PORT = 8080, 9100
WATCH = ["list", "watch"]
ROOT = "/host"
STATE_DEFAULTS = {
    "requests": {"cpu": "10m", "memory": "48Mi"},
    "limits": {"memory": "256Mi"},
}
NODE_DEFAULTS = {
    "requests": {"cpu": "10m", "memory": "24Mi"},
    "limits": {"memory": "128Mi"},
}


def kube_state_metrics(stack: Stack) -> Iterator[Object]:
    """Yield kube-state-metrics' objects; it exports which ROS node a pod runs."""
    frame, name = stack.frame, KUBE_STATE_METRICS
    yield frame.account(name)
    yield from frame.rights(
        name,
        [rule("", ["pods", "nodes"], WATCH), rule("apps", ["deployments", "daemonsets"], WATCH)],
    )
    yield frame.service(name, KUBE_STATE_METRICS_PORT)
    yield frame.deployment(name, _state_pod(stack))


def _state_pod(stack: Stack) -> Object:
    main = container(
        KUBE_STATE_METRICS,
        stack.kube_state_metrics,
        KUBE_STATE_METRICS_IMAGE,
        STATE_DEFAULTS,
        args=[
            "--resources=pods,nodes,deployments,daemonsets",
            f"--metric-labels-allowlist=pods=[{RELEASE_LABEL},{NAME_LABEL}]",
            f"--metric-annotations-allowlist=pods=[{ROS_NAME_ANNOTATION}]",
        ],
        ports=[{"name": "http", "containerPort": KUBE_STATE_METRICS_PORT}],
        **http_probes("/healthz"),
    )
    return {
        "serviceAccountName": KUBE_STATE_METRICS,
        "automountServiceAccountToken": True,
        "securityContext": pod_context(USER),
        "containers": [main],
    }


def node_exporter(stack: Stack) -> Iterator[Object]:
    """Yield node_exporter's objects; it reads the machine's network, processes and disks."""
    frame, name = stack.frame, NODE_EXPORTER
    yield frame.account(name)
    yield frame.daemon_set(name, _node_pod(stack))


def _node_pod(stack: Stack) -> Object:
    main = container(
        NODE_EXPORTER,
        stack.options.node_exporter,
        NODE_EXPORTER_IMAGE,
        NODE_DEFAULTS,
        args=[
            f"--path.rootfs={ROOT}",
            f"--path.procfs={ROOT}/proc",
            f"--path.sysfs={ROOT}/sys",
            f"--path.udev.data={ROOT}/run/udev/data",
            f"--web.listen-address=:{NODE_EXPORTER_PORT}",
            # cAdvisor has the metrics of pods.
            "--collector.filesystem.mount-points-exclude="
            "^/(dev|proc|run|sys|var/lib/(containerd|docker|kubelet|rancher)/.+)($|/)",
            "--collector.netclass.ignored-devices=^(cali|cni|veth|lo)",
            "--collector.netdev.device-exclude=^(cali|cni|veth|lo)",
        ],
        ports=[{"name": "http", "containerPort": NODE_EXPORTER_PORT}],
        volumeMounts=[
            {**mount("root", ROOT, read_only=True), "mountPropagation": "HostToContainer"}
        ],
    )
    probe = {"httpGet": {"path": "/", "port": "http"}, "periodSeconds": 10, "timeoutSeconds": 5}
    return {
        "serviceAccountName": NODE_EXPORTER,
        "hostNetwork": True,
        "hostPID": True,
        "securityContext": pod_context(USER),
        "containers": [{**main, "readinessProbe": probe}],
        "volumes": [{"name": "root", "hostPath": {"path": "/"}}],
    }
