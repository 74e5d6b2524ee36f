"""Nodes with a `kind`, which run once: tasks, and tests, which only `rigel test` runs; pure.

Each is a Job, whose pod has all that the pod of another node has: names, network, parameters,
files. A deploy leaves tests out. For `rigel test` such a Job is suspended, and the pod of the test
is made of it.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping
from typing import Any

import attrs

from rigel_k8s.app.application import flat
from rigel_k8s.app.generation import Generation
from rigel_k8s.app.options import NodeOptions, OrchestrationOptions
from rigel_k8s.app.volumes import device_of, mount_of
from rigel_k8s.network.mode import mode_path
from rigel_k8s.network.modes import mode_of
from rigel_k8s.objects.pods import Object
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.problems import Path, Problem

#: On the Job of a test: "true".
TEST_ANNOTATION = "rigel-k8s/test"
#: Where a test writes what is fetched when it has ended.
RESULTS = "/results"
#: The container beside the test's, in which these files are read.
READER = "results"
#: What describes a node that works on, and has no effect on one that ends.
OF_NODES = (
    *("anonymous", "components", "lifecycle", "liveness", "pod", "readiness", "replicas"),
    "update",
)


def check_kind(node: NodeOptions) -> list[Problem]:
    """Return the options without effect of a node that ends; paths are the node's own."""
    if node.kind is None:
        return []
    message = f"`{{}}` is for nodes that work on, and this is a {node.kind}, which ends: remove it"
    found = [key for key in OF_NODES if getattr(node, key)]
    return [Problem((key,), message.format(key), node.kind, at_key=True) for key in found]


def choose_nodes(
    options: OrchestrationOptions, raw: Mapping[str, Any], *, tests: bool
) -> tuple[OrchestrationOptions, Mapping[str, Any]]:
    """Return a job's options and its `with`, without its tests unless these are deployed."""
    found = {key for key, node in options.nodes.items() if node.kind == "test"}
    if tests or not found:
        return options, raw
    plain = flat(raw)
    plain["nodes"] = {key: one for key, one in plain["nodes"].items() if key not in found}
    rest = {key: node for key, node in options.nodes.items() if key not in found}
    return attrs.evolve(options, nodes=rest), plain


def make_test_pod(job: Manifest) -> Object:
    """Return the Pod of a test, of its Job."""
    meta, template = job["metadata"], copy.deepcopy(job["spec"]["template"])
    spec = template["spec"]
    node, *others = spec["containers"]
    mount = {"name": READER, "mountPath": RESULTS}
    node["volumeMounts"] = [*node.get("volumeMounts", []), mount]
    reader = {
        "name": READER,
        "command": ["sleep", "infinity"],
        "volumeMounts": [mount],
        "resources": {"requests": {"cpu": "1m", "memory": "8Mi"}},
        **{
            key: node[key] for key in ("image", "imagePullPolicy", "securityContext") if key in node
        },
    }
    spec |= {
        "containers": [node, *others, reader],
        "volumes": [*spec.get("volumes", []), {"name": READER, "emptyDir": {}}],
    }
    own = {"name": meta["name"], "namespace": meta["namespace"]}
    described = {key: template["metadata"].get(key) or {} for key in ("labels", "annotations")}
    # By its labels the suspended Job would take the pod for its own, and end it.
    of_job = job["spec"].get("selector", {}).get("matchLabels", {})
    described["labels"] = {k: v for k, v in described["labels"].items() if k not in of_job}
    return {"apiVersion": "v1", "kind": "Pod", "metadata": {**own, **described}, "spec": spec}


def find_collisions(options: OrchestrationOptions, ros: Generation) -> Iterator[tuple[Path, str]]:
    """Yield options by which deploys in two namespaces would disturb each other, and how.

    What `patch` and `additional_k8s_params` add is not examined.
    """
    network, mode = options.network, mode_of(options.network)
    on_machine = "the nodes of all runs would meet on the machines' network"
    if network and mode.on_machines:
        yield mode_path(network), on_machine
    elif network and network.domain_id is not None:
        yield ("network", "domain_id"), "all runs would be in this DDS domain"
    elif ros.dds and not (mode.own_domain and ros.nodes):
        yield mode_path(network) if network else (), "all runs could be in the same DDS domain"
    if options.ros_master_uri:
        yield ("ros_master_uri",), "the nodes of all runs would register at this master"
    if options.results:
        yield ("results",), "all runs would copy into the same directory of this computer"
    for index, volume in enumerate(options.persistent_storage.volumes):
        if volume.host_path:
            message = f"the volume {volume.name}-pv has no namespace: only one run can have it"
            yield ("persistent_storage", "volumes", index, "host_path"), message
    for key, node in options.nodes.items():
        if node.host_network:
            yield ("nodes", key, "host_network"), on_machine
        if any(device_of(device).path for device in node.devices):
            yield ("nodes", key, "devices"), "all runs would open the same device of a machine"
        for index, mount in enumerate(map(mount_of, node.volumes)):
            if mount.host_path and not mount.read_only:
                message = "all runs would write to this path of a machine: set `read_only: true`?"
                yield ("nodes", key, "volumes", index), message
