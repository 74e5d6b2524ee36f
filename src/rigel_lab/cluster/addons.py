"""What a local cluster runs beside Kubernetes: DNS, a default StorageClass, their images."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rigel_lab.cluster.components import Components
from rigel_lab.cluster.layout import Layout
from rigel_lab.cluster.oci import Image

DNS_NAME = "coredns"
STORAGE_NAME = "local-path-provisioner"
STORAGE_NAMESPACE = "local-path-storage"
STORAGE_DIRECTORY = "/opt/local-path-provisioner"
#: The provisioner looks for its configuration under this name.
STORAGE_CONFIG = "local-path-config"

#: (namespace, name) of what must be ready before a cluster is.
DEPLOYMENTS = (("kube-system", DNS_NAME), (STORAGE_NAMESPACE, STORAGE_NAME))

Object = dict[str, Any]


def images(components: Components) -> list[Image]:
    """Return the images that the cluster itself needs."""
    shell = {f"bin/{tool}": "busybox" for tool in ("sh", "mkdir", "rm", "chmod", "ls", "cat")}
    return [
        Image(
            "rigel-k8s/pause:1",
            {"catatonit": Path(components.program("catatonit"))},
            ["/catatonit", "-P"],
        ),
        Image(
            "rigel-k8s/coredns:1", {"coredns": Path(components.program("coredns"))}, ["/coredns"]
        ),
        Image(
            "rigel-k8s/local-path-provisioner:1",
            {"local-path-provisioner": Path(components.program("local-path-provisioner"))},
            ["/local-path-provisioner"],
        ),
        Image(
            "rigel-k8s/busybox:1",
            {"bin/busybox": Path(components.program("busybox"))},
            ["/bin/sh"],
            links=shell,
        ),
    ]


def objects(layout: Layout) -> list[Object]:
    """Return the manifests, in the order in which they can be applied."""
    return [*dns(layout), *storage(layout), registry_note(layout)]


def make_object(
    api: str, kind: str, name: str, namespace: str | None = None, **rest: Any
) -> Object:
    """Return an object."""
    meta = {"name": name} | ({"namespace": namespace} if namespace else {})
    return {"apiVersion": api, "kind": kind, "metadata": meta, **rest}


def rights(name: str, namespace: str, rules: list[Object]) -> list[Object]:
    """Return a service account and the cluster role that it has."""
    group = "rbac.authorization.k8s.io"
    subject = {"kind": "ServiceAccount", "name": name, "namespace": namespace}
    role = {"apiGroup": group, "kind": "ClusterRole", "name": f"rigel:{name}"}
    return [
        make_object("v1", "ServiceAccount", name, namespace),
        make_object(f"{group}/v1", "ClusterRole", f"rigel:{name}", rules=rules),
        make_object(
            f"{group}/v1", "ClusterRoleBinding", f"rigel:{name}", roleRef=role, subjects=[subject]
        ),
    ]


def rule(group: str, resources: list[str], verbs: list[str]) -> Object:
    """Return one RBAC rule."""
    return {"apiGroups": [group], "resources": resources, "verbs": verbs}


def deployment(name: str, namespace: str, container: Object, **pod: Any) -> Object:
    """Return a Deployment of one pod."""
    labels = {"app.kubernetes.io/name": name}
    template = {
        "metadata": {"labels": labels},
        "spec": {"serviceAccountName": name, "containers": [{"name": name, **container}], **pod},
    }
    spec = {"replicas": 1, "selector": {"matchLabels": labels}, "template": template}
    return make_object("apps/v1", "Deployment", name, namespace, spec=spec)


def config_volume(name: str) -> Object:
    """Return a volume of a ConfigMap of the same name."""
    return {"name": "config", "configMap": {"name": name}}


def dns(layout: Layout) -> list[Object]:
    """Return CoreDNS with the cluster's domain; other names go to the machine's name servers."""
    servers = (layout.directory / "node1" / "resolv.conf").read_text()
    upstream = "  forward . /etc/resolv.conf\n" if servers else ""
    corefile = (
        ".:53 {\n  errors\n  health\n  ready\n"
        "  kubernetes cluster.local in-addr.arpa ip6.arpa {\n"
        "    pods insecure\n    fallthrough in-addr.arpa ip6.arpa\n    ttl 5\n  }\n"
        f"{upstream}  cache 30\n  loop\n  reload\n}}\n"
    )
    watch = ["list", "watch"]
    ports = [{"name": p, "port": 53, "protocol": p.upper()} for p in ("udp", "tcp")]
    container = {
        "image": f"{layout.registry}/rigel-k8s/coredns:1",
        "args": ["-conf", "/etc/coredns/Corefile"],
        "volumeMounts": [{"name": "config", "mountPath": "/etc/coredns", "readOnly": True}],
        "readinessProbe": {"httpGet": {"path": "/ready", "port": 8181}, "periodSeconds": 1},
        "livenessProbe": {"httpGet": {"path": "/health", "port": 8080}, "periodSeconds": 30},
    }
    service = {
        "selector": {"app.kubernetes.io/name": DNS_NAME},
        "clusterIP": layout.addresses.dns_service,
        "ports": ports,
    }
    return [
        *rights(
            DNS_NAME,
            "kube-system",
            [
                rule("", ["endpoints", "services", "pods", "namespaces"], watch),
                rule("discovery.k8s.io", ["endpointslices"], watch),
            ],
        ),
        make_object("v1", "ConfigMap", DNS_NAME, "kube-system", data={"Corefile": corefile}),
        deployment(
            DNS_NAME,
            "kube-system",
            container,
            dnsPolicy="Default",
            priorityClassName="system-cluster-critical",
            volumes=[config_volume(DNS_NAME)],
        ),
        make_object("v1", "Service", "kube-dns", "kube-system", spec=service),
    ]


def storage(layout: Layout) -> list[Object]:
    """Return local-path-provisioner and the default StorageClass `local-path`."""
    name, space = STORAGE_NAME, STORAGE_NAMESPACE
    helper = make_object("v1", "Pod", "helper-pod")
    helper["spec"] = {
        "containers": [{"name": "helper-pod", "image": f"{layout.registry}/rigel-k8s/busybox:1"}],
        "priorityClassName": "system-node-critical",
    }
    paths = [{"node": "DEFAULT_PATH_FOR_NON_LISTED_NODES", "paths": [STORAGE_DIRECTORY]}]
    data: Mapping[str, str] = {
        "config.json": json.dumps({"nodePathMap": paths}),
        "setup": '#!/bin/sh\nset -eu\nmkdir -m 0777 -p "$VOL_DIR"\n',
        "teardown": '#!/bin/sh\nset -eu\nrm -rf "$VOL_DIR"\n',
        "helperPod.yaml": json.dumps(helper),
    }
    everything = ["get", "list", "watch", "create", "patch", "update", "delete"]
    container = {
        "image": f"{layout.registry}/rigel-k8s/local-path-provisioner:1",
        "args": ["start", "--config", "/etc/config/config.json"],
        "env": [
            {"name": "POD_NAMESPACE", "value": space},
            {"name": "SERVICE_ACCOUNT_NAME", "value": name},
            {"name": "CONFIG_MOUNT_PATH", "value": "/etc/config/"},
        ],
        "volumeMounts": [{"name": "config", "mountPath": "/etc/config/"}],
    }
    return [
        make_object("v1", "Namespace", space),
        *rights(
            name,
            space,
            [
                rule("", ["persistentvolumes", "persistentvolumeclaims"], everything),
                rule("", ["nodes", "configmaps", "pods", "pods/log", "events"], everything),
                rule("storage.k8s.io", ["storageclasses"], ["get", "list", "watch"]),
            ],
        ),
        make_object("v1", "ConfigMap", STORAGE_CONFIG, space, data=data),
        deployment(name, space, container, volumes=[config_volume(STORAGE_CONFIG)]),
        {
            **make_object("storage.k8s.io/v1", "StorageClass", "local-path"),
            "metadata": {
                "name": "local-path",
                "annotations": {"storageclass.kubernetes.io/is-default-class": "true"},
            },
            "provisioner": "rancher.io/local-path",
            "volumeBindingMode": "WaitForFirstConsumer",
            "reclaimPolicy": "Delete",
        },
    ]


def registry_note(layout: Layout) -> Object:
    """Return the ConfigMap that names the cluster's registry for tools (KEP-1755)."""
    text = json.dumps({"host": layout.registry, "hostFromClusterNetwork": layout.registry})
    data = {"localRegistryHosting.v1": text}
    return make_object("v1", "ConfigMap", "local-registry-hosting", "kube-public", data=data)
