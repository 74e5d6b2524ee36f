"""When the exporter is well, when a status is stale, and what a gap in a writer's samples gives."""

from __future__ import annotations

import time

from rigel_exporter.collection import PATIENCE, Collection
from rigel_exporter.config import Config
from rigel_exporter.dds_reliable import Change, Incoming
from rigel_exporter.dds_wire import Data, Gap, Heartbeat
from rigel_exporter.listening import Listening
from rigel_exporter.samples import Samples

from .test_serving import Half, status


def test_it_is_well_after_a_look_and_not_for_ever() -> None:
    """A thread that hangs looks no more; Kubernetes must start the exporter again."""
    half = Half()
    half.go.set()
    collection = Collection(half, Config(interval=5.0))
    assert not collection.well(), "no look yet"
    collection._look()
    assert collection.well()
    collection._last = time.time() - 5.0 - PATIENCE - 1
    assert not collection.well()


def test_a_status_that_no_one_repeats_is_stale_after_half_a_minute() -> None:
    half = Half()
    listening = Listening(half, Config(diagnostics=True))
    half.heard["/diagnostics"].now = Samples(payloads=(status("motor", 0),))

    def level(now: float) -> float:
        [found] = [s for s in listening.samples(now) if s.name == "ros_diagnostics_level"]
        return found.value

    assert [level(1000.0), level(1029.0), level(1031.0)] == [0, 0, 3]


def test_what_a_writer_has_nothing_for_is_handed_to_no_one() -> None:
    """A gap is passed by, and what comes after it comes in order."""
    incoming = Incoming(b"read")
    incoming.heartbeat(Heartbeat(b"writ", 1, 3, final=True))
    assert incoming.gap(Gap(b"writ", 2, 3, ())) == []
    assert incoming.take(Data(b"writ", 3, memoryview(b"three"))) == []
    found = incoming.take(Data(b"writ", 1, memoryview(b"one")))
    assert found == [Change(b"one"), Change(b"three")]
