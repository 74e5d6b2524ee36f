"""The BuildX job without a build: names, platforms, checks; builds are in tests/cluster."""

from __future__ import annotations

import os
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import attrs
import pytest

from rigel_build import buildx
from rigel_build.buildx import BuildXJob, BuildXOptions, image_names
from rigel_build.engine import Build, Engine, Session
from rigel_k8s.errors import RigelK8sError, UserError
from rigel_k8s.images.registry import DIGESTS
from rigel_k8s.jobs.job import JobContext
from rigel_k8s.settings import Application, Settings
from rigel_k8s.system.oci import host_platform
from tests.support.recorder import Recorder

HOST = host_platform()
OTHER = "linux/arm64" if HOST == "linux/amd64" else "linux/amd64"


@attrs.define
class RecordingEngine:
    """An engine that builds nothing and remembers what it was asked."""

    able: tuple[str, ...] = (HOST,)
    name: str = "recorder"
    more_platforms: str = "get an emulator"
    asked: dict[str, Any] = attrs.field(factory=dict)

    def platforms(self) -> Sequence[str]:
        return self.able

    def build(self, build: Build, session: Session, *, load: bool, push: bool) -> dict[str, str]:
        self.asked = {"build": build, "session": session, "load": load, "push": push}
        return {name: f"sha256:{n}" for n, name in enumerate(build.names) if push}

    def save(self, names: Sequence[str], file: Path, session: Session) -> None:
        file.write_text(" ".join(names))


@pytest.fixture
def engine(monkeypatch: pytest.MonkeyPatch) -> RecordingEngine:
    recorder = RecordingEngine()

    def find(tool: str, environ: object) -> Engine:
        return recorder

    monkeypatch.setattr(buildx, "find_engine", find)
    return recorder


@pytest.fixture
def job(tmp_path: Path) -> JobContext:
    (tmp_path / "Dockerfile").write_text("FROM scratch\n")
    return JobContext("build", Application("noetic", tmp_path), Recorder())


def told(job: JobContext) -> Recorder:
    assert isinstance(job.report, Recorder)
    return job.report


@pytest.mark.parametrize(
    ("options", "names"),
    [
        ({"image": "h:5/app"}, ["h:5/app:latest"]),
        ({"image": "h:5/app:1"}, ["h:5/app:1", "h:5/app:latest"]),
        ({"image": "app", "tags": ["a", "b"]}, ["app:a", "app:b", "app:latest"]),
        ({"image": "app:a", "tags": ["a", "b"]}, ["app:a", "app:b", "app:latest"]),
        ({"image": "app:1", "force_tag_latest": False}, ["app:1"]),
        ({"image": "app", "tags": ["1", "latest"], "force_tag_latest": False}, ["app:1"]),
        ({"image": "app", "tags": []}, ["app:latest"]),
        ({"image": "app", "force_tag_latest": False}, []),
    ],
)
def test_tags_are_rigels(options: dict[str, Any], names: list[str]) -> None:
    """The image's own tag, the others, and `latest` unless it is not wanted."""
    assert list(image_names(BuildXOptions(**options))) == names


def test_digests_are_kept_for_the_deploy(engine: RecordingEngine, job: JobContext) -> None:
    """Every pushed name leads to its digest, `latest` without its tag too; earlier ones stay."""
    job.data[DIGESTS] = {"other:1": "sha256:x", "h:5/app:1": "sha256:old"}
    before = job.data[DIGESTS]
    BuildXJob().run(BuildXOptions("h:5/app:1", push=True), job)
    assert job.data[DIGESTS] == {
        "other:1": "sha256:x",
        "h:5/app:1": "sha256:0",
        "h:5/app:latest": "sha256:1",
        "h:5/app": "sha256:1",
    }
    assert before == {"other:1": "sha256:x", "h:5/app:1": "sha256:old"}
    assert "pushed h:5/app:1 (sha256:0)" in told(job).texts


