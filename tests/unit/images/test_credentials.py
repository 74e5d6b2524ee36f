"""Credentials in docker's format, and what never shows them."""

from __future__ import annotations

import base64

import pytest

from rigel_k8s.images.credentials import (
    RegistryCredentials,
    credentials_for,
    docker_config,
    is_loopback,
    is_private,
    registry_name,
)

ME = RegistryCredentials("host:5000", "me", "se:cret")


def test_the_password_is_not_shown() -> None:
    """Logs and tracebacks that print credentials do not print the password."""
    assert "se:cret" not in repr(ME)
    assert "me" in repr(ME)


@pytest.mark.parametrize(
    ("server", "name"),
    [
        ("ghcr.io", "ghcr.io"),
        ("https://host:5000/v2/", "host:5000"),
        ("docker.io", "docker.io"),
        ("https://index.docker.io/v1/", "docker.io"),
        ("registry-1.docker.io", "docker.io"),
        ("", "docker.io"),
    ],
)
def test_servers_are_known_by_the_name_in_images(server: str, name: str) -> None:
    """A server written as a URL, and every name of Docker Hub, is found by image references."""
    assert registry_name(server) == name
    assert credentials_for(name, [RegistryCredentials(server, "a", "b")]) is not None


def test_credentials_go_to_their_registry_alone() -> None:
    """Another registry gets no credentials; what other providers connected to is passed over."""
    assert credentials_for("host:5001", [ME]) is None
    assert credentials_for("host:5000", ["ssh keys", ME]) == ME


def test_the_config_is_dockers() -> None:
    """Registries are keys of `auths`, each with user and password in base64."""
    auth = base64.b64encode(b"me:se:cret").decode()
    assert docker_config([ME]) == {"auths": {"host:5000": {"auth": auth}}}
    hub = docker_config([RegistryCredentials("docker.io", "me", "se:cret")])["auths"]
    assert hub == {"https://index.docker.io/v1/": {"auth": auth}, "docker.io": {"auth": auth}}


def test_what_the_user_had_stays() -> None:
    """The user's other registries and settings stay; ours wins for its own registry."""
    base = {
        "auths": {"ghcr.io": {"auth": "x"}, "host:5000": {"auth": "old"}},
        "credHelpers": {"host:5000": "pass", "gcr.io": "gcloud"},
        "proxies": {},
    }
    config = docker_config([ME], base)
    assert config["auths"]["ghcr.io"] == {"auth": "x"}
    assert config["auths"]["host:5000"] != {"auth": "old"}
    assert config["credHelpers"] == {"gcr.io": "gcloud"}
    assert config["proxies"] == {}
    assert base["auths"]["host:5000"] == {"auth": "old"}  # type: ignore[index]


def test_a_registry_without_users_is_not_written() -> None:
    """Credentials without a user write nothing."""
    assert docker_config([RegistryCredentials("host:5000")]) == {"auths": {}}


@pytest.mark.parametrize(
    "registry", ["localhost", "localhost:5000", "127.0.0.1:5000", "[::1]:5000"]
)
def test_loopback_is_known(registry: str) -> None:
    """This machine's registries are known by name and address."""
    assert is_loopback(registry)


@pytest.mark.parametrize("registry", ["localhost.example.org", "10.0.0.1:5000", "docker.io"])
def test_other_registries_are_not_loopback(registry: str) -> None:
    """Everything else is not this machine."""
    assert not is_loopback(registry)


def test_private_addresses_are_known() -> None:
    """An address of a private network is private; a name never is."""
    assert is_private("10.66.0.2:5000")
    assert is_private("[fd00::1]:5000")
    assert not is_private("8.8.8.8:5000")
    assert not is_private("registry.local:5000")
