"""Images for real: podman builds them, Debian's docker-registry and the cluster take them.

The registries run on loopback for these tests alone. docker cannot run here; what it is given is in
tests/unit/images/test_docker.py.
"""

from __future__ import annotations

import http.client
import io
import json
import re
import shutil
import subprocess
import tarfile
import threading
import uuid
from collections.abc import Iterator
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Literal

import attrs
import pytest

from rigel_build.buildx import BuildXJob, BuildXOptions
from rigel_build.dockerfile import (
    Compiler,
    DockerfileJob,
    DockerfileOptions,
    DockerfileVariable,
)
from rigel_k8s.errors import CommandFailed
from rigel_k8s.images.registry import DIGESTS
from rigel_k8s.jobs.job import JobContext
from rigel_k8s.jobs.types.container_registry import ContainerRegistry, ContainerRegistryOptions
from rigel_k8s.settings import Application, Settings
from rigel_k8s.system import oci
from rigel_lab.images import exporter
from rigel_lab.images.base.build import BaseImage
from rigel_lab.images.base.delivery import deliver
from tests.support.digests import resolve_digest
from tests.support.recorder import Recorder
from tests.support.until import until

USER, PASSWORD = "robot", "se:cret"
#: As `htpasswd -nbB robot se:cret` writes it.
HTPASSWD = "robot:$2b$05$abcdefghijklmnopqrstuuWqeDdmk0qhXLYvA33lbC9M700ynI2Oa\n"

pytestmark = [
    pytest.mark.cluster,
    pytest.mark.skipif(shutil.which("podman") is None, reason="podman is not installed"),
]


@attrs.frozen
class Registry:
    """A registry that runs."""

    name: str
    log: Path


@attrs.frozen
class Built:
    """What a build left: the shared data and what was told."""

    data: dict[str, Any]
    told: Recorder


def build(
    directory: Path,
    image: str,
    *,
    providers: dict[str, Any] | None = None,
    **options: Any,
) -> Built:
    """Run a BuildX job with podman on the Dockerfile of a directory."""
    told, data = Recorder(), dict[str, Any]()
    job = JobContext(
        name="build",
        application=Application("noetic", directory),
        report=told,
        settings=Settings(),
        data=data,
        providers=providers or {},
        cancel=threading.Event(),
    )
    options = {"platforms": [], "tool": "podman", **options}
    BuildXJob().run(BuildXOptions(image, **options), job)
    return Built(data, told)


@pytest.fixture(scope="session")
def registry_program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """docker-registry: an installed one, or Debian's, downloaded and unpacked, not installed."""
    if found := shutil.which("docker-registry"):
        return Path(found)
    if shutil.which("apt-get") is None:
        pytest.skip("docker-registry is neither installed nor to be had from Debian")
    place = tmp_path_factory.mktemp("docker-registry")
    place.chmod(0o777)
    download = ["apt-get", "download", "-qq", "docker-registry"]
    subprocess.run(download, cwd=place, check=True, capture_output=True)
    (archive,) = place.glob("*.deb")
    subprocess.run(["dpkg-deb", "-x", str(archive), str(place)], check=True)
    return place / "usr" / "bin" / "docker-registry"


def serve(program: Path, directory: Path, auth: str) -> Iterator[Registry]:
    """Run a registry on a port of loopback that it chooses itself, and tells in its log."""
    config, log = directory / "config.yml", directory / "log"
    storage = f"storage: {{filesystem: {{rootdirectory: {directory}/data}}}}"
    http_part = 'http: {addr: "127.0.0.1:0", secret: x}'
    config.write_text(f"version: 0.1\n{storage}\n{http_part}\n{auth}")
    with log.open("wb") as output:
        process = subprocess.Popen(
            [program, "serve", config], stdout=output, stderr=subprocess.STDOUT
        )
    try:
        listens = until(
            lambda: re.search(r'"listening on (127\.0\.0\.1:\d+)"', log.read_text()),
            "a registry that listens",
            last_words=log.read_text,
        )
        yield Registry(listens[1], log)
    finally:
        process.terminate()
        process.wait()


