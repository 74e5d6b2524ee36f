"""The job that builds an image with docker or podman, and pushes it or loads it into a cluster."""

from __future__ import annotations

import os
import re
import shutil
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping, MutableMapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal

import attrs

from rigel_build.docker import find_docker
from rigel_build.engine import Build, Engine, Session
from rigel_build.podman import find_podman
from rigel_build.process import stream
from rigel_k8s.errors import RigelK8sError, UserError
from rigel_k8s.image_reference import DOCKER_HUB, TAG, parse_reference
from rigel_k8s.images.credentials import RegistryCredentials, is_private
from rigel_k8s.images.registry import DIGESTS
from rigel_k8s.jobs.job import JobContext, JobReporter
from rigel_k8s.option_text import Scalar, has_template, text_of
from rigel_k8s.problems import Problem
from rigel_k8s.settings import Application, Settings
from rigel_k8s.system.oci import host_platform

#: What Rigel builds for by default.
DEFAULT_PLATFORMS = ("linux/amd64", "linux/arm64")

_PLATFORM = re.compile(r"[a-z0-9]+/[a-z0-9_]+(/[a-z0-9]+)?")
_ARGUMENT = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_DATA_LOCK = threading.Lock()
_INSTALL = "install podman (Debian: sudo apt-get install podman), or Docker with its buildx plugin"


@attrs.frozen
class BuildXOptions:
    """The options of a BuildX job: Rigel's, and from `context` on our own.

    Attributes:
        image: the image's name, with or without a tag.
        tags: further tags.
        force_tag_latest: also tag it `latest`; false: never.
        buildargs: values of ARG, by name.
        load: keep the image in docker's or podman's own store.
        push: push every tag, and deploy by the digest that the registry gave.
        platforms: `linux/amd64` and so on; empty: this machine's; default: amd64 and arm64, as far
            as this machine can.
        context: the directory that COPY reads, relative to the application's, which is the default.
        dockerfile: the Dockerfile, relative to the context.
        tool: `docker`, `podman`, or `auto`: docker if it works.
        cluster_load: load it onto the nodes of a local cluster (rigel's, kind, k3d, minikube).
        insecure: the registry speaks plain HTTP, or its certificate cannot be verified.
    """

    image: str
    tags: Sequence[str] = ("latest",)
    force_tag_latest: bool = True
    buildargs: Mapping[str, Scalar] = attrs.field(factory=dict)
    load: bool = False
    push: bool = False
    platforms: Sequence[str] | None = None
    context: str | None = None
    dockerfile: str = "Dockerfile"
    tool: Literal["auto", "docker", "podman"] = "auto"
    cluster_load: bool = False
    insecure: bool = False


class BuildXJob:
    """Builds one image under all its tags; pushes and loads it if requested."""

    options: ClassVar[type[BuildXOptions]] = BuildXOptions
    needs_cluster: ClassVar[bool] = False

    def check(self, options: BuildXOptions, application: Application) -> Sequence[Problem]:
        """Return what docker, podman or a registry would refuse."""
        return [*_check_image(options), *_check_words(options)]

    def run(self, options: BuildXOptions, job: JobContext) -> None:
        """Build, push, load; the digests of pushed images go to the shared data."""
        engine = find_engine(options.tool, os.environ)
        build = _build(options, job.application, engine, job.report)
        with tempfile.TemporaryDirectory(prefix="rigel-build-") as directory:
            session = _session(options, build, job, Path(directory))
            load = options.load or options.cluster_load
            digests = engine.build(build, session, load=load, push=options.push)
            if options.cluster_load:
                _load(build, engine, session, job)
        _remember(job.data, digests)
        job.report.progress(build.names[0], f"built with {engine.name}", done=True)
        for name, digest in digests.items():
            job.report.line(f"pushed {name} ({digest})")


def find_engine(
    tool: str, environ: Mapping[str, str], status: Path = Path("/proc/self/status")
) -> Engine:
    """Return docker or podman; `auto` takes docker if it works, else podman.

    Raises:
        RigelK8sError: the requested one is not installed or cannot build, with the reason.
    """
    reasons = []
    for name in ("docker", "podman") if tool == "auto" else (tool,):
        found = find_docker(environ) if name == "docker" else find_podman(environ, status)
        if not isinstance(found, str):
            return found
        reasons.append(found)
    raise RigelK8sError(f"cannot build images here: {'; '.join(reasons)}", hint=_INSTALL)


def image_names(options: BuildXOptions) -> tuple[str, ...]:
    """Return the image's names: its own tag first, then the others, `latest` as in Rigel."""
    reference = parse_reference(options.image)
    bare = options.image
    if reference.tag:
        bare = bare[: -len(reference.tag) - 1]
    tags = [reference.tag] if reference.tag else []
    tags += [tag for tag in options.tags if tag != "latest"]
    if options.force_tag_latest:
        tags.append("latest")
    return tuple(f"{bare}:{tag}" for tag in dict.fromkeys(tags))


def _build(
    options: BuildXOptions, application: Application, engine: Engine, report: JobReporter
) -> Build:
    context = application.dir / (options.context or "")
    dockerfile = context / options.dockerfile
    if not dockerfile.is_file():
        raise UserError(
            f"cannot build {options.image}: {dockerfile} does not exist",
            hint="write it, or add a job `rigel_k8s.DockerfilePlugin` before this one",
        )
    return Build(
        names=image_names(options),
        context=context,
        dockerfile=dockerfile,
        buildargs={name: text_of(value) for name, value in options.buildargs.items()},
        platforms=_platforms(options.platforms, engine, report),
    )


