"""What is told where the control plane does not come up."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from rigel_k8s.errors import CommandFailed, LocalClusterError
from rigel_lab.cluster import api, commands
from rigel_lab.cluster.addresses import Addresses
from rigel_lab.cluster.components import Components
from rigel_lab.cluster.layout import Layout


@pytest.mark.skipif(not shutil.which("openssl"), reason="needs openssl")
def test_an_api_server_that_is_not_there(tmp_path: Path) -> None:
    """The error shows its log's last lines, where the log is, and how to begin anew."""
    layout = Layout("a", tmp_path, Addresses("127.0.0.0/14"), Components({}, "/"))
    log = tmp_path / "control-plane/logs/kube-apiserver.log"
    log.parent.mkdir(parents=True)
    log.write_text("first\n" * 20 + "bind: address already in use\n")
    with pytest.raises(LocalClusterError, match="not ready after 0 s") as caught:
        api.wait_until_ready(layout, seconds=0)
    assert caught.value.details[-1] == "bind: address already in use"
    assert len(caught.value.details) == 10
    assert str(log) in (caught.value.hint or "")
    assert "rigel cluster down --name a" in (caught.value.hint or "")


def test_a_program_that_fails_shows_its_last_lines() -> None:
    """The error names the program and what it said on standard error, at most 20 lines."""
    script = "i=0; while [ $i -lt 40 ]; do i=$((i+1)); echo line $i >&2; done; exit 3"
    with pytest.raises(CommandFailed, match=r"sh -c .* failed .exit code 3") as caught:
        commands.run(["sh", "-c", script])
    assert caught.value.details == tuple(f"line {i}" for i in range(21, 41))


def test_a_program_that_is_not_there() -> None:
    """A missing program is told as such, not as a traceback."""
    with pytest.raises(CommandFailed, match="no-such-program is not installed"):
        commands.run(["no-such-program"])


def test_administrators_programs_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """`su` leaves /usr/sbin out of PATH; ip, nft and iptables are found all the same."""
    monkeypatch.setenv("PATH", "/bin")
    assert "/usr/sbin" in commands.run(["sh", "-c", "echo $PATH"]).strip().split(":")
