"""Builds and pushes with podman.

Two things that docker's users expect are set for our own runs only, in a registries.conf
of their own: `FROM ros:noetic` means docker.io, and registries known to speak plain HTTP may.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import uuid
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import attrs

from rigel_build.engine import Build, Session, mark, pass_on
from rigel_build.process import ask, find_last, stream
from rigel_build.process import build as run_build
from rigel_build.progress import Steps
from rigel_k8s.image_reference import DOCKER_HUB, parse_reference
from rigel_k8s.images.credentials import docker_config, is_loopback
from rigel_k8s.system.oci import host_platform
from rigel_k8s.system.process import finish

ISOLATION = "BUILDAH_ISOLATION"
_CAP_SYS_RESOURCE = 24
_EMULATORS = {
    "linux/amd64": "qemu-x86_64",
    "linux/arm64": "qemu-aarch64",
    "linux/arm/v7": "qemu-arm",
}


@attrs.frozen
class Podman:
    """podman at `program`; `isolation` is what its build steps need here, None for its default."""

    program: str
    isolation: str | None = None
    binfmt: Path = Path("/proc/sys/fs/binfmt_misc")
    name: str = "podman"

    @property
    def more_platforms(self) -> str:
        """How to make it build for other platforms."""
        return "install qemu-user-static for them"

    def platforms(self) -> Sequence[str]:
        """Return this machine's platform and those that the kernel has an emulator for."""
        others = (p for p, emulator in _EMULATORS.items() if (self.binfmt / emulator).exists())
        return tuple(dict.fromkeys([host_platform(), *others]))

    def build(self, build: Build, session: Session, *, load: bool, push: bool) -> dict[str, str]:
        """Build, and push if requested; returns the digest of each pushed name.

        An image for several platforms is not kept in podman's store; `load` then builds again, from
        the cache, for this machine only.
        """
        run = _Run(self.program, session, _environment(self.isolation, session, build))
        if len(build.platforms) < 2:
            run.build(build, _tags(build))
            return {
                n: run.push(["push"], full, full) for n, full in _list_full_names(build) if push
            }
        manifest = f"localhost/rigel-k8s-build:{uuid.uuid4().hex}"
        try:
            run.build(build, ["--manifest", manifest, *_cache(build)])
            words = ["manifest", "push", "--all"]
            digests = {
                n: run.push(words, manifest, full) for n, full in _list_full_names(build) if push
            }
        finally:
            run.forget(manifest)
        if load:
            run.build(attrs.evolve(build, platforms=()), _tags(build))
        return digests

    def save(self, names: Sequence[str], file: Path, session: Session) -> None:
        """Write the images to a docker archive."""
        run = _Run(self.program, session, session.environ)
        words = ["save", "--format", "docker-archive", "--multi-image-archive"]
        run(
            [*words, "--output", str(file), *map(_complete_name, names)],
            f"save of {', '.join(names)}",
        )


def find_podman(environ: Mapping[str, str], status: Path) -> Podman | str:
    """Return podman, or why it cannot build; `status` is this process' own file of /proc."""
    program = shutil.which("podman", path=environ.get("PATH"))
    if program is None:
        return "podman is not installed"
    works, output = ask([program, "version"], environ)
    if not works:
        return f"podman does not run ({find_last(output)})"
    chosen = ISOLATION in environ or not status.exists()
    chroot = not chosen and misses_sys_resource(status.read_text("utf-8"))
    return Podman(program, isolation="chroot" if chroot else None)


def misses_sys_resource(status: str) -> bool:
    """Whether a process with this /proc/PID/status is root without CAP_SYS_RESOURCE."""
    fields = dict(line.split(":", 1) for line in status.splitlines() if ":" in line)
    root = fields.get("Uid", "").split()[1:2] == ["0"]
    return root and not int(fields.get("CapEff", "0"), 16) >> _CAP_SYS_RESOURCE & 1


def registries_conf(text: str, insecure: Iterable[str]) -> str:
    """Return a registries.conf with docker's short names and the insecure registries."""
    if re.search(r"^\s*\[registries\.", text, re.MULTILINE):
        text = ""  # the format of before 2018, which cannot be added to
    if not re.search(r"^\s*unqualified-search-registries", text, re.MULTILINE):
        text = f'unqualified-search-registries = ["{DOCKER_HUB}"]\n{text}'
    for registry in sorted(insecure):
        text += f'\n[[registry]]\nlocation = "{registry}"\ninsecure = true\n'
    return text


