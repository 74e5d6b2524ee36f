"""What docker is given and what is read from it, with a program in its place that writes it down.

No Docker engine runs where these tests are at home, so this stops at the boundary of the process.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import attrs
import pytest

from rigel_build.docker import Docker, add_credentials, builder_platforms
from rigel_build.engine import Build, Session
from rigel_k8s.errors import CommandFailed, RigelK8sError
from rigel_k8s.images.credentials import RegistryCredentials

pytestmark = pytest.mark.programs

INSPECTED = """Name:   default
Driver: docker

Nodes:
Name:      default
Endpoint:  default
Status:    running
Platforms: linux/amd64, linux/amd64/v2, linux/arm64*
"""
SECRET = RegistryCredentials("host:5000", "me", "se:cret")

FAKE = """#!/bin/sh
printf '%s\\n' "$@" > "$RECORD/argv.$$"
env > "$RECORD/env.$$"
if [ -n "$DOCKER_CONFIG" ]; then
  cat "$DOCKER_CONFIG/config.json" > "$RECORD/config.json"
  stat -c %a "$DOCKER_CONFIG/config.json" > "$RECORD/mode"
  ls "$DOCKER_CONFIG/cli-plugins" "$DOCKER_CONFIG/contexts" > "$RECORD/plugins" 2>/dev/null
