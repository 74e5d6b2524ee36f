"""The digest that a registry has for one image."""

from __future__ import annotations

from rigel_k8s.images.credentials import RegistryCredentials
from rigel_k8s.images.registry import resolve_digests


def resolve_digest(image: str, credentials: RegistryCredentials | None = None) -> str | None:
    """Return an image's digest, None if its registry gives none."""
    return resolve_digests([image], [credentials] if credentials else []).get(image)
