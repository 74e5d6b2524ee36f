"""Image references as docker reads them; text only, without a registry.

The rules are those of github.com/distribution/reference: a first component with a dot, a colon, an
upper-case letter, or `localhost`, is a registry; anything else lives on docker.io, there below
`library/` if it has one component. Digests are those of github.com/opencontainers/go-digest.
"""

from __future__ import annotations

import re

import attrs

from rigel_k8s.errors import UserError

DOCKER_HUB = "docker.io"
TAG = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,127}")

_COMPONENT = re.compile(r"[a-z0-9]+(?:(?:\.|_|__|-+)[a-z0-9]+)*")
_DOMAIN_PART = r"[a-zA-Z0-9](?:[a-zA-Z0-9-]*[a-zA-Z0-9])?"
_REGISTRY = re.compile(rf"(?:{_DOMAIN_PART}(?:\.{_DOMAIN_PART})*|\[[a-fA-F0-9:]+\])(?::[0-9]+)?")
_DIGEST = re.compile(r"sha256:[0-9a-f]{64}|sha384:[0-9a-f]{96}|sha512:[0-9a-f]{128}")
_LONGEST_NAME = 255


@attrs.frozen
class Reference:
    """An image's full name.

    Attributes:
        registry: host and port, `docker.io` by default.
        repository: the path on the registry, with the `library/` that docker may add.
        tag: as written; None without one.
        digest: as written (`sha256:...`); None without one.
    """

    registry: str
    repository: str
    tag: str | None = None
    digest: str | None = None

    @property
    def name(self) -> str:
        """Registry and repository, without tag and digest."""
        return f"{self.registry}/{self.repository}"

    @property
    def version(self) -> str:
        """What to request from a registry: the digest, else the tag, else `latest`."""
        return self.digest or self.tag or "latest"

    def __str__(self) -> str:
        tag = f":{self.tag}" if self.tag else ""
        digest = f"@{self.digest}" if self.digest else ""
        return f"{self.name}{tag}{digest}"


def parse_reference(text: str) -> Reference:
    """Return the parts of an image reference; UserError has the reason why docker refuses it."""
    rest, at, digest = text.partition("@")
    if at and not _DIGEST.fullmatch(digest):
        raise _reference_error(
            text, f'"{digest}" is not a digest (sha256: and 64 hexadecimal digits)'
        )
    rest, tag = _split_tag(rest)
    if tag is not None and not TAG.fullmatch(tag):
        raise _reference_error(
            text, f'"{tag}" is not a tag (letters, digits, ".", "_" and "-", at most 128)'
        )
    registry, repository = _split_registry(rest)
    _check_name(text, registry, repository)
    return Reference(registry, repository, tag, digest or None)


def is_reference(text: str) -> bool:
    """Return whether docker accepts a text as an image reference."""
    try:
        parse_reference(text)
    except UserError:
        return False
    return True


def _split_tag(text: str) -> tuple[str, str | None]:
    head, colon, tag = text.rpartition(":")
    if not colon or "/" in tag:
        return text, None
    return head, tag


def _split_registry(name: str) -> tuple[str, str]:
    first, slash, path = name.partition("/")
    known = first == "localhost" or "." in first or ":" in first or first != first.lower()
    if slash and known:
        registry, repository = first, path
    else:
        registry, repository = DOCKER_HUB, name
    if registry == f"index.{DOCKER_HUB}":
        registry = DOCKER_HUB
    if registry == DOCKER_HUB and "/" not in repository:
        repository = f"library/{repository}"
    return registry, repository


def _check_name(text: str, registry: str, repository: str) -> None:
    if not _REGISTRY.fullmatch(registry):
        raise _reference_error(text, f'"{registry}" is not a registry (host, or host:port)')
    for component in repository.split("/"):
        if _COMPONENT.fullmatch(component):
            continue
        if _COMPONENT.fullmatch(component.lower()):
            raise _reference_error(
                text, f'"{component}" has upper-case letters, write "{component.lower()}"'
            )
        raise _reference_error(text, f'"{component}" is not a part of an image name')
    if len(f"{registry}/{repository}") > _LONGEST_NAME:
        raise _reference_error(text, f"the name is longer than {_LONGEST_NAME} characters")


def _reference_error(text: str, why: str) -> UserError:
    return UserError(
        f'invalid image reference "{text}": {why}',
        hint="write it as [REGISTRY/]NAME[:TAG][@DIGEST]",
    )
