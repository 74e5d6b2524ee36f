"""What podman is given; its real runs are in tests/cluster/test_images.py."""

from __future__ import annotations

import base64
import json
import os
from pathlib import Path
from typing import Any

import attrs
import pytest

from rigel_build.engine import Build, Session
from rigel_build.podman import Podman, misses_sys_resource, registries_conf
from rigel_k8s.errors import CommandFailed
from rigel_k8s.images.credentials import RegistryCredentials
from rigel_k8s.system.oci import host_platform

pytestmark = pytest.mark.programs

FULL = "Uid:\t0\t0\t0\t0\nCapEff:\t000001ffffffffff\n"
LACKING = "Uid:\t0\t0\t0\t0\nCapEff:\t000001fffeffffff\n"
ROOTLESS = "Uid:\t1000\t1000\t1000\t1000\nCapEff:\t0000000000000000\n"


@pytest.mark.parametrize(("status", "lacks"), [(FULL, False), (LACKING, True), (ROOTLESS, False)])
def test_only_a_root_without_the_capability_needs_another_isolation(
    status: str, *, lacks: bool
) -> None:
    """A full root and podman without root keep podman's own isolation."""
    assert misses_sys_resource(status) is lacks


def test_platforms_are_those_with_an_emulator(tmp_path: Path) -> None:
    """This machine's platform comes first; others need an emulator that the kernel knows."""
    assert Podman("podman", binfmt=tmp_path).platforms() == (host_platform(),)
    (tmp_path / "qemu-aarch64").touch()
    (tmp_path / "qemu-x86_64").touch()
    assert set(Podman("podman", binfmt=tmp_path).platforms()) == {"linux/amd64", "linux/arm64"}
    assert Podman("podman", binfmt=tmp_path).platforms()[0] == host_platform()


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("", 'unqualified-search-registries = ["docker.io"]\n'),
        ("[registries.search]\n", 'unqualified-search-registries = ["docker.io"]\n'),
        ("# a\nunqualified-search-registries = []\n", "# a\nunqualified-search-registries = []\n"),
    ],
)
def test_short_names_mean_docker_hub_unless_the_user_said_otherwise(
    before: str, after: str
) -> None:
    """`FROM ros:noetic` works on a fresh podman; a choice of the user's stays."""
    assert registries_conf(before, []) == after


def test_insecure_registries_are_named_one_by_one() -> None:
    """Plain HTTP is for the named registries alone."""
    conf = registries_conf("", ["b:1", "a:1"])
    assert conf.count("insecure = true") == 2
    assert conf.index('location = "a:1"') < conf.index('location = "b:1"')


def test_the_registries_of_a_build_are_found(tmp_path: Path) -> None:
    """Those of its names, of FROM lines and of build arguments that are images."""
    file = tmp_path / "Dockerfile"
    file.write_text("ARG B\nFROM $B AS x\nfrom --platform=linux/arm64 c:3/base\nFROM x\n")
    build = Build(("a:1/app:1",), tmp_path, file, {"B": "b:2/ros", "VERSION": "1.2 beta"})
    assert build.registries() == {"a:1", "b:2", "c:3", "docker.io"}


#: Writes down its arguments, what it finds in its files, and a digest where it is told to.
FAKE = """#!/bin/sh
echo "$*" >> "$RECORD/calls"
cp "$CONTAINERS_REGISTRIES_CONF" "$RECORD/registries.conf" 2>/dev/null
if [ -n "$REGISTRY_AUTH_FILE" ]; then
  cp "$REGISTRY_AUTH_FILE" "$RECORD/auth.json"
  stat -c %a "$REGISTRY_AUTH_FILE" > "$RECORD/mode"
fi
case "$1" in build) cp "$3.dockerignore" "$RECORD/ignored" 2>/dev/null; exit "${FAILS:-0}" ;; esac
while [ $# -gt 0 ]; do
  [ "$1" = --digestfile ] && echo sha256:1 > "$2"
  shift
done
exit 0
"""
PLATFORMS = ("linux/amd64", "linux/arm64")


@attrs.frozen
class Fake:
    """A podman that writes down what it is given."""

    podman: Podman
    record: Path
    session: Session

    @property
    def calls(self) -> list[list[str]]:
        return [line.split() for line in (self.record / "calls").read_text().splitlines()]


@pytest.fixture
def fake(tmp_path: Path) -> Fake:
    record, session = tmp_path / "record", tmp_path / "session"
    record.mkdir()
    session.mkdir()
    program = tmp_path / "podman"
    program.write_text(FAKE)
    program.chmod(0o755)
    environ = {"PATH": os.environ["PATH"], "HOME": str(tmp_path), "RECORD": str(record)}
    return Fake(Podman(str(program)), record, Session(session, environ))


