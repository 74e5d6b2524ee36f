"""The ports of the stack's Services, why a part is not asked, and what logs ask for."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.commands.logs.lines import LogOptions
from rigel_k8s.commands.logs.reading import Edge
from rigel_k8s.kube.failures import refusal
from rigel_k8s.observability.options import Existing, ExistingLoki, Observability
from rigel_k8s.observability.reading.stack import InstalledStack, NoStack, choose_service, explain
from rigel_stack.observing import target_port

POD = {"spec": {"containers": [{"ports": [{"name": "http", "containerPort": 8080}]}]}}


@pytest.mark.parametrize(
    ("port", "number"),
    [({"port": 80, "targetPort": "http"}, 8080), ({"port": 80, "targetPort": 81}, 81),
     ({"port": 82}, 82)],
)  # fmt: skip
def test_a_services_port_is_the_pods(port: dict[str, Any], number: int) -> None:
    """By name, by number, or the same where nothing else is said."""
    assert target_port({"spec": {"ports": [port]}}, POD) == number


class Empty:
    """A cluster that has nothing, not even revisions of a stack."""

    def list(self, *words: object, **chosen: object) -> list[object]:
        del words, chosen
        return []


def test_a_part_that_was_not_deployed_is_told() -> None:
    """With the key that would deploy it."""
    ports = {"loki": {"spec": {"ports": [{"port": 3100}]}}}
    stack = InstalledStack(Empty(), "monitoring", ports)  # type: ignore[arg-type]
    assert stack.part("loki").port == 3100
    with pytest.raises(NoStack, match="in monitoring has no Grafana") as caught:
        stack.part("grafana")
    assert "grafana: {enabled: true}" in str(caught.value.hint)


@pytest.mark.parametrize(
    ("url", "namespace", "port", "prefix"),
    [
        ("http://loki.logging:3100", "logging", 3100, ""),
        ("http://loki.logging.svc.cluster.local/", "logging", 80, ""),
        ("http://loki.logging.svc:3100/logs/", "logging", 3100, "logs/"),
    ],
)
def test_what_was_there_before_is_asked_where_it_is_a_service(
    url: str, namespace: str, port: int, prefix: str
) -> None:
    """As the job's `existing` names it, which pods would resolve the same way."""
    options = Observability(existing=Existing(loki=ExistingLoki(url=url)))
    part = choose_service(None, "loki", options)  # type: ignore[arg-type]
    assert (part.name, part.namespace, part.port, part.prefix) == ("loki", namespace, port, prefix)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"url": "https://logs.example.org"}, "not a Service"),
        ({"url": "http://logs.example.org"}, "not a Service"),
        ({"url": "http://loki.logging:3100", "tenant": "lab"}, "needs a tenant"),
    ],
)
def test_what_the_api_server_cannot_pass_on_is_told(more: dict[str, str], words: str) -> None:
    """It has reasons of its own not to be asked."""
    options = Observability(existing=Existing(loki=ExistingLoki(**more)))  # type: ignore[arg-type]
    with pytest.raises(NoStack, match=words):
        choose_service(None, "loki", options)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("status", "words"),
    [(403, "you may not ask Loki"), (503, "Loki is not ready"), (400, "Loki refuses: cannot ask")],
)
def test_why_a_part_is_not_asked_is_told_in_few_words(status: int, words: str) -> None:
    """What is refused, what is not ready, and what it says itself."""
    error = refusal(
        status, b'{"message": "parse error"}', "ask Service m/loki", context="c", server="s"
    )
    assert explain("Loki", error).startswith(words)


def test_only_what_asks_for_the_past_asks_for_a_stack() -> None:
    """A plain `rigel logs` stays as quick as it was; the life before is the API server's alone."""
    assert not LogOptions(follow=True, tail=5).of_the_past
    assert not LogOptions(since=60, previous=True).of_the_past
    assert LogOptions(since=60).of_the_past
    assert LogOptions(level="warn").of_the_past


def test_a_log_is_read_on_from_where_it_was_read() -> None:
    """From some seconds before, for a line may be written down late; what was read is left out."""
    edge = Edge()
    second = 1_000_000_000
    read = [(7 * second + 5, "a"), (8 * second + 1, "b"), (8 * second, "c"), (8 * second + 2, "a")]
    assert all(edge.is_new(*line) for line in read)
    assert edge.since == 6 * second
    again = [*read, (8 * second + 2, "b"), (7 * second + 999, "late"), (30 * second, "a")]
    assert [edge.is_new(*line) for line in again] == [*[False] * 4, True, True, True]
    assert len(edge.known) == 1, "no more is remembered than may come again"
