"""The requests that a cluster gets: what kube/ promises in words, seen where it arrives."""

from __future__ import annotations

from typing import Any

import pytest

from rigel_k8s.errors import ClusterError, ConflictError, NotFoundError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.store import ANYTHING, NOTHING, Onto, this_object, this_state
from rigel_k8s.objects.refs import ObjectRef
from tests.support.http_server import Exchange, HttpServer, Request

from .conftest import MANIFEST, REF

PATH = "/api/v1/namespaces/robot/configmaps"


def answer_with(body: object, status: int = 200) -> Any:
    return lambda exchange: exchange.say(status, body)


@pytest.fixture
def cluster(serve: Any) -> tuple[Cluster, HttpServer]:
    """A cluster that says yes to everything."""
    started: tuple[Cluster, HttpServer] = serve(answer_with(MANIFEST))
    return started


def asked(server: HttpServer) -> Request:
    """Return the one request."""
    [request] = server.requests
    return request


# Writing.

WRITES = {
    "apply": lambda cluster, **more: cluster.apply(MANIFEST, **more),
    "create": lambda cluster, **more: cluster.create(MANIFEST, **more),
    "replace": lambda cluster, **more: cluster.replace(MANIFEST, **more),
    "patch": lambda cluster, **more: cluster.patch(REF, {"data": {"a": "1"}}, **more),
}


@pytest.mark.parametrize("write", WRITES)
def test_a_write_is_ours(cluster: Any, write: str) -> None:
    """Every write names us as the fields' manager."""
    client, server = cluster
    assert WRITES[write](client) == MANIFEST
    assert asked(server).query == {"fieldManager": ["rigel"]}


@pytest.mark.parametrize("write", ["apply", "create"])
def test_a_dry_run_writes_nothing(cluster: Any, write: str) -> None:
    """The request has `dryRun=All`, which makes the API server store nothing."""
    client, server = cluster
    WRITES[write](client, dry_run=True)
    assert asked(server).query == {"fieldManager": ["rigel"], "dryRun": ["All"]}


@pytest.mark.parametrize(
    ("write", "method", "path", "media"),
    [
        ("apply", "PATCH", f"{PATH}/c", "application/apply-patch+yaml"),
        ("create", "POST", PATH, "application/json"),
        ("replace", "PUT", f"{PATH}/c", "application/json"),
        ("patch", "PATCH", f"{PATH}/c", "application/merge-patch+json"),
    ],
)
def test_a_write_goes_to_its_object(
    cluster: Any, write: str, method: str, path: str, media: str
) -> None:
    """Method, path, media type and body as Kubernetes wants them."""
    WRITES[write](cluster[0])
    request = asked(cluster[1])
    assert (str(request), request.headers["Content-Type"]) == (f"{method} {path}", media)
    assert request.json == ({"data": {"a": "1"}} if write == "patch" else MANIFEST)


def test_fields_of_others_are_taken_over_only_when_asked(cluster: Any) -> None:
    """`force` is said where the caller says it."""
    client, server = cluster
    client.apply(MANIFEST, force=True)
    assert asked(server).query == {"fieldManager": ["rigel"], "force": ["true"]}


@pytest.mark.parametrize(
    ("owners", "sent"),
    [(["rigel"], ["", "true"]), (["rigel", "kubectl"], [""]), ([], [""])],
)
def test_what_we_have_patched_ourselves_is_no_conflict(
    serve: Any, owners: list[str], sent: list[str]
) -> None:
    """Kubernetes records a patch and an apply of one program as if two had made them."""
    told = 'conflict with "{}" using apps/v1'
    causes = [
        {"reason": "FieldManagerConflict", "message": told.format(name), "field": ".spec.x"}
        for name in owners
    ]

    def answer(exchange: Any) -> None:
        if exchange.request_.query.get("force"):
            answer_with(MANIFEST)(exchange)
        else:
            answer_with({"reason": "Conflict", "details": {"causes": causes}}, 409)(exchange)

    client, server = serve(answer)
    if len(sent) > 1:
        assert client.apply(MANIFEST, dry_run=True) == MANIFEST
    else:
        with pytest.raises(ConflictError):
            client.apply(MANIFEST, dry_run=True)
    asked = [one.query for one in server.requests]
    assert [query.get("force", [""])[0] for query in asked] == sent
    assert all(query["dryRun"] == ["All"] for query in asked)


