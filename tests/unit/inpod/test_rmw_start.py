"""How rmw.sh starts a program: with the layer where it loads, and with the keeper beside it."""

from __future__ import annotations

import platform
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import attrs
import pytest

import rigel_inpod
from rigel_rmw import libraries
from tests.support.layer import compile_c
from tests.support.rosgraph import until

pytestmark = pytest.mark.programs

ROOM = Path(rigel_inpod.__file__).parent
LIBRARY = f"rmw-{platform.machine()}.so"
#: Stands for Python: notes how it was called, and ends as the file says.
PYTHON = """#!/bin/sh
while [ "${1#-}" != "$1" ]; do shift; done
beside=${RIGEL_RMW_BESIDE:+ beside} script="${1##*/} ${2##*/}"
echo "$script $3 $RIGEL_K8S_EXEC ${RIGEL_RMW_MODE:-} [${LD_PRELOAD:-}]$beside" >>"$LOG/calls"
[ ! -e "$LOG/fails" ] || { rm "$LOG/fails" && exit 1; }
"""


@attrs.define
class Container:
    """The scripts as they are mounted, and the directory of the notes."""

    home: Path

    @property
    def notes(self) -> Path:
        return self.home / "run/ros-node"

    def start(
        self, *words: str, path: str = "", before: Sequence[str] = ("/bin/sh",), **variables: str
    ) -> str:
        """Return what a program prints that rmw.sh starts.

        Args:
            before: what runs the script.
        """
        (self.home / "run").mkdir(exist_ok=True)
        env = {"PATH": path or f"{self.home}/bin:/usr/bin:/bin", "LOG": str(self.home)}
        line = [*before, str(self.home / "rmw.sh"), *words]
        done = subprocess.run(
            line,
            env={**env, "RIGEL_RMW": str(self.notes), **variables},
            capture_output=True,
            text=True,
            timeout=60,
        )
        assert done.returncode == 0, done.stderr
        assert done.stderr == ""
        return done.stdout

    def calls(self, count: int) -> list[str]:
        """Return how Python was called, once it was as often."""
        found = self.home / "calls"
        until(
            lambda: found.exists() and len(found.read_text().splitlines()) >= count,
            f"{count} calls of the keeper",
        )
        return found.read_text().splitlines()


@pytest.fixture
def container(tmp_path: Path) -> Container:
    shutil.copy(ROOM / "rmw.sh", tmp_path)
    (tmp_path / LIBRARY).write_bytes(libraries()[LIBRARY])
    (tmp_path / "bin").mkdir()
    (tmp_path / "bin/python3").write_text(PYTHON)
    (tmp_path / "bin/python3").chmod(0o755)
    return Container(tmp_path)


PRINT = ("/bin/sh", "-c", 'echo "$LD_PRELOAD ${RIGEL_RMW_MODE:-} ${RIGEL_K8S_EXEC:-}"')


def test_the_keeper_knows_of_a_script_beside_the_program(container: Container) -> None:
    """It takes over when that has made the node's transitions, or has loaded its components."""
    shutil.copy(ROOM / "beside.sh", container.home)
    line = ["/bin/sh", str(container.home / "beside.sh"), "none.py", "--", *PRINT]
    assert "beside" not in container.start(*line)
    assert any("keeper.py run" in call and "beside" in call for call in container.calls(2))


def test_a_program_has_the_layer_and_its_keeper_has_not(container: Container) -> None:
    """Its children inherit it; nothing says that it is a helper of ours."""
    assert container.start(*PRINT) == f"{container.home}/{LIBRARY}  \n"
    assert container.calls(1) == ["lean.py keeper.py run 1  []"]
    assert oct(container.notes.stat().st_mode & 0o777) == "0o777", "any user's process writes there"


def test_a_library_of_the_users_stays_behind_ours(container: Container) -> None:
    """Both are loaded."""
    lib = "/lib64/ld-linux-x86-64.so.2"
    own = next((str(p) for p in Path("/usr/lib").rglob("libdl.so.2")), lib)
    assert container.start(*PRINT, LD_PRELOAD=own).startswith(f"{container.home}/{LIBRARY}:{own} ")


def test_a_pod_that_hands_over_begins_to_wait(container: Container) -> None:
    """A node never works before its keeper says so."""
    assert container.start(*PRINT, RIGEL_K8S_PEERS="n-pods").split()[1:] == ["wait"]
    assert container.calls(1) == ["lean.py keeper.py run 1 wait []"]