@attrs.frozen
class _Run:
    """podman's commands for one session."""

    program: str
    session: Session
    env: Mapping[str, str]

    def __call__(self, words: Sequence[str], what: str) -> None:
        stream(
            [self.program, *words],
            what=f"podman {what}",
            env=self.env,
            cancel=self.session.cancel,
            on_line=Steps(self.session.on_state),
        )

    def build(self, build: Build, target: Sequence[str]) -> None:
        words = ["build", "--file", str(self.dockerfile(build)), *target]
        if build.platforms:
            words += ["--platform", ",".join(build.platforms)]
        arguments, env = pass_on(build.buildargs, self.env)
        words += arguments
        run_build(
            [self.program, *words, str(build.context)],
            what=f"podman build of {build.names[0]}",
            env=env,
            cancel=self.session.cancel,
            on_line=Steps(self.session.on_state),
        )

    def dockerfile(self, build: Build) -> Path:
        """Return the Dockerfile to build, its build arguments marked for the cache."""
        text = build.dockerfile.read_text("utf-8")
        marked = mark(text, build.buildargs)
        if marked == text:
            return build.dockerfile
        file = self.session.directory / f"Dockerfile-{uuid.uuid4().hex}"
        file.write_text(marked, "utf-8")
        for ending in (".containerignore", ".dockerignore"):
            ignored = build.dockerfile.with_name(build.dockerfile.name + ending)
            if ignored.is_file():
                file.with_name(file.name + ending).write_bytes(ignored.read_bytes())
        return file

    def push(self, words: Sequence[str], image: str, name: str) -> str:
        """Push an image under a name and return its digest."""
        self.session.on_state(f"pushing {name}")
        file = self.session.directory / f"digest-{uuid.uuid4().hex}"
        words = [*words, "--digestfile", str(file), image, f"docker://{name}"]
        self(words, f"push of {name}")
        return file.read_text("utf-8").strip()

    def forget(self, manifest: str) -> None:
        """Drop a working name, which a failed or interrupted build may not have reached."""
        finish([self.program, "manifest", "rm", manifest], env=self.env)


def _complete_name(name: str) -> str:
    # podman reads a short name of its own as localhost/NAME, and a cluster as docker.io/NAME.
    return str(parse_reference(name))


def _list_full_names(build: Build) -> list[tuple[str, str]]:
    return [(name, _complete_name(name)) for name in build.names]


def _tags(build: Build) -> list[str]:
    return [word for _, full in _list_full_names(build) for word in ("--tag", full)]


def _cache(build: Build) -> list[str]:
    # Without a base image, podman 4 uses cached layers of one platform for another.
    text = build.dockerfile.read_text("utf-8")
    scratch = re.search(r"(?im)^\s*FROM\s+(--\S+\s+)*scratch\b", text)
    return ["--no-cache"] if scratch else []


def _environment(isolation: str | None, session: Session, build: Build) -> dict[str, str]:
    env = dict(session.environ)
    if isolation is not None:
        env[ISOLATION] = isolation
    insecure = {r for r in build.registries() if is_loopback(r)} | session.insecure
    conf = session.directory / "registries.conf"
    conf.write_text(registries_conf(_read_first(_registries_files(env)), insecure), "utf-8")
    env["CONTAINERS_REGISTRIES_CONF"] = str(conf)
    if session.credentials:
        auth = session.directory / "auth.json"
        known = json.loads(_read_first(_auth_files(env)) or "{}")
        auth.touch(0o600)
        auth.write_text(json.dumps(docker_config(session.credentials, known)), "utf-8")
        env["REGISTRY_AUTH_FILE"] = str(auth)
    return env


def _registries_files(env: Mapping[str, str]) -> list[str]:
    home = env.get("XDG_CONFIG_HOME") or f"{env.get('HOME', '')}/.config"
    given = env.get("CONTAINERS_REGISTRIES_CONF", "")
    name = "containers/registries.conf"
    return [given, f"{home}/{name}", f"/etc/{name}", f"/usr/share/{name}"]


def _auth_files(env: Mapping[str, str]) -> list[str]:
    """Return the files that podman itself would read, in its order."""
    home = env.get("HOME", "")
    runtime, user = env.get("XDG_RUNTIME_DIR"), os.geteuid()
    config = env.get("XDG_CONFIG_HOME") or f"{home}/.config"
    return [
        env.get("REGISTRY_AUTH_FILE", ""),
        f"{runtime}/containers/auth.json" if runtime else f"/run/containers/{user}/auth.json",
        f"{config}/containers/auth.json",
        f"{home}/.docker/config.json",
    ]


def _read_first(files: Iterable[str]) -> str:
    for file in files:
        if file and Path(file).is_file():
            return Path(file).read_text("utf-8")
    return ""
