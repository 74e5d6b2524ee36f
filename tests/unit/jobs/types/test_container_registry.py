"""The registry provider without a registry; tests/cluster/test_images.py has one."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.jobs.types.container_registry import ContainerRegistry, ContainerRegistryOptions
from rigel_k8s.settings import Application

GOOD = {"server": "ghcr.io", "username": "me", "password": "se:cret"}


@pytest.mark.parametrize(
    "server", ["", "ghcr.io", "host:5000", "https://index.docker.io/v1/", "[::1]:5"]
)
def test_servers_pass(server: str) -> None:
    """What docker login takes is taken."""
    options = ContainerRegistryOptions(**{**GOOD, "server": server})  # type: ignore[arg-type]
    assert ContainerRegistry().check(options, Application("noetic")) == []


@pytest.mark.parametrize(
    ("changes", "key", "message"),
    [
        ({"server": "my registry"}, "server", "is not a registry"),
        ({"username": ""}, "username", "empty username"),
        ({"password": ""}, "password", "empty password"),
    ],
)
def test_what_cannot_log_in_is_told(changes: dict[str, Any], key: str, message: str) -> None:
    """An empty variable of the environment is told before anything runs."""
    options = ContainerRegistryOptions(**{**GOOD, **changes})
    (problem,) = ContainerRegistry().check(options, Application("noetic"))
    assert problem.path == (key,)
    assert message in problem.message


def test_the_password_is_not_shown() -> None:
    """Printed options show no password."""
    assert "se:cret" not in repr(ContainerRegistryOptions(**GOOD))  # type: ignore[arg-type]
