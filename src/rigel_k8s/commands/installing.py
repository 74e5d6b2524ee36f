"""The rights to install Multus, whereabouts and the observability stack, in the whole cluster.

They are read from the manifests. In Kubernetes no one can grant a right that they do not have, so
the rights of the installed programs are part of them.
"""

from __future__ import annotations

from collections.abc import Iterator

from rigel_k8s.network.multus.desired import Installation, network_release
from rigel_k8s.network.multus.platform import platform
from rigel_k8s.network.multus.recognition import Group
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.objects.rights import Right, grant, make_rules
from rigel_k8s.observability.desired import render_stack
from rigel_k8s.observability.request import StackRequest
from rigel_k8s.release.refusals.rights import (
    find_resource,
    need_for_kind,
    need_to_explain,
    need_to_record,
    need_to_wait,
)
from rigel_k8s.release.status import KINDS as SHOWN

ATTACHMENT = ("k8s.cni.cncf.io/v1", "NetworkAttachmentDefinition")
#: Verbs for every kind of object that is installed.
VERBS = "get list watch create patch delete"


def list_rules() -> list[Manifest]:
    """Return the rules of the role."""
    return [*make_rules(list_rights()), *list_narrow_rules()]


def list_rights() -> Iterator[Right]:
    """Yield the rights: for the objects, for the check of the machines, and those granted on."""
    for need in (need_to_record, need_to_wait, need_to_explain):
        yield from need("")
    yield from grant("", "namespaces", "get create patch")
    yield from grant("", "nodes", "get list")
    yield from grant("", "secrets", "get")  # Grafana's password is created once
    yield from grant("", "pods", "delete")
    yield from grant("", "pods/exec", "get create")
    yield from grant("", "services/proxy", "get")  # `rigel observe status` asks the stack
    yield from grant("storage.k8s.io", "storageclasses", "list")
    yield from grant("discovery.k8s.io", "endpointslices", "list")
    yield from need_for_kind(*ATTACHMENT, "", "list create delete")  # of the pods that prove it
    for kind in SHOWN:
        yield from need_for_kind(*kind, "", "list")
    for manifest in list_manifests():
        resource = find_resource(manifest["apiVersion"], manifest["kind"])
        if resource is not None:
            group = manifest["apiVersion"].rpartition("/")[0]
            yield from grant(group, resource.plural, VERBS)
        for rule in manifest.get("rules") or []:
            if not is_narrow(rule):
                for group in rule["apiGroups"]:
                    yield from grant(group, " ".join(rule["resources"]), " ".join(rule["verbs"]))


def list_narrow_rules() -> Iterator[Manifest]:
    """Yield the rules that are granted unchanged."""
    for manifest in list_manifests():
        yield from filter(is_narrow, manifest.get("rules") or [])


def is_narrow(rule: Manifest) -> bool:
    """Whether a rule is about objects with certain names, or about URLs."""
    return bool(rule.get("resourceNames") or rule.get("nonResourceURLs"))


def list_manifests() -> list[Manifest]:
    """Return all that is installed, on a plain cluster."""
    network = network_release(Installation((Group(platform("plain"), ()),)), "")
    return [*network.objects, *render_stack(StackRequest({})).desired.objects]
