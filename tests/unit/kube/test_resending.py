"""An API server that is busy or away, and writes whose answer is lost."""

from __future__ import annotations

import threading
import time
from typing import Any

import pytest

from rigel_k8s.errors import ClusterError, ConflictError, Interrupted
from rigel_k8s.kube import transport as resending
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.target import Target
from rigel_k8s.kube.transport import Resending, retry_after
from rigel_k8s.objects.refs import ObjectRef
from tests.support.http_server import Exchange, serving

from .conftest import MANIFEST, REF

META = {"name": "c", "namespace": "robot"}
EXISTS = {"kind": "Status", "reason": "AlreadyExists", "message": "it is there"}
DELETED = {"kind": "Status", "status": "Success"}
WRITES = {
    "create": lambda cluster: cluster.create(MANIFEST),
    "replace": lambda cluster: cluster.replace(MANIFEST),
    "patch": lambda cluster: cluster.patch(
        REF, {"metadata": {"resourceVersion": "1"}, "data": {"a": "1", "gone": None}}
    ),
    "apply": lambda cluster: cluster.apply(MANIFEST),
}


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pauses are short."""
    monkeypatch.setattr(resending, "FIRST_PAUSE", 0.01)
    monkeypatch.setattr(resending, "LONGEST_PAUSE", 0.05)
    monkeypatch.setattr(resending, "SILENT", 0.0)


def fine(exchange: Exchange) -> None:
    exchange.say(200, MANIFEST)


def away(exchange: Exchange) -> None:
    exchange.hang_up()


def endure(cluster: Cluster) -> tuple[list[str], threading.Event]:
    """Let a cluster wait; return the lines that it tells, and what ends it."""
    lines: list[str] = []
    cancel = threading.Event()
    cluster.endure(lines.append, cancel)
    return lines, cancel


def warm(serve: Any, answers: list[Any], last: Any = fine) -> tuple[Cluster, Any]:
    """Return a cluster that has answered once, and goes on with these answers."""
    script = iter([fine, *answers])
    cluster, server = serve(lambda exchange: next(script, last)(exchange))
    cluster.get(REF)
    return cluster, server


def lose_server() -> tuple[Cluster, int]:
    """Return a cluster whose server has answered and listens no more, and the server's port."""
    with serving(fine) as first:
        port = first.server_port
        cluster = Cluster(Target(first.url))
        cluster.get(REF)
    cluster.client.transport.connections.close()
    return cluster, port


def add_item(cluster: Cluster) -> dict[str, Any]:
    """Send a JSON patch, which adds a second item if it is sent twice."""
    url, media = "/api/v1/namespaces/robot/configmaps/c", "application/json-patch+json"
    return cluster.client.write("PATCH", url, "add an item", [], media, safe=False)


def say(status: int, body: object = b"", **headers: str) -> Any:
    return lambda exchange: exchange.say(status, body, **headers)


@pytest.mark.parametrize("write", WRITES)
@pytest.mark.parametrize("lost", [away, say(200, b"<html>"), say(500), say(502), say(503)])
def test_a_write_whose_answer_was_lost_is_found_to_be_ours(
    serve: Any, write: str, lost: Any
) -> None:
    """The second one is refused, since the first was carried out: what is there is what we sent.

    A gateway that gave up may have passed it on.
    """
    live = {**MANIFEST, "metadata": {**META, "uid": "u", "resourceVersion": "2"}}
    cluster, server = warm(serve, [lost, say(409, EXISTS), say(200, live)])
    endure(cluster)
    assert WRITES[write](cluster) == live
    assert len(server.requests) == 4


@pytest.mark.parametrize("write", WRITES)
def test_what_another_wrote_is_not_ours(serve: Any, write: str) -> None:
    """The first one was never carried out, and someone else came before the second."""
    other = {**MANIFEST, "data": {"a": "2"}}
    cluster, _ = warm(serve, [away, say(409, EXISTS), say(200, other)])
    with pytest.raises(ConflictError, match="it is there"):
        WRITES[write](cluster)


@pytest.mark.parametrize("write", WRITES)
def test_a_conflict_at_once_is_a_conflict(serve: Any, write: str) -> None:
    """Even where the object looks the same: no write of ours can have made it so."""
    cluster, server = warm(serve, [say(409, EXISTS)])
    with pytest.raises(ConflictError):
        WRITES[write](cluster)
    assert len(server.requests) == 2


DRY_RUNS = {
    "create": lambda cluster: cluster.create(MANIFEST, dry_run=True),
    "create without a name": lambda cluster: cluster.create(
        {**MANIFEST, "metadata": {"generateName": "c-", "namespace": "robot"}}, dry_run=True
    ),
    "apply": lambda cluster: cluster.apply(MANIFEST, dry_run=True),
}


