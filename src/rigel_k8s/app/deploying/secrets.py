"""The pods' pull secret, from the credentials of registry providers.

It is not in revisions and renders: it is written separately, and has the release's
label, so that `down` finds it.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rigel_k8s.image_reference import parse_reference
from rigel_k8s.images.credentials import RegistryCredentials, docker_config
from rigel_k8s.objects.naming import labels
from rigel_k8s.objects.refs import ObjectRef, ref_of
from rigel_k8s.release.types import Desired, ReleaseId
from rigel_k8s.release.writing import make_namespace

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster

KEY = ".dockerconfigjson"


def secret_name(release: str) -> str:
    """Return the name of a release's pull secret."""
    return f"{release}-registry"


def has_pull_secret(release: ReleaseId, cluster: Cluster) -> bool:
    """Return whether an earlier run has left a pull secret."""
    ref = ObjectRef("v1", "Secret", release.namespace, secret_name(release.name))
    return cluster.get(ref) is not None


def choose_credentials(
    images: Sequence[str], known: Sequence[RegistryCredentials]
) -> tuple[RegistryCredentials, ...]:
    """Return the credentials of the registries that the images come from."""
    registries = {parse_reference(image).registry for image in images}
    return tuple(one for one in known if one.username and one.registry in registries)


def secret_of(release: ReleaseId, credentials: Sequence[RegistryCredentials]) -> dict[str, Any]:
    """Return the Secret that the kubelet reads."""
    config = json.dumps(docker_config(credentials), sort_keys=True)
    return {
        "apiVersion": "v1",
        "kind": "Secret",
        "type": "kubernetes.io/dockerconfigjson",
        "metadata": {
            "name": secret_name(release.name),
            "namespace": release.namespace,
            "labels": labels(release.name, release.name),
        },
        "data": {KEY: base64.b64encode(config.encode()).decode()},
    }


def write_pull_secret(
    desired: Desired, credentials: Sequence[RegistryCredentials], cluster: Cluster
) -> None:
    """Write the pull secret before the first pod needs it; nothing if it is unchanged."""
    if not credentials:
        return
    wanted = secret_of(desired.release, credentials)
    live = cluster.get(ref_of(wanted))
    if live is not None and live.get("data") == wanted["data"]:
        return
    if desired.create_namespace:
        make_namespace(cluster, desired.release.namespace)
    cluster.apply(wanted)
