"""The pods' pull secret, from the credentials of registry providers.

It stands in no revision and no render. It lives as long as the ConfigMap of the release's in-pod
scripts, which owns it, so that `down` takes it along.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rigel_k8s.deploy.types import Desired, ObjectRef, ReleaseId
from rigel_k8s.images.credentials import Credentials, docker_config
from rigel_k8s.images.reference import parse_reference
from rigel_k8s.manifests.naming import labels
from rigel_k8s.manifests.pods import scripts_config

if TYPE_CHECKING:
    from rigel_k8s.kube.cluster import Cluster

__all__ = ["needed_credentials", "pull_secret", "secret_name", "secret_of"]

KEY = ".dockerconfigjson"


def secret_name(release: str) -> str:
    """Return the name of a release's pull secret."""
    return f"{release}-registry"


def needed_credentials(
    images: Sequence[str], known: Sequence[Credentials]
) -> tuple[Credentials, ...]:
    """Return the credentials of the registries that the images come from."""
    registries = {parse_reference(image).registry for image in images}
    return tuple(one for one in known if one.username and one.registry in registries)


@contextmanager
def pull_secret(
    desired: Desired, credentials: Sequence[Credentials], cluster: Cluster
) -> Iterator[None]:
    """Have the pull secret on the cluster while a release is deployed, and owned by it after."""
    if not credentials:
        yield
        return
    if desired.create_namespace:
        _ensure_namespace(desired.release.namespace, cluster)
    _ensure(desired.release, credentials, cluster)
    try:
        yield
    finally:
        _ensure(desired.release, credentials, cluster)


def secret_of(
    release: ReleaseId, credentials: Sequence[Credentials], owner: Mapping[str, Any] | None
) -> dict[str, Any]:
    """Return the Secret that the kubelet reads; `owner` is the live ConfigMap, if it is there."""
    config = json.dumps(docker_config(credentials), sort_keys=True)
    name = secret_name(release.name)
    own = {
        k: v
        for k, v in labels(release.name, release.name).items()
        if k.startswith("app.kubernetes.io")
    }
    meta: dict[str, Any] = {"name": name, "namespace": release.namespace, "labels": own}
    if owner is not None:
        meta["ownerReferences"] = [
            {
                "apiVersion": "v1",
                "kind": "ConfigMap",
                "name": owner["metadata"]["name"],
                "uid": owner["metadata"]["uid"],
            }
        ]
    return {
        "apiVersion": "v1",
        "kind": "Secret",
        "type": "kubernetes.io/dockerconfigjson",
        "metadata": meta,
        "data": {KEY: base64.b64encode(config.encode()).decode()},
    }


def _ensure(release: ReleaseId, credentials: Sequence[Credentials], cluster: Cluster) -> None:
    """Write the secret where it is not there or not the same."""
    namespace = release.namespace
    owner = cluster.get(ObjectRef("v1", "ConfigMap", namespace, scripts_config(release.name)))
    wanted = secret_of(release, credentials, owner)
    live = cluster.get(ObjectRef("v1", "Secret", namespace, secret_name(release.name)))
    if live is None or _differs(wanted, live):
        cluster.apply(wanted)


def _differs(wanted: Mapping[str, Any], live: Mapping[str, Any]) -> bool:
    owners = [one["metadata"].get("ownerReferences") for one in (wanted, live)]
    return bool(wanted["data"] != live.get("data") or owners[0] != owners[1])


def _ensure_namespace(namespace: str, cluster: Cluster) -> None:
    """Make the namespace that the Rigelfile names: the secret is there before the first pod."""
    if cluster.get(ObjectRef("v1", "Namespace", "", namespace)) is None:
        meta = {"name": namespace}
        cluster.apply({"apiVersion": "v1", "kind": "Namespace", "metadata": meta})