@pytest.mark.parametrize("write", DRY_RUNS)
def test_a_lost_dry_run_has_written_nothing(serve: Any, write: str) -> None:
    """What is there is not our own, whatever it looks like."""
    cluster, server = warm(serve, [away, say(409, EXISTS)])
    with pytest.raises(ConflictError, match="it is there"):
        DRY_RUNS[write](cluster)
    assert len(server.requests) == 3


def test_what_a_lost_delete_has_deleted_was_there(serve: Any) -> None:
    """The second one finds nothing."""
    cluster, _ = warm(serve, [away, say(404, {"kind": "Status"})])
    assert cluster.delete(REF) is True


def test_a_conflict_about_the_same_object_is_no_reason_to_leave_it(serve: Any) -> None:
    """Something wrote to it at the same moment."""
    live = {**MANIFEST, "metadata": {**META, "uid": "u"}}
    cluster, server = warm(serve, [say(409, EXISTS), say(200, live), say(200, DELETED)])
    assert cluster.delete(REF, uid="u") is True
    assert len(server.requests) == 4


def test_a_conflict_that_stays_is_not_one_of_another_object(serve: Any) -> None:
    live = {**MANIFEST, "metadata": {**META, "uid": "u"}}
    cluster, _ = warm(serve, [say(409, EXISTS), say(200, live)] * 3)
    with pytest.raises(ClusterError, match="it is there") as raised:
        cluster.delete(REF, uid="u")
    assert not isinstance(raised.value, ConflictError)
    assert "run the command again" in str(raised.value.hint)


def test_another_object_of_the_name_is_left_alone(serve: Any) -> None:
    live = {**MANIFEST, "metadata": {**META, "uid": "another"}}
    cluster, server = warm(serve, [say(409, EXISTS), say(200, live)])
    with pytest.raises(ConflictError):
        cluster.delete(REF, uid="u")
    assert len(server.requests) == 3


def test_what_is_gone_after_a_conflict_was_deleted(serve: Any) -> None:
    cluster, _ = warm(serve, [say(409, EXISTS), say(404, {"kind": "Status"})])
    assert cluster.delete(REF, uid="u") is True


@pytest.mark.parametrize("trouble", [away, say(500), say(502), say(503)])
def test_not_even_long_work_sends_them_twice(serve: Any, trouble: Any) -> None:
    """What answers so may have carried them out."""
    cluster, server = warm(serve, [], last=trouble)
    endure(cluster)
    with pytest.raises(ClusterError):
        add_item(cluster)
    assert len(server.requests) == 2


@pytest.mark.parametrize(
    "trouble",
    [
        away,
        say(429),
        say(429, b"", Retry_After="0"),
        say(500),
        say(502),
        say(503),
        say(503, b"<html>", Retry_After="Wed, 21 Oct 2026 07:28:00 GMT"),
        say(504),
    ],
)
@pytest.mark.parametrize("write", [*WRITES, "get"])
def test_long_work_waits_for_a_server_that_is_away(
    serve: Any, monkeypatch: pytest.MonkeyPatch, write: str, trouble: Any
) -> None:
    """For each method, longer than a single request would, with one line before and one after."""
    monkeypatch.setattr(resending, "retry_after", lambda headers: 0.0 if headers else None)
    cluster, server = warm(serve, [trouble] * 8)
    lines, _ = endure(cluster)
    assert {**WRITES, "get": lambda c: c.get(REF)}[write](cluster) == MANIFEST
    assert len(server.requests) == 10
    assert cluster.sum_outages() > 0
    before, after = lines
    assert before.startswith(f"the cluster at {server.url} ")
    assert before.endswith("waiting up to 120 s for it")
    assert after.startswith("the cluster answers again")


def test_a_server_that_never_answered_is_not_waited_for(serve: Any) -> None:
    """The context may be the wrong one."""
    cluster, server = serve(away)
    lines, _ = endure(cluster)
    with pytest.raises(ClusterError, match="does not answer"):
        cluster.get(REF)
    assert (len(server.requests), lines) == (2, [])


