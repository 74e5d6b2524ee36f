"""One program of the stack: from its file in files/programs/, and its options, to its objects.

A file has what is the same on all clusters: the pod without what all programs have in common, the
rights of its account, the size of its claim.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from typing import Any

import attrs
import yaml

from rigel_k8s.objects.marks import OPTIONAL_ANNOTATION, REMEDY_ANNOTATION
from rigel_k8s.objects.naming import selector
from rigel_k8s.objects.pods import Object
from rigel_k8s.objects.podsecurity import pod_context
from rigel_k8s.observability.container import CONFIG_ANNOTATION, container
from rigel_k8s.observability.names import RELEASE
from rigel_k8s.observability.options import ChartProgram, Persistence, Program
from rigel_k8s.yaml_text import Loader
from rigel_stack.manifests.stack import Stack, make_labels

RBAC = "rbac.authorization.k8s.io"
#: Each kind's own fields. Two pods of a Deployment would use the same data. Programs that only read
#: may roll out on all machines at once; some machines may be unreachable.
WORKLOADS: Mapping[str, Object] = {
    "Deployment": {"replicas": 1, "strategy": {"type": "Recreate"}},
    "DaemonSet": {
        "updateStrategy": {"type": "RollingUpdate", "rollingUpdate": {"maxUnavailable": "100%"}}
    },
}
EVERY_MACHINE: Object = {
    "nodeSelector": {"kubernetes.io/os": "linux"},
    "tolerations": [{"operator": "Exists"}],
}


@attrs.define
class ProgramDraft:
    """A program before its objects are made.

    Attributes:
        configs: what it reads only when it starts, so another text restarts it.
        file: its file.
        pod: the file's pod, which what depends on options is added to; `container` is its one.
        claim: that of its data, None without one.
    """

    stack: Stack
    name: str
    options: Program
    configs: Sequence[Object] = ()
    file: Object = attrs.field(init=False)
    pod: Object = attrs.field(init=False)
    container: Object = attrs.field(init=False)
    claim: Object | None = attrs.field(init=False, default=None)

    def __attrs_post_init__(self) -> None:
        self.file = load(f"programs/{self.name}.yaml")
        self.pod = self.file["pod"]
        (self.container,) = self.pod["containers"]

    def keep(self, persistence: Persistence, *, default: bool = True) -> None:
        """Put its volume `data` on a claim, if the options or the cluster want one."""
        if not self.stack.keeps(persistence, default=default):
            return
        size = str(persistence.size or self.file["claim"])
        spec: Object = {
            "accessModes": ["ReadWriteOnce"],
            "resources": {"requests": {"storage": size}},
        }
        if persistence.storage_class is not None:
            spec["storageClassName"] = persistence.storage_class
        name = f"{self.name}-data"
        self.claim = self.stack.make("v1", "PersistentVolumeClaim", name, self.name, spec=spec)
        (data,) = (volume for volume in self.pod["volumes"] if volume["name"] == "data")
        del data["emptyDir"]
        data["persistentVolumeClaim"] = {"claimName": name}

    def objects(self) -> Iterator[Object]:
        """Yield its objects; only a Deployment has a Service."""
        yield self.stack.make("v1", "ServiceAccount", self.name, automountServiceAccountToken=False)
        if "rights" in self.file:
            yield from self._rights()
        yield from self.configs
        if self.claim:
            yield self.claim
        if self.file["kind"] == "Deployment":
            yield self._service()
        yield self._workload()

    def _rights(self) -> Iterator[Object]:
        """Yield the rights of its account in the whole cluster."""
        metadata = {"name": f"{RELEASE}-{self.name}", "labels": make_labels(self.name)}
        common = {"apiVersion": f"{RBAC}/v1", "metadata": metadata}
        account = {
            "kind": "ServiceAccount",
            "name": self.name,
            "namespace": self.stack.namespace,
        }
        yield {**common, "kind": "ClusterRole", "rules": self.file["rights"]}
        yield {
            **common,
            "kind": "ClusterRoleBinding",
            "roleRef": {"apiGroup": RBAC, "kind": "ClusterRole", "name": metadata["name"]},
            "subjects": [account],
        }

    def _service(self) -> Object:
        port = self.container["ports"][0]["containerPort"]
        spec: Object = {
            "selector": selector(self.name),
            "ports": [{"name": "http", "port": port, "targetPort": "http"}],
        }
        if isinstance(self.options, ChartProgram) and self.options.service_type:
            spec["type"] = self.options.service_type
        return self.stack.make("v1", "Service", self.name, spec=spec)

    def _workload(self) -> Object:
        kind = self.file["kind"]
        metadata: Object = {"labels": make_labels(self.name)}
        if self.configs:
            metadata["annotations"] = {CONFIG_ANNOTATION: digest(self.configs)}
        spec = {
            **WORKLOADS[kind],
            "selector": {"matchLabels": selector(self.name)},
            "template": {"metadata": metadata, "spec": self._pod()},
        }
        made = self.stack.make("apps/v1", kind, self.name, spec=spec)
        if remedy := self.file.get("remedy"):
            notes = {OPTIONAL_ANNOTATION: "true", REMEDY_ANNOTATION: remedy}
            made["metadata"]["annotations"] = notes
        return made

    def _pod(self) -> Object:
        made: Object = {
            # Some of these programs take Kubernetes' variables for Services (LOKI_PORT ...) as
            # options.
            "enableServiceLinks": False,
            "automountServiceAccountToken": "rights" in self.file,
        }
        chosen = self.stack.options.placement.node_selector
        if self.file["kind"] == "DaemonSet":
            made |= EVERY_MACHINE
        elif chosen:
            made["nodeSelector"] = dict(chosen)
        made["serviceAccountName"] = self.name
        if user := self.file.get("user"):
            made["securityContext"] = pod_context(user)
        main = container(self.name, self.options, self.container)
        return {**made, **self.pod, "containers": [main]}


def digest(configuration: Sequence[Object]) -> str:
    """Return a hash of the texts that a program reads only when it starts."""
    texts = [item["data"] for item in configuration]
    return hashlib.sha256(json.dumps(texts, sort_keys=True).encode()).hexdigest()[:20]


def read_file(name: str) -> str:
    """Return a file that is the same on all clusters, or its unchanging part."""
    return (files(__package__) / "files" / name).read_text("utf-8")


def load(name: str) -> Any:
    """Return such a file as plain data of the caller's own."""
    return yaml.load(read_file(name), Loader)


def list_loki_variables(stack: Stack) -> list[Object]:
    """Return the variables with the user of a Loki that needs a login."""
    secret = stack.other_loki.secret if stack.other_loki else None
    return [
        {"name": name, "valueFrom": {"secretKeyRef": {"name": str(secret), "key": key}}}
        for name, key in (("LOKI_USER", "username"), ("LOKI_PASSWORD", "password"))
        if secret
    ]