def _platforms(
    wanted: Sequence[str] | None, engine: Engine, report: JobReporter
) -> tuple[str, ...]:
    """Return what to build for, empty for this machine only.

    Of the default, only what can be emulated: a deploy refuses a machine without its platform.
    """
    able = engine.platforms()
    chosen = DEFAULT_PLATFORMS if wanted is None else tuple(wanted)
    unable = [platform for platform in chosen if platform not in able]
    if unable and wanted is None:
        chosen = tuple(p for p in chosen if p in able) or tuple(able[:1])
    elif unable:
        what = f"{engine.name} cannot emulate {', '.join(unable)} here, so RUN steps will fail"
        report.warn(f"{what}: {engine.more_platforms}")
    return () if chosen == (host_platform(),) else chosen


def _session(options: BuildXOptions, build: Build, job: JobContext, directory: Path) -> Session:
    known = tuple(c for c in job.providers.values() if isinstance(c, RegistryCredentials))
    insecure = {c.registry for c in known if c.insecure}
    if options.insecure:
        insecure.add(parse_reference(options.image).registry)
    if any(map(is_private, build.registries())):
        from rigel_lab import cluster as local

        insecure |= local.registries()
    return Session(
        directory=directory,
        environ=dict(os.environ),
        cancel=job.cancel,
        on_state=lambda state: job.report.progress(build.names[0], state),
        credentials=known,
        insecure=frozenset(insecure),
    )


def _load(build: Build, engine: Engine, session: Session, job: JobContext) -> None:
    archive = session.directory / "image.tar"
    engine.save(build.names, archive, session)
    load_archive(archive, current_context(job.settings), session.on_state, session.cancel)


def load_archive(
    archive: Path, context: str, report: Callable[[str], None], cancel: threading.Event
) -> None:
    """Import an image archive on every node of a context's cluster.

    Raises:
        UserError: the context's name is not that of a cluster on this machine.
        RigelK8sError: the program that loads is missing or failed.
    """
    from rigel_lab import cluster as local

    own = context.removeprefix("rigel-")
    if context.startswith("rigel-") and own in local.names():
        local.load([str(archive)], own, report=report)
        return
    words = _command(archive, context)
    if shutil.which(words[0]) is None:
        raise RigelK8sError(
            f"context {context}: {words[0]} is not installed, which loads images",
            hint="install it, or push to a registry that the cluster pulls from",
        )
    stream(words, what=f"{words[0]} loading into {context}", env=os.environ, cancel=cancel)


def _command(archive: Path, context: str) -> list[str]:
    kind, _, name = context.partition("-")
    if kind == "kind" and name:
        return ["kind", "load", "image-archive", str(archive), "--name", name]
    if kind == "k3d" and name:
        return ["k3d", "image", "import", str(archive), "--cluster", name]
    if kind == "minikube":
        return ["minikube", "--profile", context, "image", "load", str(archive)]
    raise UserError(
        f"cluster_load: context {context} is not a cluster of rigel, kind, k3d or minikube",
        hint="push to a registry that the cluster pulls from instead (`push: true`)",
    )


def current_context(settings: Settings) -> str:
    """Return the context that the command line or the kubeconfig names."""
    if settings.context:
        return settings.context
    from rigel_k8s.kube.kubeconfig import candidates, merge_files

    files = candidates(settings.kubeconfig, os.environ)
    current = merge_files([file for file in files if file.exists()])["current-context"]
    if current:
        return str(current)
    raise UserError(
        "cluster_load: there is no current Kubernetes context",
        hint="choose one with --context, or create a cluster with `rigel cluster up`",
    )


def _remember(data: MutableMapping[str, Any], digests: Mapping[str, str]) -> None:
    """Add the digests to those of earlier jobs; `app:latest` is also written `app`."""
    both = dict(digests)
    for name, digest in digests.items():
        if name.endswith(":latest"):
            both[name.removesuffix(":latest")] = digest
    with _DATA_LOCK:  # jobs of a concurrent stage share the data
        data[DIGESTS] = {**data.get(DIGESTS, {}), **both}


def _check_image(options: BuildXOptions) -> Iterator[Problem]:
    if has_template(options.image):
        return
    try:
        reference = parse_reference(options.image)
    except UserError as error:
        yield Problem(("image",), error.message, "bad-image")
        return
    if reference.digest:
        message = "an image to build has no digest yet: write NAME or NAME:TAG"
        yield Problem(("image",), message, "bad-image")
    elif not image_names(options):
        message = "without `tags` and with `force_tag_latest: false` the image has no tag: add one"
        yield Problem(("image",), message, "bad-image")
    if options.push and reference.name.startswith(f"{DOCKER_HUB}/library/"):
        message = f'"{options.image}" has no registry to push to: write REGISTRY/{options.image}'
        yield Problem(("image",), message, "bad-image")


def _check_words(options: BuildXOptions) -> Iterator[Problem]:
    for number, tag in enumerate(options.tags):
        if not has_template(tag) and not TAG.fullmatch(tag):
            message = f'invalid tag "{tag}": use at most 128 letters, digits, ".", "_" and "-"'
            yield Problem(("tags", number), message, "bad-image")
    for number, platform in enumerate(options.platforms or ()):
        if not has_template(platform) and not _PLATFORM.fullmatch(platform):
            message = f'invalid platform "{platform}": write OS/ARCH, like linux/arm64'
            yield Problem(("platforms", number), message, "bad-platform")
    for name in options.buildargs:
        if not has_template(name) and not _ARGUMENT.fullmatch(name):
            message = f'"{name}" is not a name of a build argument'
            yield Problem(("buildargs", name), message, "bad-name", at_key=True)
