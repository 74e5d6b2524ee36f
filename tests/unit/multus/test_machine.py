"""machine.sh on a machine of directories: the real script, run by the shells that images have."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
from collections.abc import Callable, Iterator
from importlib.resources import files
from pathlib import Path

import pytest

from tests.support.until import until

pytestmark = pytest.mark.programs

SCRIPT = (files("rigel_multus") / "machine.sh").read_text("utf-8")
EVERY = "sleep 2 &"  # between two looks of `keep`
SHELLS = [
    words for words in (["dash"], ["bash", "--posix"], ["busybox", "sh"]) if shutil.which(words[0])
]
PLUGIN = {"type": "flannel", "delegate": {"hairpinMode": True}}
PRIMARY = json.dumps({"cniVersion": "1.0.0", "name": "cbr0", "plugins": [PLUGIN]}, indent=2)
DAEMON = '{"binDir":"/x","clusterNetwork":"%s","type":"multus-shim","daemonSocketDir":"/run/m"}'


class Machine:
    """Directories in place of a machine's, and the script on them."""

    def __init__(self, directory: Path, shell: list[str]) -> None:
        self.shell, self.directory = shell, directory
        self.conf, self.programs = directory / "conf", directory / "bin"
        self.image, self.brought = directory / "image", directory / "brought"
        self.generated, self.ipam = directory / "generated", directory / "cni/net.d/whereabouts.d"
        for place in (self.conf, self.programs, self.image, self.brought, self.generated):
            place.mkdir()
        (self.conf / "10-flannel.conflist").write_text(PRIMARY)
        for name in ("multus-shim", "passthru"):
            (self.image / name).write_text(f"{name} 1")
        self.kept: subprocess.Popen[bytes] | None = None
        self.script = directory / "machine.sh"
        assert EVERY in SCRIPT
        self.looks = directory / "looks"  # a line for each look of `keep`
        self.script.write_text(SCRIPT.replace(EVERY, f"echo >> {self.looks}; sleep 0.05 &"))

    def environment(self, **more: str) -> dict[str, str]:
        return {
            "PATH": os.environ["PATH"],
            "PART": "multus",
            "RETIRED": "",
            "BIN_DIR": str(self.programs),
            "CONF_DIR": str(self.conf),
            "BROUGHT": str(self.brought),
            "STANDARD": "macvlan static",
            "PROGRAMS": "multus-shim passthru",
            "SOURCE": str(self.image),
            "GENERATED": str(self.generated),
            "NEEDED": "macvlan",
            "IPAM_DIR": str(self.ipam),
            **more,
        }

    def run(self, word: str, **more: str) -> tuple[int, str]:
        done = subprocess.run(
            [*self.shell, str(self.script), word],
            check=False,
            env=self.environment(**more),
            capture_output=True,
            text=True,
        )
        return done.returncode, (done.stdout + done.stderr).strip()

    def keep(self, **more: str) -> None:
        self.end()
        self.kept = subprocess.Popen(
            [*self.shell, str(self.script), "keep"],
            env=self.environment(**more),
            stdout=subprocess.DEVNULL,
        )

    def end(self) -> None:
        """Tell it to end, as Kubernetes does; it ends well, and soon."""
        if self.kept is not None:
            self.kept.send_signal(signal.SIGTERM)
            assert self.kept.wait(timeout=30) == 0
            self.kept = None

    def until(self, look: Callable[[], object]) -> None:
        def files() -> list[str]:
            return sorted(map(str, self.directory.rglob("*")))

        until(look, "change", 30, every=0.05, last_words=files)

    def look_again(self) -> None:
        """Wait for the ends of two looks of `keep`: the second one began after this."""
        before = self.looks.stat().st_size if self.looks.exists() else 0
        self.until(lambda: self.looks.exists() and self.looks.stat().st_size >= before + 2)

    def daemon_writes(self) -> None:
        text = DAEMON % (self.conf / "10-flannel.conflist")
        (self.generated / "00-multus.conf").write_text(text)


@pytest.fixture(params=SHELLS, ids=lambda words: words[0])
def machine(tmp_path: Path, request: pytest.FixtureRequest) -> Iterator[Machine]:
    """A machine with a primary network and no Multus."""
    made = Machine(tmp_path, request.param)
    yield made
    made.end()


def test_programs_and_configuration_are_put_in_place(machine: Machine) -> None:
    """Programs come first, then the configuration, with the primary network's own inside."""
    machine.daemon_writes()
    machine.keep()
    machine.until((machine.conf / "00-multus.conf").exists)
    assert (machine.programs / "multus-shim").read_text() == "multus-shim 1"
    assert os.access(machine.programs / "multus-shim", os.X_OK)
    written = json.loads((machine.conf / "00-multus.conf").read_text())
    assert written["delegates"] == [json.loads(PRIMARY)]
    assert "clusterNetwork" not in written
    assert written["daemonSocketDir"] == "/run/m"