def test_a_keeper_that_fails_is_started_again(container: Container) -> None:
    """Without it no process of the pod could ever take over."""
    (container.home / "fails").touch()
    container.start("/bin/sh", "-c", "sleep 2.5")
    assert len(container.calls(2)) == 2


def test_a_restart_keeps_what_the_keeper_knows(container: Container) -> None:
    """But not the files of processes whose ids are those of others now."""
    container.start("/bin/true")
    for name in ("1", "77", "control", "left-out", "progress", "keeper.json"):
        (container.notes / name).touch()
    container.start("/bin/true")
    assert [path.name for path in container.notes.iterdir()] == ["keeper.json"]


@pytest.mark.parametrize(
    ("broken", "why"),
    [
        (b"\x7fELF, but of no C library here", "its C library does not load ours"),
        (None, "there is no library for this machine"),
    ],
)
def test_where_the_library_cannot_be_loaded_the_program_runs_without_it(
    container: Container, broken: bytes | None, why: str
) -> None:
    """It would not start with an old C library; the probe finds the reason, and nothing waits."""
    (container.home / LIBRARY).unlink()
    if broken:
        (container.home / LIBRARY).write_bytes(broken)
    assert container.start(*PRINT, RIGEL_K8S_PEERS="n-pods") == "  \n"
    assert (container.notes / "left-out").read_text().startswith(why)
    assert not (container.home / "calls").exists()


def in_image(sh: str | Path, runner: str) -> list[str]:
    """Return words before a script that runs where /bin/sh is another program."""
    unshare = ["unshare", "--user", "--map-root-user", "--mount", "bash", "-c"]
    if subprocess.run([*unshare, "true"], capture_output=True).returncode:
        pytest.skip("no file system can be mounted here")
    return [*unshare, f'mount --bind "{sh}" /bin/sh && exec {runner} "$@"', "bash"]


@pytest.mark.parametrize("sh", ["dash", "bash", "busybox"])
def test_each_shell_of_an_image_starts_it_with_the_layer(container: Container, sh: str) -> None:
    """The library is tried with it."""
    if not (found := shutil.which(sh)):
        pytest.skip(f"{sh} is not installed")
    before = in_image(found, "/bin/sh")
    assert container.start(*PRINT, before=before).split() == [f"{container.home}/{LIBRARY}"]
    assert container.calls(1) == ["lean.py keeper.py run 1  []"]


def test_in_an_image_of_musl_the_program_runs_without_it(container: Container) -> None:
    """Whose sh loads the library: that itself says that it cannot work there."""
    if not shutil.which("musl-gcc"):
        pytest.skip("no musl-gcc (Debian: musl-tools)")
    source = container.home / "sh.c"
    source.write_text("int main(void) { return 0; }\n")
    before = in_image(compile_c(container.home / "sh", source, target="musl"), "bash")
    line = ("/bin/bash", *PRINT[1:])
    assert container.start(*line, before=before, RIGEL_K8S_PEERS="n-pods") == "  \n"
    why = "its C library does not load ours, which needs glibc 2.17 or newer"
    assert (container.notes / "left-out").read_text() == f"{why}: set `rmw_layer: false`\n"
    assert not (container.home / "calls").exists()


def test_without_python_the_program_runs_without_it(container: Container) -> None:
    """No one would let it work."""
    programs = container.home / "programs"
    programs.mkdir()
    for name in ("uname", "mkdir", "rm", "sleep"):
        (programs / name).symlink_to(str(shutil.which(name)))
    assert container.start(*PRINT, path=str(programs), RIGEL_K8S_PEERS="n-pods") == "  \n"
    assert "no Python 3" in (container.notes / "left-out").read_text()


def test_where_nothing_can_be_written_the_program_runs_without_it(container: Container) -> None:
    """A volume that is full, or of another user."""
    (container.home / "run").write_text("no directory")
    env = {"PATH": "/usr/bin:/bin", "RIGEL_RMW": str(container.notes)}
    line = ["/bin/sh", str(container.home / "rmw.sh"), *PRINT]
    done = subprocess.run(line, env=env, capture_output=True, text=True, timeout=60)
    assert done.stdout.splitlines()[-1] == "  "
    assert "so the program runs without our library" in done.stdout