@pytest.fixture(scope="session")
def public_registry(
    registry_program: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Registry]:
    """A registry that lets everybody push."""
    yield from serve(registry_program, tmp_path_factory.mktemp("public"), "")


@pytest.fixture(scope="session")
def private_registry(
    registry_program: Path, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Registry]:
    """A registry that lets USER alone pull and push."""
    directory = tmp_path_factory.mktemp("private")
    (directory / "htpasswd").write_text(HTPASSWD)
    auth = f"auth: {{htpasswd: {{realm: test, path: {directory}/htpasswd}}}}\n"
    yield from serve(registry_program, directory, auth)


def options(registry: Registry, password: str = PASSWORD) -> ContainerRegistryOptions:
    return ContainerRegistryOptions(registry.name, USER, password)


# Build, push, digest


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A Dockerfile that needs no base image."""
    (tmp_path / "Dockerfile").write_text("FROM scratch\nARG VERSION=0\nCOPY content /content\n")
    (tmp_path / "content").write_text(f"made for {tmp_path}")
    return tmp_path


def podman(*words: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(["podman", *words], capture_output=True, text=True, check=False)


@pytest.fixture
def image(public_registry: Registry, project: Path) -> Iterator[str]:
    """An image name on the open registry; its local copies are removed after the test."""
    name = f"{public_registry.name}/team/{project.name.replace('_', '-').lower()}"
    yield name
    podman("rmi", "--force", *(f"{name}:{tag}" for tag in ("1", "2", "latest")))


def test_a_pushed_image_is_pulled_by_the_digest_that_was_told(image: str, project: Path) -> None:
    """Every tag is on the registry; its digest is what the deploy gets, and podman pulls by it."""
    built = build(project, f"{image}:1", push=True, tags=["2"])
    digests = built.data[DIGESTS]
    assert set(digests) == {f"{image}:1", f"{image}:2", f"{image}:latest", image}
    for name, digest in digests.items():
        assert resolve_digest(name) == digest
    by_digest = f"{image}@{digests[f'{image}:1']}"
    pulled = podman("pull", "--tls-verify=false", by_digest)
    assert pulled.returncode == 0, pulled.stderr
    podman("rmi", "--force", by_digest)
    assert f"pushed {image}:1 ({digests[f'{image}:1']})" in built.told.lines
    assert any("3/3 COPY content /content" in text for text in built.told.texts)


def test_an_unchanged_build_keeps_its_digest(image: str, project: Path) -> None:
    """Building again without a change rolls nothing out."""
    digests = [build(project, f"{image}:1", push=True).data[DIGESTS][image] for _ in range(2)]
    assert digests[0] == digests[1]


def test_a_build_argument_is_never_that_of_another_build(image: str, project: Path) -> None:
    """podman caches `ENV V=${V}` whatever V is; here each value has layers of its own."""
    dockerfile = "FROM scratch\nARG VERSION=0\nCOPY content /content\nENV VERSION=${VERSION}\n"
    (project / "Dockerfile").write_text(dockerfile)

    def built(version: str) -> tuple[str, str]:
        digests = build(project, f"{image}:1", push=True, buildargs={"VERSION": version}).data
        words = ["image", "inspect", "--format", "{{.Config.Env}}", f"{image}:1"]
        return podman(*words).stdout, digests[DIGESTS][image]

    one, two, again = built("1"), built("2"), built("1")
    assert ("VERSION=1" in one[0], "VERSION=2" in two[0]) == (True, True)
    assert again == one


def test_credentials_of_the_provider_push(private_registry: Registry, project: Path) -> None:
    """Without the provider the registry refuses; with it the push works, and nothing stays."""
    name = f"{private_registry.name}/team/secret"
    with pytest.raises(CommandFailed, match=f"push of {name}:1 failed") as refused:
        build(project, f"{name}:1", push=True)
    assert "registry provider" in str(refused.value.hint)
    before = {file: file.read_text() for file in auth_files()}
    provider = ContainerRegistry()
    credentials = provider.connect(options(private_registry), "hub", Recorder())
    built = build(project, f"{name}:1", push=True, providers={"hub": credentials})
    provider.disconnect(credentials)
    digest = built.data[DIGESTS][f"{name}:1"]
    assert resolve_digest(f"{name}:1", credentials) == digest
    assert resolve_digest(f"{name}:1") is None
    assert {file: file.read_text() for file in auth_files()} == before
    assert PASSWORD not in "".join(built.told.texts)
    podman("rmi", "--force", f"{name}:1", f"{name}:latest")


def auth_files() -> list[Path]:
    """Where podman keeps what `podman login` wrote."""
    places = [Path("/run/containers/0/auth.json"), Path.home() / ".config/containers/auth.json"]
    return [file for file in (*places, Path.home() / ".docker/config.json") if file.is_file()]


def test_several_platforms_are_one_image(image: str, project: Path) -> None:
    """The pushed image is a list of both platforms; the loaded one is this machine's."""
    (project / "Dockerfile").write_text(
        "FROM scratch\nARG TARGETARCH\nENV ARCH=$TARGETARCH\nCOPY content /content\n"
    )
    built = build(
        project, f"{image}:1", push=True, load=True, platforms=["linux/amd64", "linux/arm64"]
    )
    listed = manifest(image, "1")["manifests"]
    assert {one["platform"]["architecture"] for one in listed} == {"amd64", "arm64"}
    assert resolve_digest(f"{image}:1") == built.data[DIGESTS][f"{image}:1"]
    assert podman("image", "exists", f"{image}:1").returncode == 0
    until(  # tests beside this one build, too
        lambda: "rigel-k8s-build" not in podman("images", "--all").stdout,
        "moment in which no build has an image of its own",
        180,
    )


