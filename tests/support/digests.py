"""The digest that a registry has for one image."""

from __future__ import annotations

from rigel_k8s.images.credentials import RegistryCredentials
from rigel_k8s.images.registry import look_up


def resolve_digest(image: str, credentials: RegistryCredentials | None = None) -> str | None:
    """Return an image's digest, None if its registry gives none."""
    return look_up([image], [credentials] if credentials else []).digests.get(image)
