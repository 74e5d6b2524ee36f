"""What is told where the control plane does not come up."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.errors import CommandFailed, LocalClusterError
from rigel_k8s.kube import ObjectRef
from rigel_lab.cluster import api, commands
from rigel_lab.cluster.addresses import Addresses
from rigel_lab.cluster.components import Components
from rigel_lab.cluster.layout import Layout

pytestmark = pytest.mark.programs


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


class Deployments:
    """A cluster whose Deployment changes each time that it is asked for."""

    def __init__(self, *states: dict[str, Any]) -> None:
        self.states = list(states)
        self.asked = 0

    def __enter__(self) -> Deployments:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is kept open."""

    def get(self, ref: ObjectRef) -> dict[str, Any]:
        assert ref == ObjectRef("apps/v1", "Deployment", "kube-system", "coredns")
        self.asked += 1
        return self.states[min(self.asked, len(self.states)) - 1]


def deployment(**status: Any) -> dict[str, Any]:
    return {"metadata": {"generation": 2}, "spec": {"replicas": 1}, "status": status}


DONE = {"observedGeneration": 2, "replicas": 1, "updatedReplicas": 1, "availableReplicas": 1}


@pytest.mark.parametrize(
    "missing",
    [
        {"observedGeneration": 1},  # the controller has not seen the new template
        {"updatedReplicas": 0},
        {"availableReplicas": 0},
        {"replicas": 2},  # one of the template before is still there
    ],
)
def test_a_deployment_is_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, missing: dict[str, int]
) -> None:
    """DNS and storage are ready with the template that was applied just now, not with another."""
    cluster = Deployments({}, deployment(**DONE | missing), deployment(**DONE))
    monkeypatch.setattr(api, "connect", lambda layout: cluster)
    layout = Layout("a", tmp_path, Addresses("127.0.0.0/14"), Components({}, "/"))
    api.wait_for_deployment(layout, "kube-system", "coredns")
    assert cluster.asked == 3


def test_a_deployment_that_does_not_come(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The error names it, its own reasons, and where its pods' logs are."""
    reason = {"type": "Available", "status": "False", "message": "Deployment does not have minimum"}
    cluster = Deployments(deployment(conditions=[reason]))
    monkeypatch.setattr(api, "connect", lambda layout: cluster)
    layout = Layout("a", tmp_path, Addresses("127.0.0.0/14"), Components({}, "/"))
    with pytest.raises(LocalClusterError, match="coredns was not ready after 0 s") as caught:
        api.wait_for_deployment(layout, "kube-system", "coredns", seconds=0)
    assert caught.value.details == (reason["message"],)
    assert f"{tmp_path}/node*/pod-logs/kube-system_*" in (caught.value.hint or "")