def build_of(fake: Fake, text: str = "FROM a\n", **changes: Any) -> Build:
    file = Path(fake.session.environ["HOME"]) / "Dockerfile"
    file.write_text(text)
    return attrs.evolve(Build(("h:5/app:1",), file.parent, file), **changes)


def test_a_push_of_every_name_tells_its_digest(fake: Fake) -> None:
    """Short names are written in full: podman's own short names are others than docker's."""
    build = build_of(fake, names=("h:5/app:1", "me/app:2"), buildargs={"A": "b"})
    digests = fake.podman.build(build, fake.session, load=False, push=True)
    assert digests == {"h:5/app:1": "sha256:1", "me/app:2": "sha256:1"}
    words, *pushes = fake.calls
    named = ["--tag", "h:5/app:1", "--tag", "docker.io/me/app:2", "--build-arg", "A"]
    assert words == ["build", "--file", str(build.dockerfile), *named, str(build.context)]
    assert [(call[0], *call[3:]) for call in pushes] == [
        ("push", name, f"docker://{name}") for name in ("h:5/app:1", "docker.io/me/app:2")
    ]


def test_credentials_are_in_a_private_file_of_the_session_only(fake: Fake) -> None:
    """No argument holds them, and nobody else can read the file."""
    session = attrs.evolve(fake.session, credentials=(RegistryCredentials("h:5", "me", "se:cret"),))
    fake.podman.build(build_of(fake), session, load=False, push=True)
    auth = base64.b64encode(b"me:se:cret").decode()
    assert json.loads((fake.record / "auth.json").read_text()) == {"auths": {"h:5": {"auth": auth}}}
    assert (fake.record / "mode").read_text().strip() == "600"
    assert not {"se:cret", auth} & {word for call in fake.calls for word in call}
    assert list(fake.session.directory.glob("auth.json"))


def test_registries_on_loopback_and_those_told_may_speak_plain_http(fake: Fake) -> None:
    """All others of the build keep to TLS."""
    build = build_of(fake, "FROM other:5/base\n", names=("127.0.0.1:5/app:1",))
    session = attrs.evolve(fake.session, insecure=frozenset({"10.0.0.1:5"}))
    fake.podman.build(build, session, load=False, push=False)
    conf = (fake.record / "registries.conf").read_text()
    assert [line for line in conf.splitlines() if line.startswith("location")] == [
        'location = "10.0.0.1:5"',
        'location = "127.0.0.1:5"',
    ]


@pytest.mark.parametrize(("base", "cached"), [("a", True), ("scratch", False)])
def test_platforms_of_scratch_do_not_share_a_cache(base: str, fake: Fake, *, cached: bool) -> None:
    """podman 4 takes one platform's layers for another's where there is no base image."""
    build = build_of(fake, f"FROM {base}\n", platforms=PLATFORMS)
    fake.podman.build(build, fake.session, load=False, push=True)
    words, push, forget = fake.calls
    assert ("--no-cache" in words) is not cached
    assert words[words.index("--platform") + 1] == "linux/amd64,linux/arm64"
    assert push[:3] == ["manifest", "push", "--all"]
    manifest = words[words.index("--manifest") + 1]
    assert manifest in push
    assert forget == ["manifest", "rm", manifest]


def test_a_failed_build_leaves_no_working_name(
    fake: Fake, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The name under which platforms are collected is dropped whatever happens."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    session = attrs.evolve(fake.session, environ={**fake.session.environ, "FAILS": "125"})
    with pytest.raises(CommandFailed, match=r"podman build of h:5/app:1 failed"):
        fake.podman.build(build_of(fake, platforms=PLATFORMS), session, load=False, push=True)
    words, forget = fake.calls
    assert forget == ["manifest", "rm", words[words.index("--manifest") + 1]]


def test_a_dockerignore_of_the_dockerfile_counts_where_arguments_are_marked(fake: Fake) -> None:
    """What is built then is a copy of the Dockerfile, which needs a copy of that too."""
    build = build_of(fake, "FROM a\nARG A\n", buildargs={"A": "b"})
    ignored = build.dockerfile.with_name("Dockerfile.dockerignore")
    ignored.write_text("secret\n")
    fake.podman.build(build, fake.session, load=False, push=False)
    assert fake.calls[0][2] != str(build.dockerfile)
    assert (fake.record / "ignored").read_text() == "secret\n"


def test_save_writes_all_names_into_one_archive(fake: Fake) -> None:
    """In the format that containerd imports, each name in full."""
    fake.podman.save(["a:1", "h:5/a:2"], Path("/x/image.tar"), fake.session)
    options = ["--format", "docker-archive", "--multi-image-archive", "--output", "/x/image.tar"]
    assert fake.calls == [["save", *options, "docker.io/library/a:1", "h:5/a:2"]]
