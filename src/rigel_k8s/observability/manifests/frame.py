"""What all parts of the stack share: names, labels, pods without rights, claims, accounts."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from importlib.resources import files
from typing import Any

import attrs
import yaml

from rigel_k8s.objects.marks import OPTIONAL_ANNOTATION, RELEASE_LABEL, REMEDY_ANNOTATION
from rigel_k8s.objects.naming import labels, selector
from rigel_k8s.objects.resources import Resources
from rigel_k8s.observability.options import Persistence, Program
from rigel_k8s.yaml_text import Loader

Object = dict[str, Any]

#: On all pods that watch ROS but are not ROS nodes.
COMPONENT = {"app.kubernetes.io/component": "observability"}
#: On pods: a hash of the configuration that they were started with.
CONFIG_ANNOTATION = "rigel-k8s/configuration"
RBAC = "rbac.authorization.k8s.io"
#: At a start, a log of hours may be replayed; a probe that gives up would restart that.
FOR_EVER = 2**31 - 1


@attrs.frozen
class Frame:
    """A release in a namespace, and the kinds of objects that its parts consist of.

    Attributes:
        node_selector: labels of the machines that Deployments may run on.
    """

    namespace: str
    release: str
    node_selector: Mapping[str, str] = attrs.field(factory=dict)

    def metadata(self, name: str, part: str | None = None) -> Object:
        """Return an object's metadata, with the label of its part."""
        return {"name": name, "namespace": self.namespace, "labels": self.labels(part or name)}

    def labels(self, part: str) -> dict[str, str]:
        """Return the labels of a part."""
        return {**labels(part, self.release), **COMPONENT, RELEASE_LABEL: self.release}

    def config_map(
        self,
        name: str,
        data: Mapping[str, str],
        part: str,
        *,
        own_labels: Mapping[str, str] | None = None,
        annotations: Mapping[str, str] | None = None,
    ) -> Object:
        """Return a ConfigMap of texts."""
        metadata = self.metadata(name, part)
        metadata["labels"] |= dict(own_labels or {})
        if annotations:
            metadata["annotations"] = dict(annotations)
        return {"apiVersion": "v1", "kind": "ConfigMap", "metadata": metadata, "data": dict(data)}

    def deployment(
        self,
        name: str,
        pod: Object,
        configuration: Sequence[Object] = (),
        *,
        remedy: str = "",
    ) -> Object:
        """Return a Deployment of one pod, never two at once, since both would use the same data.

        Args:
            remedy: set for a part without which the stack is good: what to do if it is not ready.
        """
        spec = {"replicas": 1, "strategy": {"type": "Recreate"}}
        placed = {"nodeSelector": dict(self.node_selector)} if self.node_selector else {}
        made = self._workload("Deployment", name, spec, {**placed, **pod}, configuration)
        if remedy:
            notes = {OPTIONAL_ANNOTATION: "true", REMEDY_ANNOTATION: remedy}
            made["metadata"]["annotations"] = notes
        return made

    def daemon_set(self, name: str, pod: Object, configuration: Sequence[Object] = ()) -> Object:
        """Return a DaemonSet on every Linux machine; no machine waits for an unreachable one."""
        spec = {"updateStrategy": {"type": "RollingUpdate", "rollingUpdate": ALL_AT_ONCE}}
        everywhere = {
            "nodeSelector": {"kubernetes.io/os": "linux"},
            "tolerations": [{"operator": "Exists"}],
        }
        return self._workload("DaemonSet", name, spec, {**everywhere, **pod}, configuration)

    def _workload(
        self, kind: str, name: str, spec: Object, pod: Object, configuration: Sequence[Object]
    ) -> Object:
        metadata: Object = {"labels": self.labels(name)}
        if configuration:
            metadata["annotations"] = {CONFIG_ANNOTATION: digest(configuration)}
        # Some of these programs take Kubernetes' variables for Services (LOKI_PORT ...) as options.
        plain = {"enableServiceLinks": False, "automountServiceAccountToken": False}
        return {
            "apiVersion": "apps/v1",
            "kind": kind,
            "metadata": self.metadata(name),
            "spec": {
                **spec,
                "selector": {"matchLabels": selector(name)},
                "template": {"metadata": metadata, "spec": {**plain, **pod}},
            },
        }

    def service(self, name: str, port: int, service_type: str | None = None) -> Object:
        """Return the Service of a part's name."""
        spec: Object = {
            "selector": selector(name),
            "ports": [{"name": "http", "port": port, "targetPort": "http"}],
        }
        if service_type:
            spec["type"] = service_type
        return {
            "apiVersion": "v1",
            "kind": "Service",
            "metadata": self.metadata(name),
            "spec": spec,
        }

    def claim(self, part: str, persistence: Persistence, size: str) -> Object:
        """Return the claim with a part's data; `down` keeps it."""
        spec: Object = {
            "accessModes": ["ReadWriteOnce"],
            "resources": {"requests": {"storage": str(persistence.size or size)}},
        }
        if persistence.storage_class is not None:
            spec["storageClassName"] = persistence.storage_class
        return {
            "apiVersion": "v1",
            "kind": "PersistentVolumeClaim",
            "metadata": self.metadata(f"{part}-data", part),
            "spec": spec,
        }

    def account(self, name: str) -> Object:
        """Return a part's account, without rights."""
        return {
            "apiVersion": "v1",
            "kind": "ServiceAccount",
            "metadata": self.metadata(name),
            "automountServiceAccountToken": False,
        }

    def rights(self, name: str, rules: Sequence[Object]) -> tuple[Object, Object]:
        """Return the rights of a part's account in the whole cluster."""
        metadata = {"name": f"{self.release}-{name}", "labels": self.labels(name)}
        role = {
            "apiVersion": f"{RBAC}/v1",
            "kind": "ClusterRole",
            "metadata": metadata,
            "rules": list(rules),
        }
        binding = {
            "apiVersion": f"{RBAC}/v1",
            "kind": "ClusterRoleBinding",
            "metadata": metadata,
            "roleRef": {"apiGroup": RBAC, "kind": "ClusterRole", "name": metadata["name"]},
            "subjects": [
                {"kind": "ServiceAccount", "name": name, "namespace": self.namespace},
            ],
        }
        return role, binding


