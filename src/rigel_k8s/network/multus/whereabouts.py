"""whereabouts on every machine: its program, its files, and what releases unused addresses."""

from __future__ import annotations

from typing import Any

from rigel_k8s.network.multus import RELEASE
from rigel_k8s.network.multus.machines import (
    Machines,
    config_map,
    daemon_set,
    fields,
    host,
    keeper,
    mount,
    volumes,
)
from rigel_k8s.network.multus.rights import WHEREABOUTS
from rigel_k8s.objects.naming import labels, selector

Object = dict[str, Any]

#: Where the program reads its files on every machine, independent of the runtime's directories: so
#: an attachment is the same on k3s as elsewhere.
PLACE = "/etc/cni/net.d/whereabouts.d"
#: Upstream's hour. It releases the addresses of machines that were removed. If it ran more often,
#: it would more often meet a pod whose address is given out and not yet in its annotation.
SCHEDULE = "30 4 * * *"
NAME = "rigel-whereabouts-reconciler"
#: Seconds: whereabouts' programs ignore the signal to end, and have nothing to clean up.
GRACE = 2


def address_keeper(machines: Machines, script: Object, image: str) -> Object:
    """Return the DaemonSet for the machines of one platform."""
    env = {
        "PROGRAMS": "whereabouts",
        "SOURCE": "",
        "IPAM_DIR": f"/host{PLACE}",
        "IPAM_PATH": PLACE,
        "NAMESPACE": RELEASE.namespace,
    }
    pod = {
        "terminationGracePeriodSeconds": GRACE,
        "containers": [
            keeper(machines, "whereabouts", image, env, [mount("etc-cni", "/host/etc/cni")]),
            _control_loop(image),
        ],
        "volumes": [*volumes(machines), host("etc-cni", "/etc/cni", "DirectoryOrCreate")],
    }
    return daemon_set(machines, WHEREABOUTS, pod, [script])


def _control_loop(image: str) -> Object:
    """Return the container that releases addresses of pods that ended without releasing them."""
    return {
        "name": "control-loop",
        "image": image,
        "imagePullPolicy": "IfNotPresent",
        "command": ["/ip-control-loop", "-log-level", "error"],
        "env": fields(NODENAME="spec.nodeName", WHEREABOUTS_NAMESPACE="metadata.namespace"),
        "resources": {"requests": {"cpu": "10m", "memory": "32Mi"}, "limits": {"memory": "256Mi"}},
        "securityContext": _reader(),
        "terminationMessagePolicy": "FallbackToLogsOnError",
        "volumeMounts": [mount("etc-cni", "/host/etc/cni", read_only=True)],
    }


def _reader() -> Object:
    return {
        "runAsUser": 0,  # root owns the account's files on the machine
        "allowPrivilegeEscalation": False,
        "readOnlyRootFilesystem": True,
        "capabilities": {"drop": ["ALL"]},
        "seLinuxOptions": {"type": "spc_t"},
    }


def reconciler(image: str) -> tuple[Object, Object]:
    """Return the objects that release addresses of removed machines: a schedule, a Deployment."""
    schedule = config_map(NAME, {"cron-expression": SCHEDULE})
    container = {
        "name": "reconciler",
        "image": image,
        "imagePullPolicy": "IfNotPresent",
        "command": ["/ip-reconciler", "-log-level", "error"],
        "env": fields(WHEREABOUTS_NAMESPACE="metadata.namespace"),
        "resources": {"requests": {"cpu": "5m", "memory": "16Mi"}, "limits": {"memory": "256Mi"}},
        "securityContext": {
            "allowPrivilegeEscalation": False,
            "readOnlyRootFilesystem": True,
            "capabilities": {"drop": ["ALL"]},
        },
        "terminationMessagePolicy": "FallbackToLogsOnError",
        "volumeMounts": [mount("schedule", "/cron-schedule", read_only=True)],
    }
    items = [{"key": "cron-expression", "path": "config"}]
    spec = {
        "serviceAccountName": WHEREABOUTS,
        "terminationGracePeriodSeconds": GRACE,
        "priorityClassName": "system-cluster-critical",
        "nodeSelector": {"kubernetes.io/os": "linux"},
        # Not NoExecute: from a lost machine it moves to another.
        "tolerations": [{"operator": "Exists", "effect": "NoSchedule"}],
        "containers": [container],
        "volumes": [{"name": "schedule", "configMap": {"name": NAME, "items": items}}],
    }
    return schedule, _deployment(spec)


def _deployment(pod: Object) -> Object:
    """Return a Deployment of one pod: two would release addresses twice."""
    return {
        "apiVersion": "apps/v1",
        "kind": "Deployment",
        "metadata": {
            "name": NAME,
            "namespace": RELEASE.namespace,
            "labels": labels(NAME, RELEASE.name),
        },
        "spec": {
            "replicas": 1,
            "strategy": {"type": "Recreate"},
            "selector": {"matchLabels": selector(NAME)},
            "template": {"metadata": {"labels": labels(NAME, RELEASE.name)}, "spec": pod},
        },
    }
