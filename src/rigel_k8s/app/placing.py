"""Which machines a pod of the application may run on."""

from __future__ import annotations

from collections.abc import Mapping

from rigel_k8s.app.options import Distributed
from rigel_k8s.objects.naming import HOSTNAME, object_name, selector
from rigel_k8s.objects.podoptions import Placement
from rigel_k8s.objects.pods import Object

#: The label of remote machines, as in src.plugin.
REMOTE: Mapping[str, str] = {"deploymentType": "remote"}


def remote_selector(distributed: Distributed) -> dict[str, str]:
    """Return the labels of the application's machine."""
    remote = distributed.enabled and distributed.default_to_remote
    return dict(REMOTE) if remote and not distributed.force_local_flag else {}


def affinity(placement: Placement) -> Object:
    """Return what keeps a pod off the machines of other pods."""
    terms = [
        {"labelSelector": {"matchLabels": selector(object_name(key))}, "topologyKey": HOSTNAME}
        for key in placement.apart_from
    ]
    if not terms:
        return {}
    return {"podAntiAffinity": {"requiredDuringSchedulingIgnoredDuringExecution": terms}}