def test_waiting_ends(serve: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """After its time, with the error of the last try."""
    monkeypatch.setattr(resending, "AWAY", 0.3)
    cluster, _ = warm(serve, [], last=away)
    endure(cluster)
    with pytest.raises(ClusterError, match="does not answer"):
        cluster.get(REF)


def test_waiting_ends_when_the_user_asks_for_it(serve: Any) -> None:
    """As an interruption; a request after that (the Lease is given back) does not wait."""
    cluster, _ = warm(serve, [], last=away)
    lines: list[str] = []
    cancel = threading.Event()
    cluster.endure(lambda line: (lines.append(line), cancel.set())[0], cancel)
    with pytest.raises(Interrupted, match="does not answer") as caught:
        cluster.get(REF)
    assert isinstance(caught.value, ClusterError)
    assert caught.value.exit_code == 130
    with pytest.raises(ClusterError) as caught:
        cluster.get(REF)
    assert not isinstance(caught.value, Interrupted)


def test_nothing_behind_a_service_is_an_answer(serve: Any) -> None:
    """503 comes from the API server itself there, and is not waited out."""
    cluster, server = warm(serve, [], last=say(503, {"message": "no endpoints available"}))
    endure(cluster)
    with pytest.raises(ClusterError, match="no endpoints"):
        cluster.get_through_proxy(ObjectRef("v1", "Service", "n", "s"), "x", port=80)
    assert len(server.requests) == 2


@pytest.mark.parametrize(
    ("header", "seconds"),
    [("7", 7), ("0", 0), ("", 1), ("-1", 1), ("1e9", 1), ("²", 1), ("٣", 1), ("9" * 400, 1)]
    + [("Wed, 21 Oct 2026 07:28:00 GMT", 1), ("nan", 1), (None, None)],
)
def test_retry_after_may_say_anything(header: str | None, seconds: float | None) -> None:
    """What is not a number of seconds counts as one second."""
    assert retry_after({} if header is None else {"Retry-After": header}) == seconds


@pytest.mark.parametrize("endures", [True, False])
@pytest.mark.parametrize("status", [429, 503])
def test_a_server_that_names_a_time_is_given_it(status: int, endures: bool) -> None:  # noqa: FBT001
    again = Resending(safe=True, endures=endures)
    assert again.after_answer(status, {"Retry-After": "7"}) == 7.0


def test_a_short_pause_is_not_worth_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resending, "SILENT", 1.0)
    again = Resending(safe=True, endures=True)
    assert not again.is_noticeable(0.25)
    assert again.is_noticeable(1.5)


def test_what_never_arrived_is_sent_again(serve: Any) -> None:
    """Even steps on what was there: no one can have carried them out."""
    cluster, port = lose_server()
    lines, _ = endure(cluster)
    results: list[Any] = []
    patch = threading.Thread(target=lambda: results.append(add_item(cluster)))
    patch.start()
    while not lines and patch.is_alive():
        time.sleep(0.01)
    with serving(fine, port=port):
        patch.join(20)
    cluster.close()
    assert results == [MANIFEST]
    assert "refused" in lines[0]


def test_an_error_that_stays_is_not_waited_for_as_long(monkeypatch: pytest.MonkeyPatch) -> None:
    """A server that says 500 for half a minute has a reason; one that is away may come back."""
    clock = [0.0]
    monkeypatch.setattr(resending.time, "monotonic", lambda: clock[0])
    monkeypatch.setattr(resending, "FIRST_PAUSE", 0.25)
    monkeypatch.setattr(resending, "LONGEST_PAUSE", 5.0)

    def waited(status: int) -> float:
        clock[0] = 0.0
        again = Resending(safe=True, endures=True, started=0.0)
        while (pause := again.after_answer(status, {})) is not None:
            clock[0] += pause
        return clock[0]

    assert 20 < waited(500) <= 30
    assert 110 < waited(503) <= 120


def test_slow_bytes_have_a_limit(serve: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each byte comes in time, the answer does not."""
    monkeypatch.setattr("rigel_k8s.kube.transport.WHOLE_TIMEOUT", 0.2)

    def drip(exchange: Exchange) -> None:
        exchange.stream()
        while True:
            exchange.chunk(b" ")
            time.sleep(0.02)

    cluster, _ = serve(drip)
    with pytest.raises(ClusterError, match="not complete after"):
        cluster.get(REF)


@pytest.mark.parametrize(
    "trouble", [away, say(503), say(200, b"{")], ids=["away", "503", "garbled"]
)
@pytest.mark.parametrize("write", WRITES)
def test_a_write_is_sent_again_only_with_leave(serve: Any, write: str, trouble: Any) -> None:
    """Another process may have begun to change the same before the answer was there."""
    cluster, server = warm(serve, [trouble])
    endure(cluster)

    def refuse() -> None:
        raise ClusterError("the Lease is lost")

    with cluster.guard_writes(refuse), pytest.raises(ClusterError, match="Lease is lost"):
        WRITES[write](cluster)
    assert len(server.requests) == 2


def test_reads_need_no_leave_and_first_writes_have_it(serve: Any) -> None:
    cluster, _ = warm(serve, [away])
    asked: list[str] = []
    with cluster.guard_writes(lambda: asked.append("leave")):
        cluster.get(REF)
        cluster.patch(REF, {"data": {"a": "1"}})
    assert asked == []