def test_a_patch_says_its_style_and_subresource(cluster: Any) -> None:
    """The server would read one as another."""
    client, server = cluster
    client.patch(REF, {}, style="strategic", subresource="status")
    assert asked(server).path == f"{PATH}/c/status"
    assert asked(server).headers["Content-Type"] == "application/strategic-merge-patch+json"


UID = {"reason": "FieldValueInvalid", "message": "field is immutable", "field": "metadata.uid"}
OTHER = {**UID, "field": "spec.selector"}


@pytest.mark.parametrize(("cause", "kind"), [(UID, ConflictError), (OTHER, ClusterError)])
def test_an_apply_onto_another_object_is_a_conflict(
    serve: Any, cause: dict[str, str], kind: type[ClusterError]
) -> None:
    """Kubernetes calls another UID invalid; what else is invalid stays so."""
    body = {"kind": "Status", "message": "no", "details": {"causes": [cause]}}
    client, server = serve(answer_with(body, 422))
    live = {"metadata": {"uid": "u-1", "resourceVersion": "7"}}
    with pytest.raises(ClusterError) as caught:
        client.apply(MANIFEST, onto=this_object(live))
    assert isinstance(caught.value, ConflictError) is (kind is ConflictError)
    assert caught.value.status == (409 if kind is ConflictError else 422)
    assert asked(server).json["metadata"] == {**MANIFEST["metadata"], "uid": "u-1"}


def test_an_object_that_changed_is_not_deleted(serve: Any) -> None:
    """Where its state is a condition; it is not tried again."""
    client, server = serve(answer_with({"kind": "Status", "message": "modified"}, 409))
    with pytest.raises(ConflictError):
        client.delete(REF, uid="u-1", version="7")
    assert str(asked(server)) == f"DELETE {PATH}/c"


@pytest.mark.parametrize(
    ("onto", "sent"),
    [
        (ANYTHING, {}),
        (NOTHING, {"resourceVersion": "1"}),
        (
            this_state({"metadata": {"uid": "u-1", "resourceVersion": "7"}}),
            {"uid": "u-1", "resourceVersion": "7"},
        ),
    ],
)
def test_what_an_apply_expects_is_sent(cluster: Any, onto: Onto, sent: dict[str, str]) -> None:
    """The API server compares it together with the write."""
    client, server = cluster
    client.apply(MANIFEST, onto=onto)
    assert asked(server).json["metadata"] == {**MANIFEST["metadata"], **sent}


def test_a_delete_is_of_one_object_by_its_uid(cluster: Any) -> None:
    """The preconditions and the grace period are options of the request."""
    client, server = cluster
    assert client.delete(REF) is True
    client.delete(REF, uid="u-1", version="7", grace_seconds=0)
    plain, whole = server.requests
    options = {
        "kind": "DeleteOptions",
        "apiVersion": "v1",
        "propagationPolicy": "Background",
    }
    assert (str(plain), plain.query) == (f"DELETE {PATH}/c", {})
    assert plain.json == options
    assert whole.json == {
        **options,
        "preconditions": {"uid": "u-1", "resourceVersion": "7"},
        "gracePeriodSeconds": 0,
    }


# Reading.


def test_what_is_not_there_is_none(serve: Any) -> None:
    """No error for an object, nor for a kind that the cluster does not know; a delete tells."""
    client, server = serve(answer_with({"message": "gone"}, 404))
    assert client.get(REF) is None
    assert client.delete(REF) is False
    assert client.list("x.example.com/v1", "Robot") == []
    assert client.serves("x.example.com/v1", "Robot") is False
    assert server.list_requests()[-1] == "GET /apis/x.example.com/v1"
    robot = ObjectRef("x.example.com/v1", "Robot", "n", "r")
    assert client.get(robot) is None
    with pytest.raises(NotFoundError, match=r"no kind Robot of x\.example\.com/v1") as caught:
        client.patch(robot, {})
    assert "CustomResourceDefinition" in (caught.value.hint or "")


def test_a_refusal_is_none_of_that(serve: Any) -> None:
    """Who may not read an object does not know that it is gone."""
    client, _ = serve(answer_with({"message": "no right"}, 403))
    for call in (
        lambda: client.get(REF),
        lambda: client.delete(REF),
        lambda: client.list("v1", "Pod"),
        lambda: client.list("x.example.com/v1", "Robot"),
        lambda: client.create(MANIFEST),
        lambda: list(client.logs("n", "p")),
        lambda: client.get_through_proxy(REF, "x"),
    ):
        with pytest.raises(ClusterError, match="no right"):
            call()


