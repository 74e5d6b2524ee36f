"""Grafana's administrator: a Secret that is created once, and is in no revision and no render."""

from __future__ import annotations

import base64
import secrets
from typing import TYPE_CHECKING

from rigel_k8s.errors import ConflictError
from rigel_k8s.objects.marks import NAME_LABEL
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.observability.names import GRAFANA

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster

#: The Secret, and its keys; Grafana's pod reads it.
ADMIN_SECRET, USER_NAME, PASSWORD = "grafana-admin", "admin-user", "admin-password"
USER = "admin"
#: Bytes of a random password: 24 letters.
LENGTH = 18


def administrator_ref(namespace: str) -> ObjectRef:
    """Return the Secret's reference."""
    return ObjectRef("v1", "Secret", namespace, ADMIN_SECRET)


def ensure_administrator(cluster: Cluster, namespace: str, password: str | None) -> None:
    """Create the Secret before Grafana needs it; an existing one changes only with `password`.

    Args:
        password: the Rigelfile's, None for a random one.
    """
    live = cluster.get(administrator_ref(namespace))
    if live is None:
        _create(cluster, namespace, password or secrets.token_urlsafe(LENGTH))
    elif password is not None and live.get("data", {}).get(PASSWORD) != _encode(password):
        cluster.patch(administrator_ref(namespace), {"data": {PASSWORD: _encode(password)}})
        # Grafana reads a changed password when it starts.
        for pod in cluster.list("v1", "Pod", namespace, labels={NAME_LABEL: GRAFANA}):
            cluster.delete(ObjectRef("v1", "Pod", namespace, pod["metadata"]["name"]))


def _create(cluster: Cluster, namespace: str, password: str) -> None:
    """Create it; it is not applied, so `down` keeps it, as it keeps Grafana's data."""
    try:
        cluster.create(
            {
                "apiVersion": "v1",
                "kind": "Secret",
                "type": "Opaque",
                "metadata": {"name": ADMIN_SECRET, "namespace": namespace},
                "data": {USER_NAME: _encode(USER), PASSWORD: _encode(password)},
            }
        )
    except ConflictError:  # another deploy was faster; its password is used
        return


def _encode(text: str) -> str:
    return base64.b64encode(text.encode()).decode()
