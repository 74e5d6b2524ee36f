"""The pod whose place in an application's network a program on another computer takes; pure.

It is one of the application's pods as far as the network is concerned: labels, Multus' networks,
DNS, and the variables and files that describe the middleware. It runs no node.
"""

from __future__ import annotations

import copy

from rigel_k8s.app.development import call_master
from rigel_k8s.errors import UserError
from rigel_k8s.objects.marks import JOINED_ANNOTATION, NAME_LABEL, RELEASE_LABEL
from rigel_k8s.objects.pods import SCRIPTS_PATH, Object
from rigel_k8s.objects.refs import Manifest

SCRIPT = f"{SCRIPTS_PATH}/join.py"
NAME = "rigel-join"
NETWORKS = "k8s.v1.cni.cncf.io/networks"
#: What the pod keeps of a node's: where it may run, and how it reaches registries and names.
OF_POD = (
    *("dnsPolicy", "dnsConfig", "hostAliases", "imagePullSecrets", "nodeSelector"),
    *("tolerations", "affinity", "runtimeClassName", "enableServiceLinks"),
)
#: Our scripts, and the files that describe the middleware.
VOLUMES = frozenset({"rigel-inpod", "rigel-network", "rigel-network-source"})
#: What the relay must be able to do: to take the address from the kernel, and to send frames.
CAPABILITIES = ("NET_ADMIN", "NET_RAW")


def make_pod(deployment: Manifest, name: str, *, by: str) -> Object:
    """Return the Pod that stands in the network as those of a Deployment do.

    Args:
        name: of the Pod.
        by: who joins, for an annotation.

    Raises:
        UserError: the Deployment's pods are in their machines' own network.
    """
    template = deployment["spec"]["template"]
    meta, spec = template["metadata"], template["spec"]
    if spec.get("hostNetwork"):
        raise UserError(
            "the nodes are in the network of their machines (network: host), not in one of pods",
            hint="connect this computer to that network, with the ROS_DOMAIN_ID or the"
            " ROS_MASTER_URI of the nodes (`rigel exec NODE -- env`)",
        )
    node = spec["containers"][0]
    annotations = meta.get("annotations") or {}
    kept = {key: annotations[key] for key in (NETWORKS,) if key in annotations}
    container = {
        "name": NAME,
        "image": node["image"],
        "imagePullPolicy": node.get("imagePullPolicy", "IfNotPresent"),
        "command": ["python3", SCRIPT, "hold"],
        "env": [call_master(one) for one in node.get("env") or []],
        "volumeMounts": [one for one in node["volumeMounts"] if one["name"] in VOLUMES],
        "securityContext": {
            "runAsUser": 0,
            "allowPrivilegeEscalation": False,
            "capabilities": {"drop": ["ALL"], "add": list(CAPABILITIES)},
        },
        "resources": {"requests": {"cpu": "50m", "memory": "32Mi"}},
    }
    pod = {key: copy.deepcopy(spec[key]) for key in OF_POD if key in spec}
    pod |= {
        "restartPolicy": "Never",
        "terminationGracePeriodSeconds": 1,
        "automountServiceAccountToken": False,
        "initContainers": [one for one in spec.get("initContainers") or [] if is_of_network(one)],
        "containers": [container],
        "volumes": [one for one in spec["volumes"] if one["name"] in VOLUMES],
    }
    labels = {RELEASE_LABEL: meta["labels"][RELEASE_LABEL], NAME_LABEL: NAME}
    return {
        "apiVersion": "v1",
        "kind": "Pod",
        "metadata": {
            "name": name,
            "namespace": deployment["metadata"]["namespace"],
            "labels": labels,
            "annotations": {**kept, JOINED_ANNOTATION: by},
        },
        "spec": pod,
    }


def is_of_network(container: Object) -> bool:
    """Return whether an init container writes nothing but what describes the middleware."""
    return {one["name"] for one in container.get("volumeMounts") or []} <= VOLUMES
