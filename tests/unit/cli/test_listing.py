"""How `rigel list` shows releases, to people and to scripts."""

from __future__ import annotations

import json
from datetime import datetime, timezone

import pytest

from rigel_k8s.cli import main
from rigel_k8s.cli.listing import summary_table
from rigel_k8s.commands import status
from rigel_k8s.release.listing import ReleaseSummary
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.settings import Settings

NOW = datetime(2026, 1, 1, 12, tzinfo=timezone.utc)
ARM = ReleaseSummary(
    ReleaseId("robot-07", "arm"), 4, "good", 5, 6, "2026-01-01T09:00:00Z", "deploy", "0.1.0"
)


@pytest.fixture(autouse=True)
def asked(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str | None, bool]]:
    """What the command was asked for: (namespace, everywhere); one release is there."""
    calls: list[tuple[str | None, bool]] = []

    def releases(settings: Settings, *, everywhere: bool) -> tuple[list[str], list[ReleaseSummary]]:
        calls.append((settings.namespace, everywhere))
        return [settings.namespace or "n"], [ARM]

    monkeypatch.setattr(status, "releases", releases)
    return calls


def test_a_table_has_the_namespace_only_where_all_are_shown() -> None:
    one, all_of_them = (summary_table([ARM], NOW, everywhere=where) for where in (False, True))
    assert one.splitlines()[1].split() == ["arm", "4", "good", "5/6", "3h", "deploy", "0.1.0"]
    assert all_of_them.splitlines()[0].split()[:2] == ["NAMESPACE", "NAME"]
    assert all_of_them.splitlines()[1].split()[:2] == ["robot-07", "arm"]


def test_scripts_get_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main.run(["list", "-o", "json"], "rigel") == 0
    as_json = json.loads(capsys.readouterr().out)
    assert (as_json[0]["release"], as_json[0]["ready"], as_json[0]["workloads"]) == ("arm", 5, 6)


def test_nothing_found_leads_to_all_namespaces(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Unless all were looked at."""
    for namespaces, where in (
        (["n"], "the namespace n; `rigel list -A` lists those of all namespaces"),
        (["a", "b"], "the namespaces a and b; `rigel list -A` lists those of all namespaces"),
        ([], "the cluster"),
    ):
        monkeypatch.setattr(status, "releases", lambda *_, found=namespaces, **__: (found, []))
        assert main.run(["list"], "rigel") == 0
        assert capsys.readouterr().err == f"no releases in {where}\n"


def test_releases_of_several_namespaces_have_theirs(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The jobs of a Rigelfile may name different ones."""
    monkeypatch.setattr(status, "releases", lambda *_, **__: (["robot-07", "robot-08"], [ARM]))
    assert main.run(["list"], "rigel") == 0
    assert capsys.readouterr().out.split()[0] == "NAMESPACE"


def test_the_namespace_may_stand_before_or_behind(asked: list[tuple[str | None, bool]]) -> None:
    for words in (["-n", "lab", "list"], ["list", "-n", "lab"], ["list", "-A"]):
        assert main.run(words, "rigel") == 0
    assert asked == [("lab", False), ("lab", False), (None, True)]