def test_rigels_default_platforms_are_built_where_possible(
    engine: RecordingEngine, job: JobContext
) -> None:
    """Left out, platforms are amd64 and arm64; what cannot be emulated is left out."""
    BuildXJob().run(BuildXOptions("h:5/app"), job)
    assert engine.asked["build"].platforms == ()
    assert not [line for line in told(job).texts if OTHER in line]  # the deploy says if it matters
    engine.able = (HOST, OTHER)
    BuildXJob().run(BuildXOptions("h:5/app"), job)
    assert set(engine.asked["build"].platforms) == {HOST, OTHER}


def test_platforms_that_were_asked_for_are_never_left_out(
    engine: RecordingEngine, job: JobContext
) -> None:
    """A written platform is built even if its RUN steps may fail; that is warned of."""
    BuildXJob().run(BuildXOptions("h:5/app", platforms=[HOST, OTHER]), job)
    assert engine.asked["build"].platforms == (HOST, OTHER)
    (warning,) = told(job).warnings
    assert OTHER in warning


@pytest.mark.parametrize("platforms", [[], [HOST]])
def test_this_machines_platform_is_no_option(
    platforms: list[str], engine: RecordingEngine, job: JobContext
) -> None:
    """Building for this machine alone asks for no platform, and warns of nothing."""
    BuildXJob().run(BuildXOptions("h:5/app", platforms=platforms), job)
    assert engine.asked["build"].platforms == ()
    assert told(job).warnings == []


def test_context_and_dockerfile_are_relative(engine: RecordingEngine, job: JobContext) -> None:
    """The context to the application's directory, the Dockerfile to the context."""
    place = job.application.dir / "docker"
    place.mkdir()
    (place / "robot.Dockerfile").write_text("FROM scratch\n")
    options = BuildXOptions("h:5/app", context="docker", dockerfile="robot.Dockerfile")
    BuildXJob().run(options, job)
    assert engine.asked["build"].context == place
    assert engine.asked["build"].dockerfile == place / "robot.Dockerfile"


def test_a_missing_dockerfile_is_told(engine: RecordingEngine, job: JobContext) -> None:
    """The error names the file and what writes one."""
    with pytest.raises(UserError, match=r"/none does not exist") as caught:
        BuildXJob().run(BuildXOptions("h:5/app", dockerfile="none"), job)
    assert "DockerfilePlugin" in str(caught.value.hint)


def test_build_arguments_are_text(engine: RecordingEngine, job: JobContext) -> None:
    """Scalars of YAML become the text that YAML has for them."""
    BuildXJob().run(BuildXOptions("h:5/app", buildargs={"A": True, "B": 1.5, "C": "x"}), job)
    assert engine.asked["build"].buildargs == {"A": "true", "B": "1.5", "C": "x"}


def test_nothing_of_the_job_stays_on_the_machine(engine: RecordingEngine, job: JobContext) -> None:
    """The directory with credentials and archives is gone after the job."""
    BuildXJob().run(BuildXOptions("h:5/app"), job)
    assert not engine.asked["session"].directory.exists()