#: Programs that only read may roll out on all machines at once; some machines may be unreachable.
ALL_AT_ONCE = {"maxUnavailable": "100%"}


def digest(configuration: Sequence[Object]) -> str:
    """Return a hash of the texts that a program reads only when it starts."""
    texts = [item["data"] for item in configuration]
    return hashlib.sha256(json.dumps(texts, sort_keys=True).encode()).hexdigest()[:20]


def container(
    name: str, program: Program, image: str, defaults: Mapping[str, Mapping[str, str]], **more: Any
) -> Object:
    """Return a container that writes only to its volumes and cannot become another user."""
    return {
        "name": name,
        "image": str(program.image or image),
        "imagePullPolicy": "IfNotPresent",
        **more,
        "resources": resources(program.resources, defaults),
        "securityContext": {
            "allowPrivilegeEscalation": False,
            "readOnlyRootFilesystem": True,
            "capabilities": {"drop": ["ALL"]},
        },
        "terminationMessagePolicy": "FallbackToLogsOnError",
    }


def resources(given: Resources, defaults: Mapping[str, Mapping[str, str]]) -> Object:
    """Return requests and limits: those of the options, merged over the defaults."""
    return {
        kind: {**defaults[kind], **{str(name): str(value) for name, value in own.items()}}
        for kind, own in (("requests", given.requests), ("limits", given.limits))
    }


def http_probes(path: str, port: str | int = "http") -> Object:
    """Return probes: a frequent one until the start, a rare one afterwards."""
    get = {"httpGet": {"path": path, "port": port}, "timeoutSeconds": 5}
    return {
        "startupProbe": {**get, "periodSeconds": 2, "failureThreshold": FOR_EVER},
        "readinessProbe": {**get, "periodSeconds": 10},
    }


def mount(name: str, path: str, *, read_only: bool = False) -> Object:
    """Return a volume's mount."""
    made: Object = {"name": name, "mountPath": path}
    return {**made, "readOnly": True} if read_only else made


def data_volume(part: str, *, kept: bool) -> Object:
    """Return a pod's volume `data`: the part's claim, or one that is deleted with the pod."""
    if kept:
        return {"name": "data", "persistentVolumeClaim": {"claimName": f"{part}-data"}}
    return {"name": "data", "emptyDir": {}}


def read_file(name: str) -> str:
    """Return a configuration that is the same on all clusters, or its unchanging part."""
    return (files(__package__) / "files" / name).read_text("utf-8")


def load(name: str) -> Any:
    """Return such a configuration as plain data of the caller's own."""
    return yaml.load(read_file(name), Loader)


def rule(group: str, kinds: Sequence[str], verbs: Sequence[str]) -> Object:
    """Return a rule of a role."""
    return {"apiGroups": [group], "resources": list(kinds), "verbs": list(verbs)}
