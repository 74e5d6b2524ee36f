"""Whether a container's log goes on, asked of a small server that is as slow as a busy machine."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from rigel_k8s.kube import ending
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.ending import LogEnd
from tests.support.clock import Clock
from tests.support.http_server import Exchange
from tests.support.until import until

CONTAINER = ("n", "talker", "node")
SECONDS = 10.0
Answer = Callable[[Exchange], None]


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(ending, "time", made)
    return made


@pytest.fixture
def over() -> Iterator[threading.Event]:
    """The end of what a server does."""
    made = threading.Event()
    yield made
    made.set()


@pytest.fixture
def follow(serve: Any, clock: Clock) -> Callable[..., LogEnd]:
    """Return what follows a log of a kubelet that answers so, after so many seconds."""

    def start(answer: Answer, took: float = 0.0) -> LogEnd:
        def kubelet(exchange: Exchange) -> None:
            if "follow" in exchange.request_.query:
                answer(exchange)
            else:
                clock.now += took
                exchange.say(200)

        cluster: Cluster = serve(kubelet)[0]
        log = cluster.follow_end(*CONTAINER, seconds=SECONDS)
        until(lambda: log.over or log.begun is not None, "begin", every=0.01)
        return log

    return start


@pytest.mark.parametrize("body", [b"", b"a line\n"])
def test_a_log_that_ends_is_a_container_that_has_ended(follow: Any, body: bytes) -> None:
    """That is told as soon as it is over, however long it should have gone on."""
    log = follow(lambda exchange: exchange.say(200, body))
    until(lambda: log.over, "the end", every=0.01)
    assert log.ended
    assert log.settled


def test_a_container_runs_while_its_log_goes_on(
    follow: Any, clock: Clock, over: threading.Event
) -> None:
    """Whether it is silent from the start, or after a line, or never stops."""

    def be_silent(_: Exchange) -> None:
        over.wait(60)

    def begin_and_be_silent(exchange: Exchange) -> None:
        exchange.stream()
        over.wait(60)

    def talk(exchange: Exchange) -> None:
        exchange.stream()
        while not over.wait(0.01):
            exchange.chunk(b"line\n")

    for answer in (be_silent, begin_and_be_silent, talk):
        log = follow(answer)
        clock.now += SECONDS - 1
        assert not log.settled
        clock.now += 1
        assert log.settled
        assert not log.over
        log.abort()
        until(lambda log=log: log.over, "the thread's end", every=0.01)
        assert not log.ended


def test_what_is_aborted_before_there_is_a_connection_ends(serve: Any) -> None:
    """A quiet container's log would keep its thread for ever."""
    asked, go_on, over = threading.Event(), threading.Event(), threading.Event()

    def kubelet(exchange: Exchange) -> None:
        if "follow" in exchange.request_.query:
            over.wait(60)
        asked.set()
        go_on.wait(60)
        exchange.say(200)

    log = serve(kubelet)[0].follow_end(*CONTAINER, seconds=SECONDS)
    assert asked.wait(60)
    log.abort()
    go_on.set()
    until(lambda: log.over, "the thread's end", 20, every=0.01)
    assert not log.ended
    over.set()


def test_a_slow_machine_gets_the_time_to_tell_of_an_end(
    follow: Any, clock: Clock, over: threading.Event
) -> None:
    """As long as several answers that certainly come."""
    log = follow(lambda _: over.wait(60), took=SECONDS)
    clock.now += SECONDS
    assert not log.settled
    clock.now += SECONDS * ending.ANSWERS
    assert log.settled


def break_off(exchange: Exchange) -> None:
    exchange.stream(b"line\n")
    exchange.hang_up()


@pytest.mark.parametrize(
    "answer", [break_off, *(lambda e, s=s: e.say(s, b"no") for s in (403, 404, 500))]
)
def test_who_cannot_read_a_log_knows_nothing(follow: Any, answer: Answer) -> None:
    """That is no reason to call a node ended."""
    log = follow(answer)
    until(lambda: log.over, "the end", every=0.01)
    assert log.settled
    assert not log.ended


def test_rights_for_logs_may_be_missing(serve: Any) -> None:
    log = serve(lambda exchange: exchange.say(403))[0].follow_end(*CONTAINER, seconds=SECONDS)
    until(lambda: log.over, "the end", every=0.01)
    assert log.settled
    assert not log.ended