def test_cluster_load_hands_the_archive_to_the_cluster(
    engine: RecordingEngine, job: JobContext, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The image is kept by the engine, saved, and loaded into the context of the command line."""
    loaded: list[tuple[str, str]] = []

    def load(archive: Path, context: str, *_: object) -> None:
        loaded.append((archive.read_text(), context))

    monkeypatch.setattr(buildx, "load_archive", load)
    job = attrs.evolve(job, settings=Settings(context="kind-x"))
    BuildXJob().run(BuildXOptions("app:1", cluster_load=True), job)
    assert engine.asked["load"]
    assert loaded == [("app:1 app:latest", "kind-x")]


@pytest.mark.parametrize(
    ("options", "path", "message"),
    [
        ({"image": "App"}, ("image",), 'write "app"'),
        ({"image": f"app@sha256:{'a' * 64}"}, ("image",), "has no digest yet"),
        ({"image": "app", "force_tag_latest": False}, ("image",), "the image has no tag"),
        ({"image": "app", "push": True}, ("image",), "has no registry"),
        ({"image": "app", "tags": ["ok", "not ok"]}, ("tags", 1), "invalid tag"),
        ({"image": "app", "platforms": ["arm64"]}, ("platforms", 0), "like linux/arm64"),
        ({"image": "app", "buildargs": {"A B": "1"}}, ("buildargs", "A B"), "not a name of"),
    ],
)
def test_what_cannot_be_built_is_told_before(
    options: dict[str, Any], path: tuple[str | int, ...], message: str
) -> None:
    """Each problem has the path of its value."""
    (problem,) = BuildXJob().check(BuildXOptions(**options), Application("noetic"))
    assert problem.path == path
    assert message in problem.message


def test_what_only_a_run_can_tell_is_let_through() -> None:
    """Values with a hole for shared data are not judged before."""
    hole = "{{ data.x }}"
    options = BuildXOptions(hole, [hole], buildargs={"A": hole}, platforms=[hole])
    assert BuildXJob().check(options, Application("noetic")) == []


# Loading into a local cluster


@pytest.mark.programs
@pytest.mark.parametrize(
    ("context", "words"),
    [
        ("kind-a-b", "kind load image-archive {} --name a-b"),
        ("k3d-a", "k3d image import {} --cluster a"),
        ("minikube", "minikube --profile minikube image load {}"),
        ("minikube-2", "minikube --profile minikube-2 image load {}"),
    ],
)
def test_other_local_clusters_are_loaded_by_their_own_program(
    context: str, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """kind, k3d and minikube get the archive as their documentation says."""
    program, record = words.split()[0], tmp_path / "record"
    (tmp_path / program).write_text(f'#!/bin/sh\necho "$@" > {record}\n')
    (tmp_path / program).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    buildx.load_archive(Path("/x.tar"), context, lambda _: None, threading.Event())
    assert record.read_text().split() == words.format("/x.tar").split()[1:]


def test_a_program_that_is_missing_is_told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The error names the program that the context needs."""
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(RigelK8sError, match="kind is not installed, which loads images"):
        buildx.load_archive(Path("/x.tar"), "kind-x", lambda _: None, threading.Event())


@pytest.mark.parametrize("context", ["prod", "rigel-there-is-none", "kind", "gke_a_b_kind"])
def test_a_cluster_elsewhere_is_refused(context: str) -> None:
    """Nothing can be loaded into a cluster that is not on this machine; a push is the way."""
    with pytest.raises(UserError, match=f"context {context} is not a cluster of") as caught:
        buildx.load_archive(Path("/x.tar"), context, lambda _: None, threading.Event())
    assert "push: true" in str(caught.value.hint)


def test_the_context_is_kubectls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """--context wins, then --kubeconfig, then the first of KUBECONFIG that names one."""
    (tmp_path / "a").write_text("kind: Config\n")
    (tmp_path / "b").write_text("current-context: kind-b\n")
    (tmp_path / "c").write_text("current-context: kind-c\n")
    monkeypatch.setenv("KUBECONFIG", f"{tmp_path}/none:{tmp_path}/a:{tmp_path}/b:{tmp_path}/c")
    assert buildx.current_context(Settings()) == "kind-b"
    assert buildx.current_context(Settings(kubeconfig=tmp_path / "c")) == "kind-c"
    assert buildx.current_context(Settings(context="x")) == "x"
    with pytest.raises(UserError, match="no current Kubernetes context"):
        buildx.current_context(Settings(kubeconfig=tmp_path / "a"))
    (tmp_path / "d").write_text("current-context: {")
    with pytest.raises(UserError, match="is not YAML"):
        buildx.current_context(Settings(kubeconfig=tmp_path / "d"))
