"""Credentials for registries, as docker, podman and Kubernetes read them; never printed."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping
from ipaddress import ip_address
from typing import Any

import attrs

from rigel_k8s.image_reference import DOCKER_HUB

#: The key that docker, podman and the kubelet use for Docker Hub.
_HUB_KEY = "https://index.docker.io/v1/"


@attrs.frozen
class RegistryCredentials:
    """A user of a registry.

    Attributes:
        server: as the user wrote it.
        username: empty if the registry needs none.
        password: a password or token; not part of the repr.
        insecure: the registry speaks plain HTTP, or its certificate cannot be verified.
    """

    server: str
    username: str = ""
    password: str = attrs.field(default="", repr=False)
    insecure: bool = False

    @property
    def registry(self) -> str:
        """The registry's host and port, as image references name it."""
        return registry_name(self.server)


def registry_name(server: str) -> str:
    """Return host and port of a server that may be written as a URL."""
    host = server.split("://", 1)[-1].split("/", 1)[0]
    hub = host in ("", DOCKER_HUB, f"index.{DOCKER_HUB}", f"registry-1.{DOCKER_HUB}")
    return DOCKER_HUB if hub else host


def is_loopback(registry: str) -> bool:
    """Whether the registry is on this machine, where docker too speaks plain HTTP."""
    host = registry.rsplit(":", 1)[0] if not registry.endswith("]") else registry
    return host == "localhost" or host == "[::1]" or host.startswith("127.")


def is_private(registry: str) -> bool:
    """Whether the registry is a bare address of a private network, as a local cluster's is."""
    try:
        return ip_address(registry.rsplit(":", 1)[0].strip("[]")).is_private
    except ValueError:
        return False


def credentials_for(registry: str, known: Iterable[Any]) -> RegistryCredentials | None:
    """Return the first credentials for a registry; other values are skipped."""
    for one in known:
        if isinstance(one, RegistryCredentials) and one.registry == registry_name(registry):
            return one
    return None


def docker_config(
    known: Iterable[RegistryCredentials], base: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Return the content of a .docker/config.json: the base's, where ours override its own.

    It also is the `.dockerconfigjson` of a pull secret.
    """
    config = dict(base or {})
    auths = dict(config.get("auths", {}))
    helpers = dict(config.get("credHelpers", {}))
    for one in known:
        if not one.username:
            continue
        token = base64.b64encode(f"{one.username}:{one.password}".encode()).decode()
        for key in (_HUB_KEY, DOCKER_HUB) if one.registry == DOCKER_HUB else (one.registry,):
            auths[key] = {"auth": token}
            helpers.pop(key, None)
    config["auths"] = auths
    if "credHelpers" in config:
        config["credHelpers"] = helpers
    return config
