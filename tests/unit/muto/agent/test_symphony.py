"""Requests of Symphony's provider for targets behind MQTT, encoded as Go does it."""

from __future__ import annotations

import base64
import gzip
import json
from typing import Any

import pytest

from rigel_k8s.rigelfile.source import Source
from rigel_muto.agent.commands import ComponentState, Deploy, Kill, Outcome, Stage
from rigel_muto.agent.protocols.symphony import Symphony
from rigel_muto.agent.wanted import join
from rigel_muto.formats import list_stacks
from rigel_muto.reading import read
from tests.support.recorder import Recorder

from .recording import STACK, Remembering, give

SYMPHONY = Symphony("robot-7", "fleet")
REQUESTS, RESPONSES = "fleet/coa-request", "fleet/coa-response"
TEXT = json.dumps(STACK)
REMOVED = object()


def pack(value: Any) -> str:
    """Return what Go writes for bytes: base64."""
    data = value if isinstance(value, bytes) else json.dumps(value).encode()
    return base64.b64encode(data).decode()


def component(name: str = "talking", **properties: Any) -> dict[str, Any]:
    """Return a ComponentSpec; Go leaves out what is empty."""
    return {
        "name": name,
        "type": "muto-agent",
        "properties": {
            "type": "stack",
            "content-type": "application/vnd.eclipse.muto.stack+json",
            "data": pack(STACK),
            **properties,
        },
    }


def deploy(*components: Any, **changed: Any) -> dict[str, Any]:
    """Return a DeploymentSpec."""
    solution = {"metadata": {"name": "demo-v-1"}, "spec": {"components": list(components)}}
    deployment = {
        "solutionName": "demo:1",
        "solution": solution,
        "instance": {"metadata": {"name": "demo"}, "spec": {"solution": "demo:1"}},
        "targets": {"robot-7": {"metadata": {"name": "robot-7"}, "spec": {}}},
        "assignments": {"robot-7": "{talking}"},
        "componentEndIndex": len(components),
        "activeTarget": "robot-7",
        "isDryRun": False,
        "isInActive": False,
        "generation": "1",
    } | changed
    return {key: value for key, value in deployment.items() if value is not REMOVED}


def write(method: str, deployment: Any, **changed: Any) -> dict[str, Any]:
    """Return a COARequest."""
    request = {
        "method": method,
        "route": "instances",
        "contentType": "",
        "body": pack(deployment),
        "metadata": {"active-target": "robot-7", "request-id": "r-1"},
    } | changed
    return {key: value for key, value in request.items() if value is not REMOVED}


def ask(executor: Remembering, request: Any) -> tuple[int, Any]:
    """Return state and body of the one response, which must have what Go looks at."""
    [(topic, response)] = give(SYMPHONY, executor, REQUESTS, request)
    assert topic == RESPONSES
    assert response["metadata"] == {"request-id": "r-1"}
    assert response["contentType"] == "application/json"
    return response["state"], json.loads(base64.b64decode(response["body"], validate=True))


@pytest.mark.parametrize(
    "data", [pack(STACK), pack(gzip.compress(TEXT.encode())), STACK], ids=["text", "gzip", "object"]
)
def test_an_apply_deploys_its_components(data: Any) -> None:
    """It is answered as soon as they are stored."""
    executor = Remembering()
    state, summary = ask(executor, write("POST", deploy(component(data=data))))
    assert executor.commands == [Deploy(identity="r-1", components={"talking": TEXT})]
    assert (state, summary["successCount"], summary["isRemoval"]) == (200, 1, False)
    assert summary["targets"]["robot-7"]["components"]["talking"]["status"] == 8004
    assert summary["allAssignedDeployed"] is False


def test_symphonys_head_calls_a_solution_a_version() -> None:
    executor = Remembering()
    deployment = deploy(component())
    deployment["solutionversion"] = deployment.pop("solution")
    ask(executor, write("POST", deployment))
    assert executor.commands == [Deploy(identity="r-1", components={"talking": TEXT})]


@pytest.mark.parametrize("carried", ["metadata", "body"])
def test_a_removal_names_what_to_remove(carried: str) -> None:
    """The deletion of an Apply carries its target in the body only."""
    executor = Remembering()
    metadata = {"request-id": "r-1"}
    if carried == "metadata":
        metadata["active-target"] = "robot-7"
    request = write("DELETE", deploy(component("a"), component("b", data=0)), metadata=metadata)
    state, summary = ask(executor, request)
    assert executor.commands == [Kill(identity="r-1", components=("a", "b"))]
    assert (state, summary["isRemoval"]) == (200, True)
    assert {one["status"] for one in summary["targets"]["robot-7"]["components"].values()} == {8005}


@pytest.mark.parametrize(
    ("start", "end", "names"),
    [
        (REMOVED, REMOVED, ["a", "b", "c"]),
        (REMOVED, 1, ["a"]),
        (1, 3, ["b", "c"]),
        (2, 1, ["a", "b", "c"]),
    ],
)
def test_indexes_choose_components(start: Any, end: Any, names: list[str]) -> None:
    """Go leaves out an index that is 0."""
    executor = Remembering()
    listed = [component(name) for name in "abc"]
    deployment = deploy(*listed, componentStartIndex=start, componentEndIndex=end)
    ask(executor, write("POST", deployment))
    assert [list(command.components) for command in executor.commands] == [names]


def test_an_inventory_has_what_is_ready_and_as_symphony_wants_it() -> None:
    """What is missing there Symphony applies again."""
    executor = Remembering()
    listed = [
        component("a"),
        component("b"),
        component("c"),
        component("d"),
        component("e", type="x"),
    ]
    executor.states = {
        "a": ComponentState(TEXT, ready=True),
        "b": ComponentState(TEXT, ready=False),
        "c": ComponentState('{"node": []}', ready=True),
    }
    assert ask(executor, write("GET", deploy(*listed))) == (200, [listed[0]])
    assert ask(executor, write("GET", deploy())) == (200, [])
    assert not executor.commands


