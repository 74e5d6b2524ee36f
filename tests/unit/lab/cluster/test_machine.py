"""A machine's process is known for certain."""

from __future__ import annotations

import shlex
import subprocess
from pathlib import Path

import attrs
import pytest

from rigel_k8s.errors import LocalClusterError
from rigel_lab.cluster.machine import Machine, Process, end, read_process

pytestmark = pytest.mark.programs


def write_record(directory: Path, process: Process) -> None:
    fields = ["S", *["0"] * 18, str(process.start)]
    (directory / "process").write_text(f"{process.pid} (odd ) name) {' '.join(fields)}\n")


def test_a_record_is_read_back(tmp_path: Path) -> None:
    """Id and start are found behind whatever name the process has."""
    write_record(tmp_path, Process(123, 456))
    assert read_process(tmp_path) == Process(123, 456)


def test_another_process_of_the_same_id_is_not_killed(tmp_path: Path) -> None:
    """Where the id was given to somebody else since, `end` leaves that one alone."""
    with subprocess.Popen(["sleep", "60"]) as stranger:
        live = Process.of(stranger.pid)
        assert live is not None
        write_record(tmp_path, attrs.evolve(live, start=live.start - 1))
        end(tmp_path, "no-such-namespace")
        assert stranger.poll() is None
        assert not (tmp_path / "process").exists()
        stranger.kill()


def test_a_machine_that_does_not_start_is_told(tmp_path: Path) -> None:
    """Its log's last lines are in the error."""
    machine = Machine(
        name="node1",
        namespace="no-such-namespace",
        directory=tmp_path / "never made",
        init="/bin/true",
        services={},
        environment={},
    )
    machine.logs.mkdir(parents=True)
    (machine.directory / "process.new").mkdir()  # the record cannot be written
    (machine.directory / "launch.sh").touch()
    with pytest.raises(LocalClusterError, match="node1 did not start"):
        machine.wait(seconds=0.1)


def test_scripts_quote_what_they_are_given(tmp_path: Path) -> None:
    """A directory with spaces and quotes is one word of valid shell."""
    machine = Machine(
        name="node1",
        namespace="rigel-a-node1",
        directory=tmp_path / "it's here",
        init="/bin/true",
        services={"kubelet": ["kubelet", "--config=it's here"]},
        environment={"PATH": "/bin"},
        binds={tmp_path / "it's here" / "cni": "/var/lib/cni"},
    )
    odd = str(tmp_path / "it's here")
    for script in (machine.init_script(), machine.launch_script()):
        subprocess.run(["sh", "-n"], input=script, text=True, check=True)
        lines = [line for line in script.splitlines() if "here" in line]
        words = [word for line in lines for word in shlex.split(line) if "here" in word]
        assert words
        assert all(word.lstrip(">").startswith((odd, "--config=it's here")) for word in words)
        assert not any(word in ("here", "it's") for word in words)
