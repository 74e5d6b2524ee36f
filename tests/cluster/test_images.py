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
from contextlib import suppress
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any, Literal

import attrs
import pytest

from rigel_k8s.errors import CommandFailed, Interrupted
from rigel_k8s.images.credentials import RegistryCredentials
from rigel_k8s.images.registry import DIGESTS
from rigel_k8s.jobs.job import JobContext
from rigel_k8s.jobs.types.buildx import BuildXJob, BuildXOptions
from rigel_k8s.jobs.types.container_registry import ContainerRegistry, ContainerRegistryOptions
from rigel_k8s.jobs.types.dockerfile import (
    Compiler,
    DockerfileJob,
    DockerfileOptions,
    DockerfileVariable,
)
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.settings import Application, Settings
from rigel_k8s.system import oci
from rigel_lab import cluster as lab
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
    cancel: threading.Event | None = None,
    context: str | None = None,
    **options: Any,
) -> Built:
    """Run a BuildX job with podman on the Dockerfile of a directory."""
    told, data = Recorder(), dict[str, Any]()
    job = JobContext(
        name="build",
        application=Application("noetic", directory),
        report=told,
        settings=Settings(context=context),
        data=data,
        providers=providers or {},
        cancel=cancel or threading.Event(),
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


# The registry provider


def options(registry: Registry, password: str = PASSWORD) -> ContainerRegistryOptions:
    return ContainerRegistryOptions(registry.name, USER, password)


def test_the_provider_logs_in(private_registry: Registry) -> None:
    """Good credentials connect, are handed to the jobs, and are told without the password."""
    told = Recorder()
    connection = ContainerRegistry().connect(options(private_registry), "hub", told)
    assert connection == RegistryCredentials(private_registry.name, USER, PASSWORD)
    assert told.lines == [f"logged in to {private_registry.name} as {USER}"]
    assert PASSWORD not in repr(connection)
    ContainerRegistry().disconnect(connection)


def test_the_provider_takes_a_registry_without_users(public_registry: Registry) -> None:
    """A registry that asks for no credentials is reported as such."""
    told = Recorder()
    ContainerRegistry().connect(options(public_registry), "hub", told)
    assert told.lines == [f"{public_registry.name} needs no credentials"]


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


def test_the_same_tag_built_again_has_another_digest(image: str, project: Path) -> None:
    """A change of the sources changes the digest, so that the same tag rolls out anew."""
    before = build(project, f"{image}:1", push=True).data[DIGESTS][f"{image}:1"]
    (project / "content").write_text("changed")
    after = build(project, f"{image}:1", push=True).data[DIGESTS][f"{image}:1"]
    assert before != after
    assert resolve_digest(f"{image}:1") == after


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


def test_a_base_image_comes_from_a_registry_without_tls(image: str, project: Path) -> None:
    """FROM and a build argument may name an image on a registry of this machine."""
    build(project, f"{image}:1", push=True)
    podman("rmi", "--force", f"{image}:1", f"{image}:latest")
    (project / "Dockerfile").write_text("ARG BASE\nFROM $BASE\nCOPY content /more\n")
    built = build(project, f"{image}:2", push=True, buildargs={"BASE": f"{image}:1"})
    assert f"{image}:2" in built.data[DIGESTS]


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


def test_a_failing_command_is_shown_with_all_that_it_printed(
    base_image: str, project: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The cause may stand far above podman's last lines; other steps are in the log alone.

    On a busy machine podman may lose what a step prints just before it ends: these steps wait.
    """
    monkeypatch.setenv("XDG_CACHE_HOME", str(project / "cache"))
    script = "echo the cause; seq 100; sleep 1; exit 3"
    own = f"echo {uuid.uuid4()} $((1 + 1)) steps; sleep 1"  # in no layer cache
    (project / "Dockerfile").write_text(
        f"FROM {base_image}\nRUN {own}\nRUN {script}\nRUN echo after\n"
    )
    with pytest.raises(CommandFailed, match=r"exit code 3") as caught:
        build(project, "localhost/failing:1")
    details = caught.value.details
    assert details[:3] == (f"STEP 3/4: RUN {script}", "the cause", "1")
    assert f'building at STEP "RUN {script}"' in details[-2]
    log = Path(details[-1].removeprefix("the complete log: ")).read_text()
    assert "2 steps" in log
    assert "2 steps" not in details


def test_a_registry_that_is_not_there_is_told(project: Path) -> None:
    """A push into the void is an error with podman's words."""
    with pytest.raises(CommandFailed, match=r"push of 127\.0\.0\.1:1/app:1 failed") as caught:
        build(project, "127.0.0.1:1/app:1", push=True)
    assert any("refused" in line for line in caught.value.details)
    podman("rmi", "--force", "127.0.0.1:1/app:1", "127.0.0.1:1/app:latest")


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


def test_an_interrupted_build_leaves_no_process(base_image: str, project: Path) -> None:
    """Ctrl-C in a RUN step ends podman and what it runs, and is no failure of the build."""
    mark = f"60{uuid.uuid4().int % 10**9}"
    (project / "Dockerfile").write_text(f"FROM {base_image}\nRUN sleep {mark}\n")
    cancel = threading.Event()

    def cancel_when_it_runs() -> None:
        until(lambda: running(mark), "build", 120)
        cancel.set()

    threading.Thread(target=cancel_when_it_runs, daemon=True).start()
    with pytest.raises(Interrupted):
        build(project, "localhost/interrupted:1", cancel=cancel)
    until(lambda: not running(mark), "end of the build", 120)


def running(mark: str) -> list[str]:
    """The processes that sleep for so many seconds, podman's own among them."""
    found = []
    for file in Path("/proc").glob("[0-9]*/cmdline"):
        with suppress(OSError):
            words = file.read_bytes().split(b"\0")
            if b"sleep" in words[0] and mark.encode() in words[1:]:
                found.append(file.parent.name)
    return found


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


# The local cluster


@pytest.fixture
def local(context: str) -> str:
    """The name of the local cluster behind the context."""
    name = context.removeprefix("rigel-")
    if name not in lab.names():
        pytest.skip(f"{context} is no local cluster of this machine")
    return name


def test_the_clusters_registry_needs_no_word(local: str, project: Path) -> None:
    """A push to the local cluster's registry is let through without `insecure`."""
    image = f"{lab.status(local).registry}/test/{project.name.replace('_', '-').lower()}"
    built = build(project, f"{image}:1", push=True)
    assert resolve_digest(f"{image}:1") == built.data[DIGESTS][f"{image}:1"]
    podman("rmi", "--force", f"{image}:1", f"{image}:latest")


def test_a_loaded_image_is_on_every_node(
    local: str, context: str, namespace: str, cluster: Any, base_image: str, project: Path
) -> None:
    """cluster_load: a pod that must not pull runs the image on each node."""
    image = f"loaded.test/{project.name.replace('_', '-').lower()}"
    (project / "Dockerfile").write_text(f"FROM {base_image}\nCOPY content /content\n")
    build(project, f"{image}:1", cluster_load=True, context=context)
    nodes = [node.name for node in lab.status(local).nodes]
    for node in nodes:
        cluster.create(pod(namespace, f"{image}:1", node))
    for node in nodes:
        ref = ObjectRef("v1", "Pod", namespace, f"on-{node}")
        until(partial(succeeded, cluster, ref), f"success of {ref}", 240)
    podman("rmi", "--force", f"{image}:1", f"{image}:latest")


def succeeded(cluster: Any, ref: ObjectRef) -> bool:
    return bool(cluster.get(ref)["status"].get("phase") == "Succeeded")


def pod(namespace: str, image: str, node: str) -> dict[str, Any]:
    return {
        "apiVersion": "v1",
        "kind": "Pod",
        "metadata": {"name": f"on-{node}", "namespace": namespace},
        "spec": {
            "nodeName": node,
            "restartPolicy": "Never",
            "containers": [
                {
                    "name": "it",
                    "image": image,
                    "imagePullPolicy": "Never",
                    "command": ["cat", "/content"],
                }
            ],
        },
    }