@pytest.mark.parametrize(
    "request_",
    [
        write(
            "POST", deploy(component()), metadata={"request-id": "r", "active-target": "robot-8"}
        ),
        write("POST", deploy(component(), activeTarget="robot-8"), metadata={"request-id": "r"}),
        write("POST", deploy(component()), metadata={"active-target": "robot-7"}),
        write("POST", deploy(component()), metadata={"request-id": 5}),
        write("POST", deploy(component()), metadata="r"),
        write("POST", deploy(component()), metadata=REMOVED),
        b"{",
        b"",
        [1],
    ],
    ids=str,
)
def test_other_targets_and_who_cannot_be_answered_are_ignored(request_: Any) -> None:
    """All targets of a prefix share the topics."""
    executor = Remembering()
    assert give(SYMPHONY, executor, REQUESTS, request_) == []
    assert not executor.commands


@pytest.mark.parametrize(
    ("request_", "error"),
    [
        (write("PUT", deploy(component())), "unknown method"),
        (write(REMOVED, deploy(component())), "unknown method"),  # type: ignore[arg-type]
        (write("POST", deploy(component()), route="needsupdate"), "unknown route"),
        (write("POST", 0, body=REMOVED), "is not JSON"),
        (write("POST", 0, body="%%"), "is not base64"),
        (write("POST", b"{"), "the body is not JSON"),
        (write("POST", [1]), "the body must be an object"),
        (
            write(
                "POST", deploy(component(), activeTarget=REMOVED), metadata={"request-id": "r-1"}
            ),
            "names a target",
        ),
        (write("POST", deploy(solution=REMOVED)), "no component"),
        (write("POST", deploy(component(), solution={"spec": {"components": {}}})), '"components"'),
        (write("POST", deploy(component(name=""))), "name of its own"),
        (write("POST", deploy(component(), component())), "name of its own"),
        (write("POST", deploy(*(component(str(n)) for n in range(51)))), "more than 50"),
        (write("POST", deploy(component(), componentStartIndex=-1)), "whole number"),
        (write("POST", deploy(component(), componentStartIndex="0")), "whole number"),
        (write("POST", deploy(component(), componentEndIndex=True)), "whole number"),
        (write("POST", deploy(component(), componentEndIndex=2)), "componentEndIndex is 2"),
        (write("POST", deploy(component(), isDryRun=True)), "dry runs"),
        (write("POST", deploy()), "no component"),
        (write("DELETE", deploy()), "no component"),
        (write("POST", deploy(component(type="helm"))), "no component"),
        (write("POST", deploy(component(method="kill"))), 'requests "kill"'),
        (write("POST", deploy(component(method="apply", action="kill"))), 'requests "kill"'),
        (write("POST", deploy(component(data=None))), "base64 or an object"),
        (write("POST", deploy(component(data="%%"))), "not base64"),
        (write("POST", deploy(component(data=pack(b"\x1f\x8bx")))), "ends too early"),
        (write("POST", deploy(component(data=pack(gzip.compress(b" " * 2**23))))), "more than"),
        (write("POST", deploy(component(data=pack(b"\xff")))), "neither a text"),
        (write("POST", deploy(component(data=pack(b"{")))), "this is not YAML"),
        (write("POST", deploy(component(data=pack({"a": 1})))), "not a stack"),
        (
            write("POST", deploy(component(data=pack({"spec": {"components": []}})))),
            "cannot be a solution",
        ),
        (write("POST", deploy(component(data=[1]))), "base64 or an object"),
        (write("POST", deploy(component(data=pack({"artifact": {"data": "x"}})))), "archive"),
        (write("POST", deploy(component("a"), component("b", data="%%"))), "not base64"),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_what_is_wrong_is_answered_and_nothing_else_happens(request_: Any, error: str) -> None:
    """Values of a wrong type, in any field, are in test_fields.py."""
    executor = Remembering()
    state, body = ask(executor, request_)
    assert (state, error in body["error"]) == (400, True), body
    assert not executor.commands


@pytest.mark.parametrize(
    ("stage", "state"),
    [(Stage.REFUSED, 400), (Stage.FAILED, 500), (Stage.SUPERSEDED, 500), (Stage.DONE, 200)],
)
def test_the_state_says_what_has_become_of_it(stage: Stage, state: int) -> None:
    executor = Remembering(lambda _: Outcome(stage, "so"))
    got, body = ask(executor, write("POST", deploy(component())))
    assert (got, body.get("error", "so")) == (state, "so")


def test_an_error_of_the_agent_is_an_answer_too() -> None:
    """Symphony would wait for 8 s otherwise."""

    def fail(_: object) -> Outcome:
        raise KeyError("a defect")

    reporter = Recorder()
    [(_, response)] = give(
        SYMPHONY, Remembering(fail), REQUESTS, write("POST", deploy(component())), reporter
    )
    assert response["state"] == 500
    assert "KeyError" in reporter.warnings[0]


def test_components_are_joined_to_one_stack() -> None:
    """All that are there are one release."""
    text = join({"a": TEXT, "b": json.dumps({"node": [{"name": "b"}]})})
    [solution] = list_stacks(read(Source("joined", text)))
    assert [part.nodes[0].value["name"].value for part in solution.parts] == ["talker", "b"]


def test_topics_can_have_no_prefix() -> None:
    assert (Symphony("t", "").topic, Symphony("t", "").answers) == ("coa-request", "coa-response")
