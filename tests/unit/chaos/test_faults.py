"""What bench.chaos relies on: a seed's faults, and checks that see what they are for."""

from __future__ import annotations

from collections import Counter
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from bench.chaos.calling import HUNG, SCALE, WARM
from bench.chaos.faults import AFTER, BEFORE, GARBAGE, ODD_EVENTS, STREAMS, Weather, draw_weather
from bench.chaos.stories import RELEASE, Content, Story, is_complete
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.release.revisions import NUMBER, OF, STATUS
from tests.support.fake_cluster import FakeCluster

IMAGE = "reg.invalid/ros"
CONTENT = Content(3, ("talker",), IMAGE)


def test_a_seed_gives_a_request_the_same_fault_in_any_order() -> None:
    """Threads send requests in another order each time."""
    weather = Weather("7", 0.5, [*BEFORE, *AFTER, *GARBAGE], None, 0, 0)
    asked = [("GET", f"/{path}", time) for path in range(30) for time in range(3)]

    def faults(order: Any) -> dict[Any, Any]:
        return {one: weather.fault(*one, stream=False) for one in order}

    assert faults(asked) == faults(reversed(asked))
    assert len(set(map(str, faults(asked).values()))) > 10


def test_every_fault_and_every_outage_is_drawn() -> None:
    """And a stream gets those of streams."""
    words: Counter[str] = Counter()
    outages: Counter[str | None] = Counter()
    for seed in range(300):
        weather = draw_weather(str(seed))
        outages[weather.outage] += 1
        for number in range(20):
            for stream in (False, True):
                if fault := weather.fault("GET", f"/{number}", 0, stream=stream):
                    words[fault.word] += 1
    assert set(words) == {*BEFORE, *AFTER, *GARBAGE, *STREAMS}
    assert set(ODD_EVENTS) < set(STREAMS)
    assert set(outages) == {None, "reset", "silent", "503", "503 page"}


def deployment(**changed: int) -> dict[str, Any]:
    status = {"observedGeneration": 1, "replicas": 1, "updatedReplicas": 1, "availableReplicas": 1}
    container = {"name": "talker", "image": IMAGE, "command": ["/node", "number=3"]}
    own = {"app": "talker"}
    return {
        "apiVersion": "apps/v1",
        "kind": "Deployment",
        "metadata": {
            "name": "talker",
            "namespace": "chaos-1",
            "generation": 1,
            "labels": {RELEASE_LABEL: RELEASE},
        },
        "spec": {
            "replicas": 1,
            "selector": {"matchLabels": own},
            "template": {"metadata": {"labels": own}, "spec": {"containers": [container]}},
        },
        "status": {**status, **changed},
    }


@pytest.mark.parametrize(
    "behind", ["observedGeneration", "updatedReplicas", "availableReplicas", "replicas"]
)
def test_what_is_not_rolled_out_is_not_complete(behind: str) -> None:
    """Each count of Kubernetes, the command and the image."""
    assert is_complete(deployment(), CONTENT)
    assert not is_complete(deployment(**{behind: 0}), CONTENT)
    assert not is_complete(deployment(), Content(4, ("talker",), IMAGE))
    assert not is_complete(deployment(), Content(3, ("talker",), "reg.invalid/other"))


def story(tmp_path: Path, *objects: Any) -> Story:
    cluster = FakeCluster()
    for one in objects:
        cluster.create(one)
    proxy: Any = None
    caller: Any = None
    asked: Any = cluster
    return Story(1, proxy, caller, asked, "", tmp_path)


def record(status: str) -> dict[str, Any]:
    labels = {OF: RELEASE, NUMBER: "1", STATUS: status}
    meta = {"name": "rigel.x.v1", "namespace": "chaos-1", "labels": labels}
    return {"apiVersion": "v1", "kind": "Secret", "metadata": meta}


NAMESPACE = {"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": "chaos-1"}}
ERROR = "error: cannot list Pods\n"


@pytest.mark.parametrize(
    ("code", "text", "faults", "wrong"),
    [
        (1, ERROR, True, ""),
        (1, ERROR, False, "it failed without a fault"),
        (1, ERROR + ERROR, True, "exit code 1 with 2 errors"),
        (1, "", True, "exit code 1 with 0 errors"),
        (2, ERROR, True, "exit code 2 with 1 errors"),
        (1, f"{ERROR}Traceback (most recent call last)", True, "a traceback"),
        (0, "Exception ignored in thread", True, "a traceback"),
        (HUNG, "", True, "it did not end within 120 s"),
        (0, "", True, "Deployments [], not ['talker']"),
    ],
)
def test_what_must_not_be_after_a_command_is_seen(
    tmp_path: Path, code: int, text: str, wrong: str, *, faults: bool
) -> None:
    """Exit codes, output, and success without its objects."""
    assert story(tmp_path, NAMESPACE).find_wrong(CONTENT, code, text, faults=faults) == wrong


def test_a_wrong_success_is_seen(tmp_path: Path) -> None:
    """A revision that is not good, a bad image that runs, what a `down` has left."""
    ready = deployment(observedGeneration=9)
    asked = story(tmp_path, NAMESPACE, ready, record("pending"))
    assert asked.find_difference(CONTENT) == "the newest revision is not good"
    assert "left after down: talker" in asked.find_difference(None)
    assert "cannot be" in asked.find_difference(Content(3, ("talker",), "reg.invalid/bad"))
    assert story(tmp_path, NAMESPACE, ready, record("good")).find_difference(CONTENT) == ""
    assert story(tmp_path, NAMESPACE).find_difference(None) == ""


def test_the_waits_that_the_campaigns_shorten_are_there() -> None:
    """A module that was renamed would fail each story, and no other test."""
    for name in WARM:
        import_module(name)
    for module, name, seconds in SCALE:
        assert getattr(import_module(f"rigel_k8s.{module}"), name) > seconds