fi
while [ $# -gt 0 ]; do
  [ "$1" = --metadata-file ] && printf '%s' "$METADATA" > "$2"
  shift
done
echo '#5 [1/2] FROM scratch'
if [ -n "$FAILURE" ]; then
  printf '%s\\n' '#6 [2/2] RUN make' '#6 0.1 cause' '#5 DONE 0.1s' '#6 ERROR: exit code: 2'
  printf '%s\\n' '------' ' > [2/2] RUN make:' '0.1 cause' '------' 'ERROR: failed to solve'
  exit 1
fi
"""


@attrs.frozen
class Fake:
    """A docker that writes down what it is given."""

    docker: Docker
    record: Path
    session: Session

    def calls(self) -> list[list[str]]:
        files = sorted(self.record.glob("argv.*"), key=lambda file: file.stat().st_mtime_ns)
        return [file.read_text().splitlines() for file in files]

    def environment(self) -> str:
        return "".join(file.read_text() for file in self.record.glob("env.*"))


@pytest.fixture
def fake(tmp_path: Path) -> Fake:
    record, session = tmp_path / "record", tmp_path / "session"
    record.mkdir()
    session.mkdir()
    program = tmp_path / "docker"
    program.write_text(FAKE)
    program.chmod(0o755)
    environ = {
        "PATH": os.environ["PATH"],
        "HOME": str(tmp_path),
        "RECORD": str(record),
        "METADATA": json.dumps({"containerimage.digest": "sha256:1"}),
    }
    return Fake(Docker(str(program), INSPECTED), record, Session(session, environ))


def build_of(fake: Fake, **changes: Any) -> Build:
    file = Path(fake.session.environ["HOME"]) / "Dockerfile"
    build = Build(("host:5000/app:1", "host:5000/app:latest"), file.parent, file)
    return attrs.evolve(build, **changes)


def test_a_push_is_one_build_and_its_digest_is_for_every_name(fake: Fake) -> None:
    """buildx gets file, names, arguments and context, and tells the digest by a file."""
    build = build_of(fake, buildargs={"A": "b c"}, platforms=("linux/amd64", "linux/arm64"))
    told: list[str] = []
    session = attrs.evolve(fake.session, on_state=told.append)
    digests = fake.docker.build(build, session, load=False, push=True)
    assert digests == {"host:5000/app:1": "sha256:1", "host:5000/app:latest": "sha256:1"}
    (words,) = fake.calls()
    metadata = str(fake.session.directory / "metadata.json")
    assert words == [
        *("buildx", "build", "--progress", "plain", "--push", "--metadata-file", metadata),
        *("--file", str(build.dockerfile), "--tag", build.names[0], "--tag", build.names[1]),
        *("--platform", "linux/amd64,linux/arm64", "--build-arg", "A", str(build.context)),
    ]
    assert told == ["1/2 FROM scratch"]
    assert "BUILDX_NO_DEFAULT_ATTESTATIONS=1" in fake.environment()


def test_load_and_push_are_two_builds_the_loaded_one_for_this_machine(fake: Fake) -> None:
    """buildx cannot do both in one, and docker's own store holds one platform."""
    build = build_of(fake, platforms=("linux/amd64", "linux/arm64"))
    fake.docker.build(build, fake.session, load=True, push=True)
    push, load = fake.calls()
    assert "--push" in push
    assert "--load" in load
    assert "--platform" not in load


def test_an_image_that_goes_nowhere_is_kept_in_docker(fake: Fake) -> None:
    """Without push the image is loaded, for else it would be in the build cache only."""
    assert fake.docker.build(build_of(fake), fake.session, load=False, push=False) == {}
    (words,) = fake.calls()
    assert "--load" in words


def test_without_credentials_docker_uses_the_users_configuration(fake: Fake) -> None:
    """No configuration of ours stands before the user's."""
    fake.docker.build(build_of(fake), fake.session, load=False, push=True)
    assert "DOCKER_CONFIG" not in fake.environment()


def test_credentials_are_in_a_file_of_the_session_only(fake: Fake) -> None:
    """docker finds them in a private configuration; no argument and no variable holds them."""
    home = Path(fake.session.environ["HOME"])
    (home / ".docker" / "cli-plugins").mkdir(parents=True)
    (home / ".docker" / "cli-plugins" / "docker-buildx").touch()
    (home / ".docker" / "contexts").mkdir()
    (home / ".docker" / "contexts" / "remote").touch()
    (home / ".docker" / "config.json").write_text('{"auths": {"ghcr.io": {"auth": "x"}}}')
    session = attrs.evolve(fake.session, credentials=(SECRET,))
    fake.docker.build(build_of(fake), session, load=False, push=True)
    config = json.loads((fake.record / "config.json").read_text())
    assert set(config["auths"]) == {"ghcr.io", "host:5000"}
    assert (fake.record / "mode").read_text().strip() == "600"
    assert {"docker-buildx", "remote"} <= {*(fake.record / "plugins").read_text().split()}
    words = " ".join(fake.calls()[0])
    secret = config["auths"]["host:5000"]["auth"]
    assert "se:cret" not in words + fake.environment()
    assert secret not in words + fake.environment()
    assert f"BUILDX_CONFIG={home}/.docker/buildx" in fake.environment()
    assert "se:cret" not in (home / ".docker" / "config.json").read_text()


def test_a_credential_store_does_not_hide_them(fake: Fake) -> None:
    """Where a helper keeps all credentials, docker is told to look into the file for ours."""
    session = attrs.evolve(
        fake.session, credentials=(SECRET, RegistryCredentials("docker.io", "a", "b"))
    )
    config = add_credentials({"credsStore": "desktop"}, session)
    assert config["credsStore"] == "desktop"
    assert config["credHelpers"] == {"host:5000": "", "docker.io": "", "index.docker.io": ""}


def test_a_push_without_a_digest_is_an_error(fake: Fake) -> None:
    """An image whose digest is unknown is not deployed under an old one."""
    session = attrs.evolve(fake.session, environ={**fake.session.environ, "METADATA": "{}"})
    with pytest.raises(RigelK8sError, match="did not report its digest"):
        fake.docker.build(build_of(fake), session, load=False, push=True)


def test_a_failed_build_shows_its_step_and_keeps_the_log(
    fake: Fake, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """buildx prints steps side by side; the error has the one that failed."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    session = attrs.evolve(fake.session, environ={**fake.session.environ, "FAILURE": "1"})
    what = "^docker build of host:5000/app:1 failed .exit code 1.$"
    with pytest.raises(CommandFailed, match=what) as caught:
        fake.docker.build(build_of(fake), session, load=True, push=False)
    *step, where = caught.value.details
    assert step == ["[2/2] RUN make", "cause", "ERROR: exit code: 2", "ERROR: failed to solve"]
    log = Path(where.removeprefix("the complete log: "))
    assert log.read_text().startswith("#5 [1/2] FROM scratch\n#6 [2/2] RUN make\n")


def test_save_writes_all_names_into_one_archive(fake: Fake) -> None:
    """One archive holds the image under all its names."""
    fake.docker.save(["a:1", "a:2"], Path("/x/image.tar"), fake.session)
    assert fake.calls() == [["save", "--output", "/x/image.tar", "a:1", "a:2"]]


def test_platforms_are_the_builders() -> None:
    """The engine's own builder makes one platform at a time; a container builder all it lists."""
    assert builder_platforms(INSPECTED) == ["linux/amd64", "linux/amd64/v2", "linux/arm64"]
    assert Docker("docker", INSPECTED).platforms() == ("linux/amd64",)
    container = INSPECTED.replace("Driver: docker\n", "Driver: docker-container\n")
    assert "linux/arm64" in Docker("docker", container).platforms()