def test_the_configuration_outlives_the_daemon(machine: Machine) -> None:
    """Upstream's daemon takes it away when it ends, and pods then come up without their network."""
    machine.daemon_writes()
    machine.keep()
    machine.until((machine.conf / "00-multus.conf").exists)
    (machine.generated / "00-multus.conf").unlink()
    machine.look_again()
    assert (machine.conf / "00-multus.conf").exists()
    machine.end()
    assert (machine.conf / "00-multus.conf").exists()


def test_half_a_configuration_is_not_taken(machine: Machine) -> None:
    """The daemon does not write at once; what is not whole is not for the runtime."""
    machine.daemon_writes()
    whole = (machine.generated / "00-multus.conf").read_text()
    (machine.generated / "00-multus.conf").write_text(whole[:-20])
    machine.keep()
    machine.until((machine.programs / "multus-shim").exists)
    machine.look_again()
    assert not (machine.conf / "00-multus.conf").exists()


def test_what_is_taken_away_comes_back(machine: Machine) -> None:
    """An upgrade may replace the directory of programs."""
    machine.keep()
    machine.until((machine.programs / "passthru").exists)
    machine.programs.rename(machine.programs.with_name("replaced"))  # while files are written to it
    machine.programs.mkdir()
    machine.until((machine.programs / "passthru").exists)
    machine.until((machine.programs / "multus-shim").exists)


def test_a_newer_image_brings_its_programs(machine: Machine) -> None:
    """What we have put there follows our image."""
    machine.keep()
    machine.until((machine.programs / "passthru").exists)
    machine.end()
    (machine.image / "multus-shim").write_text("multus-shim 2")
    machine.keep()
    machine.until(lambda: (machine.programs / "multus-shim").read_text() == "multus-shim 2")


def test_programs_of_others_stay(machine: Machine) -> None:
    """Standard programs are put only where there are none, and k3s' links are left alone."""
    for name in ("macvlan", "static", "bridge"):
        (machine.brought / name).write_text("ours")
    (machine.programs / "macvlan").write_text("theirs")
    (machine.programs / "bridge").symlink_to("/nowhere/bin/cni")
    machine.keep()
    machine.until((machine.programs / "static").exists)
    machine.end()
    assert (machine.programs / "macvlan").read_text() == "theirs"
    assert (machine.programs / "bridge").is_symlink()
    assert (machine.programs / "static").read_text() == "ours"


def test_a_retired_machine_is_as_it_was(machine: Machine) -> None:
    """Configuration goes at once, programs at the end, and what others have put there stays."""
    (machine.programs / "macvlan").write_text("theirs")
    (machine.brought / "static").write_text("ours")
    before = sorted(p.name for p in [*machine.programs.iterdir(), *machine.conf.iterdir()])
    machine.daemon_writes()
    machine.keep()
    machine.until((machine.conf / "00-multus.conf").exists)
    machine.until((machine.programs / "static").exists)
    machine.end()
    machine.keep(RETIRED="1")
    machine.until(lambda: not (machine.conf / "00-multus.conf").exists())
    assert (machine.programs / "multus-shim").exists()
    assert machine.run("ready", RETIRED="1")[0] == 0
    machine.end()
    after = sorted(p.name for p in [*machine.programs.iterdir(), *machine.conf.iterdir()])
    assert after == before


def test_ready_says_what_is_missing(machine: Machine) -> None:
    """Each thing that is missing is named, with the option that helps."""
    assert machine.run("ready") == (
        1,
        f"the program multus-shim is missing in {machine.programs}: "
        "set network.install.plugins_image to an image that has it",
    )
    machine.keep()
    machine.until((machine.programs / "passthru").exists)
    code, told = machine.run("ready")
    assert (code, told.partition(":")[0]) == (
        1,
        f"the program macvlan is missing in {machine.programs}",
    )
    (machine.programs / "macvlan").write_text("")
    (machine.programs / "macvlan").chmod(0o755)
    assert machine.run("ready") == (1, "Multus' daemon has not written its configuration yet")
    machine.daemon_writes()
    machine.until((machine.conf / "00-multus.conf").exists)
    assert machine.run("ready") == (0, "")
    (machine.conf / "10-flannel.conflist").unlink()
    code, told = machine.run("ready")
    assert code == 1
    assert told.startswith(f"{machine.conf} has no CNI configuration: set network.install.")
    shutil.rmtree(machine.programs)
    code, told = machine.run("ready")
    missing = f"the directory {machine.programs} does not exist: set network.install.cni_bin_dir"
    assert told.startswith(missing)


def test_an_image_without_programs_is_told(machine: Machine) -> None:
    """Where the plugins' image brings nothing, its pod says so."""
    if Path("/opt/cni/bin/macvlan").exists():
        pytest.skip("this machine has CNI programs of its own")
    code, told = machine.run("copy")
    assert code == 1
    assert "set network.install.plugins_image to an image that has it" in told
