"""What the DaemonSets of Multus and whereabouts share: one pod on each machine of a platform."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import attrs

from rigel_k8s.network.multus import RELEASE
from rigel_k8s.network.multus.platform import Platform
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.naming import HOSTNAME, labels, selector

Object = dict[str, Any]
Part = Literal["multus", "whereabouts"]

#: Tolerates all taints: pods that tolerate a machine's taint need the network there too.
EVERYWHERE: Sequence[Object] = ({"operator": "Exists"},)

SCRIPTS = "rigel-network-scripts"
SCRIPT = "/rigel-network/machine.sh"
BROUGHT = "/rigel-network-programs"
#: The standard programs that networks of robots use.
STANDARD = "bridge dhcp host-local ipvlan macvlan ptp static tuning vlan"
#: May write files on the machine and nothing else: only the capability that writing needs.
WRITER: Object = {
    "runAsUser": 0,
    "allowPrivilegeEscalation": False,
    "readOnlyRootFilesystem": True,
    "capabilities": {"drop": ["ALL"], "add": ["DAC_OVERRIDE"]},
    # If SELinux is enforced, an ordinary container may not write the machine's files.
    "seLinuxOptions": {"type": "spc_t"},
}


@attrs.frozen
class Machines:
    """The machines of one DaemonSet, and what it does there.

    Attributes:
        suffix: distinguishes this platform's objects from those of others; "" for the main one.
        only: the names of its machines; None: all that are not in `others`.
        retired: remove what was put onto the machines instead of keeping it.
    """

    platform: Platform
    suffix: str = ""
    only: tuple[str, ...] | None = None
    others: tuple[str, ...] = ()
    retired: bool = False

    def name_object(self, name: str) -> str:
        """Return an object's name."""
        return f"{name}-{self.suffix}" if self.suffix else name

    @property
    def affinity(self) -> Object | None:
        """Where pods may run: Linux, and the right platform."""
        terms: list[Object] = []
        if self.only is not None:
            terms = [_host("In", self.only)]
        elif self.others:
            terms = [_host("NotIn", self.others)]
        if not terms:
            return None
        required = {"nodeSelectorTerms": [{"matchExpressions": terms}]}
        return {"nodeAffinity": {"requiredDuringSchedulingIgnoredDuringExecution": required}}


def _host(operator: str, names: Sequence[str]) -> Object:
    return {"key": HOSTNAME, "operator": operator, "values": sorted(names)}


def host(name: str, path: str, kind: str = "Directory") -> Object:
    """Return a volume: a directory of the machine, which must exist unless `kind` creates it."""
    return {"name": name, "hostPath": {"path": path, "type": kind}}


def mount(name: str, path: str, *, read_only: bool = False, **more: Any) -> Object:
    """Return a volume's place in a container."""
    return {"name": name, "mountPath": path, **({"readOnly": True} if read_only else {}), **more}


def roots(platform: Platform) -> list[Object]:
    """Return the volumes with the machine's CNI configuration and programs."""
    return [host(f"root-{number}", path) for number, path in enumerate(platform.roots)]


def root_mounts(platform: Platform, *, read_only: bool = False) -> list[Object]:
    """Return their mounts at the same paths as on the machine: the daemon and links need that."""
    return [
        mount(f"root-{number}", path, read_only=read_only, mountPropagation="HostToContainer")
        for number, path in enumerate(platform.roots)
    ]


def keeper(
    machines: Machines, part: Part, image: str, env: Mapping[str, str], mounts: Sequence[Object]
) -> Object:
    """Return the container that keeps a part's files on the machine."""
    ready = {"exec": {"command": ["/bin/sh", SCRIPT, "ready"]}}
    return {
        "name": "machine",
        "image": image,
        "imagePullPolicy": "IfNotPresent",
        "command": ["/bin/sh", SCRIPT, "keep"],
        "env": [*variables(machines, part, env), *fields(NODE="spec.nodeName")],
        "resources": {"requests": {"cpu": "5m", "memory": "8Mi"}, "limits": {"memory": "64Mi"}},
        "securityContext": WRITER,
        "startupProbe": {**ready, "periodSeconds": 1, "timeoutSeconds": 5, "failureThreshold": 180},
        "readinessProbe": {**ready, "periodSeconds": 15, "timeoutSeconds": 5},
        "terminationMessagePolicy": "FallbackToLogsOnError",
        "volumeMounts": [
            *root_mounts(machines.platform),
            mount("scripts", "/rigel-network", read_only=True),
            mount("programs", BROUGHT),
            *mounts,
        ],
    }


