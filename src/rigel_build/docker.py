"""Builds and pushes with docker's buildx, on the builder that the user has chosen for it."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import attrs

from rigel_build.engine import Build, Session, pass_on
from rigel_build.process import ask, find_last, stream
from rigel_build.process import build as run_build
from rigel_build.progress import Steps
from rigel_k8s.errors import RigelK8sError
from rigel_k8s.image_reference import DOCKER_HUB
from rigel_k8s.images.credentials import docker_config
from rigel_k8s.system.oci import host_platform

#: Parts of the user's docker configuration that a configuration of our own must still lead to.
_KEPT = ("cli-plugins", "contexts", "tls")


@attrs.frozen
class Docker:
    """docker at `program`; `inspected` is the output of `docker buildx inspect`."""

    program: str
    inspected: str
    name: str = "docker"

    @property
    def more_platforms(self) -> str:
        """How to make it build for other platforms."""
        return "`docker buildx create --use` creates a builder for them, and qemu emulates"

    def platforms(self) -> Sequence[str]:
        """Return the builder's platforms; docker's own builder builds for one at a time."""
        known = builder_platforms(self.inspected) or [host_platform()]
        own = re.search(r"^Driver:\s+docker$", self.inspected, re.MULTILINE)
        return tuple(known[:1] if own else known)

    def build(self, build: Build, session: Session, *, load: bool, push: bool) -> dict[str, str]:
        """Build, and push if requested; returns the digest of each pushed name.

        These are two separate runs, the second from the cache: buildx has one output per run.
        """
        env = _environment(session)
        digests: dict[str, str] = {}
        if push:
            metadata = session.directory / "metadata.json"
            output = ["--push", "--metadata-file", str(metadata)]
            self._run(build, output, session, env)
            digest = _digest(metadata)
            digests = dict.fromkeys(build.names, digest)
        if load or not push:
            host = attrs.evolve(build, platforms=()) if len(build.platforms) > 1 else build
            self._run(host, ["--load"], session, env)
        return digests

    def save(self, names: Sequence[str], file: Path, session: Session) -> None:
        """Write the images to a docker archive."""
        stream(
            [self.program, "save", "--output", str(file), *names],
            what=f"docker save of {', '.join(names)}",
            env=session.environ,
            cancel=session.cancel,
        )

    def _run(
        self, build: Build, output: Sequence[str], session: Session, env: Mapping[str, str]
    ) -> None:
        words = [self.program, "buildx", "build", "--progress", "plain", *output]
        words += ["--file", str(build.dockerfile)]
        for name in build.names:
            words += ["--tag", name]
        if build.platforms:
            words += ["--platform", ",".join(build.platforms)]
        arguments, env = pass_on(build.buildargs, env)
        words += arguments
        run_build(
            [*words, str(build.context)],
            what=f"docker build of {build.names[0]}",
            env=env,
            cancel=session.cancel,
            on_line=Steps(session.on_state),
        )


def find_docker(environ: Mapping[str, str]) -> Docker | str:
    """Return docker, or why it cannot build."""
    program = shutil.which("docker", path=environ.get("PATH"))
    if program is None:
        return "docker is not installed"
    works, _ = ask([program, "buildx", "version"], environ)
    if not works:
        return "docker is installed without its buildx plugin"
    works, output = ask([program, "buildx", "inspect", "--bootstrap"], environ)
    if not works or "Status:" not in output or "Error:" in output:
        return f"cannot reach docker's builder ({find_last(output)})"
    return Docker(program, output)


def builder_platforms(inspected: str) -> list[str]:
    """Return the platforms that `docker buildx inspect` lists, the builder's own first."""
    match = re.search(r"^Platforms:\s+(.+)$", inspected, re.MULTILINE)
    return [word.strip(" *") for word in match.group(1).split(",")] if match else []


def add_credentials(config: Mapping[str, Any], session: Session) -> dict[str, Any]:
    """Return a docker config.json with the session's credentials, even if a helper has others.

    With an empty helper for a registry, docker uses the credentials in this file.
    """
    merged = docker_config(session.credentials, config)
    if "credsStore" in merged:
        hosts = {c.registry for c in session.credentials if c.username}
        if DOCKER_HUB in hosts:
            hosts.add(f"index.{DOCKER_HUB}")
        merged["credHelpers"] = {**merged.get("credHelpers", {}), **dict.fromkeys(hosts, "")}
    return merged


def _environment(session: Session) -> dict[str, str]:
    """Return an environment where only this build sees the session's credentials.

    Default attestations carry the time of the build: with them an unchanged image would get a new
    digest each time, and would be rolled out.
    """
    env = {"BUILDX_NO_DEFAULT_ATTESTATIONS": "1", **session.environ}
    if not session.credentials:
        return env
    known = Path(env.get("DOCKER_CONFIG") or f"{env.get('HOME', '')}/.docker")
    own = session.directory / "docker"
    own.mkdir(mode=0o700, exist_ok=True)
    for part in _KEPT:
        if (known / part).exists() and not (own / part).exists():
            (own / part).symlink_to((known / part).resolve())
    file = known / "config.json"
    config = json.loads(file.read_text("utf-8")) if file.is_file() else {}
    (own / "config.json").touch(0o600)
    (own / "config.json").write_text(json.dumps(add_credentials(config, session)), "utf-8")
    env.setdefault("BUILDX_CONFIG", str(known / "buildx"))
    return {**env, "DOCKER_CONFIG": str(own)}


def _digest(metadata: Path) -> str:
    digest = json.loads(metadata.read_text("utf-8")).get("containerimage.digest")
    if not isinstance(digest, str):
        raise RigelK8sError(
            "docker buildx pushed the image but did not report its digest",
            hint="use buildx 0.8 or newer",
        )
    return digest
