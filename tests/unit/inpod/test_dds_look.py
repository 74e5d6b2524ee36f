"""The look at DDS from inside a pod, with another participant on the loopback."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from tests.support.ddspeer import peer, some_domain

DOMAIN = some_domain() + 1


@pytest.fixture
def look(
    script: Callable[[str], ModuleType],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> Callable[..., list[dict[str, Any]]]:
    """Run the script; its two lines."""
    dds = script("dds")
    monkeypatch.setattr(script("interfaces"), "addresses", lambda: {"lo": "127.0.0.1"})
    monkeypatch.setattr(script("dds_local"), "participants", list)
    monkeypatch.setattr(dds, "is_enough", lambda: False)

    def run(*words: str, seconds: float = 1) -> list[dict[str, Any]]:
        more = ["--domain", str(DOMAIN), "--interface", "lo", "--seconds", str(seconds)]
        dds.main([*words, *more])
        return [json.loads(line) for line in capsys.readouterr().out.splitlines()]

    return run


def answering(look: Callable[[], list[dict[str, Any]]]) -> tuple[Any, list[dict[str, Any]]]:
    """Let a participant answer while a look goes on; both."""
    with peer(DOMAIN) as other:
        ended = threading.Event()

        def answer() -> None:
            while not ended.is_set():
                other.answer()
            other.answer()

        thread = threading.Thread(target=answer)
        thread.start()
        try:
            lines = look()
        finally:
            ended.set()
            thread.join()
    return other, lines


def test_who_is_asked_and_answers_is_heard(look: Callable[..., list[dict[str, Any]]]):
    """And the stand-in takes its announcement back at the end."""
    other, (here, heard) = answering(lambda: look("--ask", "127.0.0.1"))
    assert here["interfaces"] == {"lo": "127.0.0.1"}
    assert here["participants"] == []
    [found] = heard["participants"]
    assert (found["name"], found["domain"], found["own"]) == ("other", DOMAIN, False)
    assert found["prefix"] == other.told.prefix.hex()
    assert found["locators"] == [list(other.told.meta[0])]
    assert found["sources"] == ["127.0.0.1"]
    assert other.heard[-1][1], "the last word is a farewell"
    assert other.heard[0][0].name == "rigel-k8s graph check"
    assert other.heard[0][0].lease == 5


def test_a_participant_of_the_container_is_its_own(
    look: Callable[..., list[dict[str, Any]]],
    script: Callable[[str], ModuleType],
    monkeypatch: pytest.MonkeyPatch,
):
    """It is asked at its own socket, and told from others by it."""
    port = script("rtps").participant_port(DOMAIN, 0)
    own = SimpleNamespace(
        pid=7,
        command="talker",
        domain=DOMAIN,
        stopped=False,
        sockets=[SimpleNamespace(address="0.0.0.0", port=port)],
    )
    monkeypatch.setattr(script("dds_local"), "participants", lambda: [own])
    _, (here, heard) = answering(look)
    assert here["participants"] == [
        {"pid": 7, "command": "talker", "domain": DOMAIN, "stopped": False, "ports": [port]}
    ]
    assert [found["own"] for found in heard["participants"]] == [True]


def test_beacons_are_heard_by_interface(look: Callable[..., list[dict[str, Any]]]):
    """Ten a second, also one's own."""
    _, heard = look("--beacon", "machine one", seconds=0.5)
    assert heard["beacons"]["machine one"]["lo"] >= 2


def test_who_leaves_is_not_heard(script: Callable[[str], ModuleType]):
    standin = script("dds_standin").StandIn(DOMAIN, {})
    spdp = script("spdp")
    told = spdp.Announcement(bytes(range(12)), name="other")
    standin._take(spdp.farewell(told.prefix), "10.0.0.1", None)
    assert standin.participants == {}
    standin._take(spdp.announcement(told), "10.0.0.1", None)
    standin._take(spdp.announcement(told), "10.0.0.2", None)
    assert [one["sources"] for one in standin.participants.values()] == [["10.0.0.1", "10.0.0.2"]]
    ours = told._replace(name="rigel-k8s graph check", prefix=bytes(12))
    standin._take(spdp.announcement(ours), "10.0.0.3", None)
    assert len(standin.participants) == 1
    standin.close()


@pytest.mark.parametrize("words", [["--what"], ["--domain"], ["--domain", "x"]])
def test_wrong_arguments(script: Callable[[str], ModuleType], words: list[str]):
    with pytest.raises(SystemExit, match="2"):
        script("dds").main(words)