def bringer(machines: Machines, part: Part, image: str) -> Object:
    """Return the init container that takes the standard CNI programs out of an image."""
    return {
        "name": "programs",
        "image": image,
        "imagePullPolicy": "IfNotPresent",
        "command": ["/bin/sh", SCRIPT, "copy"],
        "env": variables(machines, part, {}),
        "resources": {"requests": {"cpu": "5m", "memory": "8Mi"}, "limits": {"memory": "256Mi"}},
        "securityContext": {**WRITER, "seLinuxOptions": {}},
        "terminationMessagePolicy": "FallbackToLogsOnError",
        "volumeMounts": [
            mount("scripts", "/rigel-network", read_only=True),
            mount("programs", BROUGHT),
        ],
    }


def variables(machines: Machines, part: Part, more: Mapping[str, str]) -> list[Object]:
    """Return the variables of machine.sh, which fails if one is not set."""
    known = {
        "PART": part,
        "RETIRED": "1" if machines.retired else "",
        "BIN_DIR": machines.platform.bin_dir,
        "CONF_DIR": machines.platform.conf_dir,
        "BROUGHT": BROUGHT,
        "STANDARD": STANDARD,
        "NEEDED": "",
        **more,
    }
    return [{"name": name, "value": value} for name, value in known.items()]


def fields(**paths: str) -> list[Object]:
    """Return variables that Kubernetes fills from the pod."""
    return [
        {"name": name, "valueFrom": {"fieldRef": {"fieldPath": path}}}
        for name, path in paths.items()
    ]


def daemon_set(
    machines: Machines,
    name: str,
    pod: Mapping[str, Any],
    configuration: Sequence[Object],
) -> Object:
    """Return a DaemonSet in the machines' own network; it rolls when its configuration changes."""
    own = machines.name_object(name)
    digest = hashlib.sha256(json.dumps(list(configuration), sort_keys=True).encode()).hexdigest()
    spec = {
        "hostNetwork": True,
        "dnsPolicy": "ClusterFirstWithHostNet",
        "priorityClassName": "system-node-critical",
        "serviceAccountName": name,
        "nodeSelector": {"kubernetes.io/os": "linux"},
        "tolerations": list(EVERYWHERE),
        "terminationGracePeriodSeconds": 10,
        **({"affinity": machines.affinity} if machines.affinity else {}),
        **pod,
    }
    # One machine after the other, which is Kubernetes' default; not set here, since a roll-out with
    # unreachable machines raises it. What retires may stop on all machines at once.
    strategy: Object = {"type": "RollingUpdate"}
    if machines.retired:
        strategy["rollingUpdate"] = {"maxUnavailable": "100%"}
    return {
        "apiVersion": "apps/v1",
        "kind": "DaemonSet",
        "metadata": {
            "name": own,
            "namespace": RELEASE.namespace,
            "labels": labels(own, RELEASE.name),
        },
        "spec": {
            "selector": {"matchLabels": selector(own)},
            "updateStrategy": strategy,
            "template": {
                "metadata": {
                    "labels": {**labels(own, RELEASE.name), RELEASE_LABEL: RELEASE.name},
                    "annotations": {"rigel-k8s/configuration": digest[:20]},
                },
                "spec": spec,
            },
        },
    }


def config_map(name: str, data: Mapping[str, str]) -> Object:
    """Return a ConfigMap of the release."""
    metadata = {"name": name, "namespace": RELEASE.namespace}
    return {"apiVersion": "v1", "kind": "ConfigMap", "metadata": metadata, "data": dict(data)}


def volumes(machines: Machines) -> list[Object]:
    """Return the volumes that keeper() and bringer() mount."""
    return [
        *roots(machines.platform),
        {"name": "scripts", "configMap": {"name": SCRIPTS}},
        {"name": "programs", "emptyDir": {}},
    ]
