"""Which kind of cluster it is, detected from its nodes' labels, annotations and versions."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.network.multus.platform import Kind, Platform, platform
from rigel_k8s.network.options import Install

Node = Mapping[str, Any]


@attrs.frozen
class Group:
    """The machines that keep CNI's files in the same places."""

    platform: Platform
    nodes: tuple[str, ...]


def groups(nodes: Iterable[Node], install: Install) -> tuple[Group, ...]:
    """Return the cluster's Linux machines by platform, the largest group first.

    A cluster may have several: a k3s server on a laptop and a robot with another --data-dir.
    What `install` sets applies to all of them.
    """
    found: dict[Platform, list[str]] = {}
    for node in nodes:
        if _labels(node).get("kubernetes.io/os", "linux") == "linux":
            found.setdefault(_platform(node, install), []).append(node["metadata"]["name"])
    made = [Group(where, tuple(sorted(names))) for where, names in found.items()]
    return tuple(sorted(made, key=lambda group: (-len(group.nodes), group.nodes)))


def kind_of(node: Node) -> Kind:
    """Return the kind of cluster that a machine belongs to."""
    labels = _labels(node)
    if "+k3s" in _version(node):
        return "k3s"
    if "microk8s.io/cluster" in labels:
        return "microk8s"
    if node.get("spec", {}).get("providerID", "").startswith("kind://"):
        return "kind"
    return "minikube" if "minikube.k8s.io/name" in labels else "plain"


def _platform(node: Node, install: Install) -> Platform:
    kind = install.platform or kind_of(node)
    return platform(
        kind,
        version=_version(node) if kind == "k3s" and "+k3s" in _version(node) else "",
        data_dir=install.data_dir or k3s_data_dir(node),
        conf_dir=install.cni_conf_dir,
        bin_dir=install.cni_bin_dir,
    )


def k3s_data_dir(node: Node) -> str | None:
    """Return the --data-dir that k3s was started with; k3s writes it into an annotation."""
    annotations = node["metadata"].get("annotations") or {}
    words = _parse_json(annotations.get("k3s.io/node-args"))
    if isinstance(words, list) and (given := _read_data_dir([str(word) for word in words])):
        return given
    environment = _parse_json(annotations.get("k3s.io/node-env"))
    given = str(environment.get("K3S_DATA_DIR", "")) if isinstance(environment, dict) else ""
    # k3s also uses this variable to pass its processes the directory of its unpacked programs.
    return re.sub(r"/data/[0-9a-f]{32,}/?$", "", given) or None


def _read_data_dir(words: Sequence[str]) -> str | None:
    for place, word in enumerate(words):
        name, _, value = word.partition("=")
        if name in ("--data-dir", "-d"):
            return value or (words[place + 1] if place + 1 < len(words) else None)
    return None


def _parse_json(text: str | None) -> Any:
    try:
        return json.loads(text or "null")
    except ValueError:
        return None


def _labels(node: Node) -> Mapping[str, str]:
    labels: Mapping[str, str] = node["metadata"].get("labels") or {}
    return labels


def _version(node: Node) -> str:
    return str(node.get("status", {}).get("nodeInfo", {}).get("kubeletVersion", ""))
