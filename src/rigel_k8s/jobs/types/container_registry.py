"""The provider that holds the credentials of an image registry; it pushes and pulls nothing."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import ClassVar

import attrs

from rigel_k8s.images.credentials import RegistryCredentials
from rigel_k8s.images.registry import log_in
from rigel_k8s.jobs.job import JobReporter
from rigel_k8s.option_text import has_template
from rigel_k8s.problems import Problem
from rigel_k8s.settings import Application

#: What Rigel, and docker, mean by an empty server.
DOCKER_HUB = "docker.io"
_SERVER = re.compile(r"(https?://)?[A-Za-z0-9.\[\]:-]+(:\d+)?(/.*)?")


@attrs.frozen
class ContainerRegistryOptions:
    """The options of a registry provider, those of Rigel's and `insecure`.

    Attributes:
        server: the registry, the beginning of image names (`ghcr.io`, `host:5000`, `docker.io`);
            empty for docker.io.
        username: the user that pushes and pulls.
        password: a password or an access token.
        insecure: it speaks plain HTTP, or its certificate cannot be verified.
    """

    server: str
    username: str
    password: str = attrs.field(repr=False)
    insecure: bool = False


class ContainerRegistry:
    """Checks the credentials once, and passes them to the jobs; writes nothing to this machine.

    The connection is a rigel_k8s.images.credentials.Credentials.
    """

    options: ClassVar[type[ContainerRegistryOptions]] = ContainerRegistryOptions
    needs_cluster: ClassVar[bool] = False

    def check(
        self, options: ContainerRegistryOptions, application: Application
    ) -> Sequence[Problem]:
        """Return what is not a valid registry or user."""
        problems = []
        if (
            options.server
            and not has_template(options.server)
            and not _SERVER.fullmatch(options.server)
        ):
            message = f'"{options.server}" is not a registry: write HOST or HOST:PORT'
            problems.append(Problem(("server",), message, "bad-registry"))
        for key in ("username", "password"):
            if not getattr(options, key):
                message = f"an empty {key}; a registry without users needs no provider"
                problems.append(Problem((key,), message, "empty-value"))
        return problems

    def connect(
        self, options: ContainerRegistryOptions, name: str, report: JobReporter
    ) -> RegistryCredentials:
        """Try the credentials against the registry; RigelK8sError if it refuses them."""
        server = options.server or DOCKER_HUB
        credentials = RegistryCredentials(
            server, options.username, options.password, insecure=options.insecure
        )
        if log_in(credentials):
            report.line(f"logged in to {server} as {options.username}")
        else:
            report.line(f"{server} needs no credentials")
        return credentials

    def disconnect(self, connection: RegistryCredentials) -> None:
        """Do nothing: connect wrote nothing and holds no session."""