def test_a_list_longer_than_a_page_is_whole(serve: Any) -> None:
    """Each page is asked for with the word that the last one gave; selectors stay."""

    def answer(exchange: Exchange) -> None:
        [number] = exchange.request_.query.get("continue", ["0"])
        page = int(number)
        exchange.say(
            200,
            {
                "metadata": {"continue": str(page + 1) if page < 2 else ""},
                "items": [{"metadata": {"name": f"c{page}"}}],
            },
        )

    client, server = serve(answer)
    found = client.list("v1", "ConfigMap", "robot", labels={"a": "1", "b": "2"}, fields="x=y")
    assert [item["metadata"]["name"] for item in found] == ["c0", "c1", "c2"]
    assert {(item["apiVersion"], item["kind"]) for item in found} == {("v1", "ConfigMap")}
    for request in server.requests:
        assert request.path == PATH
        assert request.query["labelSelector"] == ["a=1,b=2"]
        assert request.query["fieldSelector"] == ["x=y"]
        assert request.query["limit"] == ["500"]


def test_a_list_may_be_of_all_namespaces_and_of_metadata_only(serve: Any) -> None:
    """Which saves the server most of the work."""
    client, server = serve(answer_with({"metadata": {}, "items": []}))
    client.list("v1", "Secret", metadata_only=True)
    client.list("v1", "Node")
    first, second = server.requests
    assert first.path == "/api/v1/secrets"
    assert "as=PartialObjectMetadataList" in first.headers["Accept"]
    assert (second.path, second.headers["Accept"]) == ("/api/v1/nodes", "application/json")


def test_events_are_those_of_the_object_oldest_first(serve: Any) -> None:
    """By its UID: another object of that name had others. Three places may have the time."""
    events = [
        {"metadata": {"name": "c"}, "series": {"lastObservedTime": "2026-01-03T00:00:00.5Z"}},
        {"metadata": {"name": "a"}, "lastTimestamp": "2026-01-01T00:00:00Z"},
        {"metadata": {"name": "b"}, "lastTimestamp": None, "eventTime": "2026-01-02T00:00:00Z"},
    ]
    client, server = serve(answer_with({"metadata": {}, "items": events}))
    found = client.events({"metadata": {"uid": "u-1", "namespace": "robot"}})
    assert [event["metadata"]["name"] for event in found] == ["a", "b", "c"]
    assert asked(server).path == "/api/v1/namespaces/robot/events"
    assert asked(server).query["fieldSelector"] == ["involvedObject.uid=u-1"]


def test_logs_are_lines_of_one_container(serve: Any) -> None:
    """Bytes that are no UTF-8 do not end them; what was not asked for is not said."""

    def answer(exchange: Exchange) -> None:
        exchange.stream(b"one\ntwo \xff\n", b"")

    client, server = serve(answer)
    assert list(client.logs("robot", "talker")) == ["one", "two \ufffd"]
    list(
        client.logs(
            "robot", "talker", "node", follow=True, since_seconds=60, tail=0, previous=True,
            timestamps=True,
        )
    )  # fmt: skip
    plain, whole = server.requests
    assert (plain.path, plain.query) == ("/api/v1/namespaces/robot/pods/talker/log", {})
    assert {key: value for key, [value] in whole.query.items()} == {
        "container": "node",
        "follow": "true",
        "sinceSeconds": "60",
        "tailLines": "0",
        "previous": "true",
        "timestamps": "true",
    }


def test_a_service_is_asked_through_the_server(serve: Any) -> None:
    """With its port; a parameter may be there several times."""
    client, server = serve(answer_with(b"pong"))
    service = ObjectRef("v1", "Service", "robot", "loki")
    query = {"match": ["a", "b c"]}
    assert client.get_through_proxy(service, "loki/api/v1/x", port=3100, query=query) == b"pong"
    request = asked(server)
    assert request.path == "/api/v1/namespaces/robot/services/loki%3A3100/proxy/loki/api/v1/x"
    assert request.query == query


def test_the_version_is_the_servers(serve: Any) -> None:
    """The first thing that `rigel doctor` asks."""
    client, server = serve(answer_with({"gitVersion": "v1.34.4"}))
    assert client.server_version() == "v1.34.4"
    assert asked(server).headers["User-Agent"] == "rigel"