def manifest(image: str, tag: str) -> dict[str, Any]:
    """The list of platforms that a registry has."""
    registry, _, repository = image.partition("/")
    connection = http.client.HTTPConnection(registry, timeout=60)
    kinds = ("oci.image.index.v1", "docker.distribution.manifest.list.v2")
    accept = {"Accept": ", ".join(f"application/vnd.{kind}+json" for kind in kinds)}
    connection.request("GET", f"/v2/{repository}/manifests/{tag}", headers=accept)
    found: dict[str, Any] = json.loads(connection.getresponse().read())
    connection.close()
    return found


def test_a_base_image_that_is_pushed_anew_is_what_is_built_on(
    registry: str, project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Podman keeps what it once pulled under a name; a new base image of that name counts."""
    name = f"{registry}/test/{uuid.uuid4().hex}:1"
    layer = tmp_path / "layer.tar"
    (project / "Dockerfile").write_text(f"FROM {name}\nCOPY content /content\n")
    for path in ("first", "second"):
        layer.write_bytes(oci.layer([oci.Entry(path)], mtime=0))
        archive = tmp_path / f"{path}.tar"
        oci.write_archive(archive, [layer], {}, "localhost/x:1", created=0)
        made = BaseImage("localhost/x:1", archive, built=True)
        monkeypatch.setattr(exporter, "build", lambda _, made=made, **__: made)
        assert deliver(exporter.build(Recorder()), name, Recorder()) == name
        build(project, f"localhost/{path}:1")
    podman("create", "--name", "second", "localhost/second:1", "none")
    try:
        files = subprocess.run(["podman", "export", "second"], stdout=subprocess.PIPE, check=True)
    finally:
        podman("rm", "second")
        podman("rmi", "localhost/first:1", "localhost/second:1", name)
    with tarfile.open(fileobj=io.BytesIO(files.stdout)) as tar:
        assert {"second", "content"} <= set(tar.getnames())
        assert "first" not in tar.getnames()


# ROS workspaces

PACKAGE = """<package format="2">
  <name>{name}</name>
  <version>0.1.0</version>
  <description>Says its name.</description>
  <maintainer email="robot@example.org">robot</maintainer>
  <license>Apache-2.0</license>
  <buildtool_depend>catkin</buildtool_depend>
</package>
"""
CMAKE = """cmake_minimum_required(VERSION 3.10)
project({name})
find_package(catkin REQUIRED)
catkin_package()
add_executable({name} main.cpp)
target_compile_definitions({name} PRIVATE GREETING="${{GREETING}}")
install(TARGETS {name} RUNTIME DESTINATION ${{CATKIN_PACKAGE_BIN_DESTINATION}})
"""
MAIN = """#include <cstdio>
int main() { std::puts("NAME says " GREETING); }
"""


def write_package(place: Path, name: str) -> None:
    place.mkdir(parents=True)
    (place / "package.xml").write_text(PACKAGE.format(name=name))
    (place / "CMakeLists.txt").write_text(CMAKE.format(name=name))
    (place / "main.cpp").write_text(MAIN.replace("NAME", name))


def git(place: Path, *words: str) -> None:
    who = ["-c", "user.name=robot", "-c", "user.email=robot@example.org"]
    subprocess.run(["git", *who, *words], cwd=place, check=True, capture_output=True)


@pytest.fixture
def repository(tmp_path: Path) -> Iterator[str]:
    """The URL of a git repository with a package `extra`, on loopback."""
    served = tmp_path / "served"
    write_package(served / "extra", "extra")
    for words in (["init", "-b", "main"], ["add", "."], ["commit", "-m", "x"]):
        git(served / "extra", *words)
    git(served / "extra", "update-server-info")
    handler = partial(SimpleHTTPRequestHandler, directory=str(served))
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}/extra/.git"
        server.shutdown()
        thread.join()


@pytest.mark.parametrize(
    "compiler", ["catkin_make", pytest.param("colcon", marks=pytest.mark.slow)]
)
def test_a_workspace_is_compiled_and_its_nodes_start(
    compiler: Literal["catkin_make", "colcon"], base_image: str, repository: str, tmp_path: Path
) -> None:
    """From a Dockerfile job and a BuildX job to a program that rosrun finds, its own and cloned."""
    workspace = tmp_path / "workspace"
    write_package(workspace / "src" / "hello", "hello")
    (workspace / "deps.rosinstall").write_text(
        f"- git: {{local-name: extra, uri: '{repository}', version: main}}\n"
    )
    options = DockerfileOptions(
        Compiler(compiler, {"GREETING": "good day"}),
        ros_image=base_image,
        rosdep=False,
        rosinstall=["deps.rosinstall"],
        env=[DockerfileVariable("ROBOT", "r2")],
        entrypoint=["echo entrypoint of $ROBOT"],
        docker_run=["echo one\necho two > /two"],
    )
    DockerfileJob().run(options, JobContext("docker", Application("noetic", workspace), Recorder()))
    image = f"localhost/workspace-{compiler}:1"
    build(workspace, image, tags=[], force_tag_latest=False)
    for name in ("hello", "extra"):
        said = in_image(image, "rosrun", name, name)
        assert said == ["entrypoint of r2", f"{name} says good day"]
    podman("rmi", "--force", image)


def in_image(image: str, *words: str) -> list[str]:
    """Run words under the image's entrypoint and return what they print."""
    entrypoint = ["/bin/bash", "/home/rigeluser/robot-entrypoint.sh"]
    container = subprocess.run(
        ["buildah", "from", image], check=True, capture_output=True, text=True
    ).stdout.strip()
    try:
        done = subprocess.run(
            ["buildah", "run", "--isolation", "chroot", container, "--", *entrypoint, *words],
            check=True,
            capture_output=True,
            text=True,
        )
    finally:
        subprocess.run(["buildah", "rm", container], check=True, capture_output=True)
    return done.stdout.splitlines()
