"""Requests of Eclipse Symphony's provider for targets behind MQTT.

All targets of one prefix share two topics, so requests name their target. Symphony waits for an
answer for 8 s: it reports what is stored. Symphony finds out by GET whether that is ready; GET
lists only components that are ready and as Symphony needs them.
"""

from __future__ import annotations

import base64
import binascii
from collections.abc import Mapping, Sequence
from typing import Any

import attrs

from rigel_muto.agent.commands import (
    Arrival,
    Asks,
    ComponentState,
    Deploy,
    Inventory,
    Kill,
    Message,
    Outcome,
    Reply,
    Stage,
    States,
)
from rigel_muto.agent.payloads import (
    Malformed,
    check_object,
    flag_at,
    object_at,
    read_component,
    read_json,
    read_object,
    text_at,
    write_json,
)
from rigel_muto.formats import MOST_COMPONENTS

#: Symphony's codes for components.
UPDATED, DELETED = 8004, 8005
#: Its codes for requests. If a code is not OK, Symphony reports the body as the reason.
OK, REFUSED, FAILED = 200, 400, 500


@attrs.frozen
class Symphony:
    """The protocol for one target.

    Attributes:
        target: its name in Symphony.
        prefix: what stands before both topics; "" for none.
    """

    target: str
    prefix: str = "muto"

    @property
    def topic(self) -> str:
        return self._topic_of("coa-request")

    @property
    def answers(self) -> str:
        return self._topic_of("coa-response")

    def _topic_of(self, name: str) -> str:
        return f"{self.prefix}/{name}" if self.prefix else name

    def hears(self, topic: str) -> bool:
        return topic == self.topic

    def read(self, arrival: Arrival) -> SymphonyRequest | None:
        """Return a message's request; None for other targets, and if no answer is possible."""
        try:
            request = read_object(arrival.payload)
            metadata = object_at(request, "metadata")
            identity = text_at(metadata, "request-id")
        except Malformed:
            return None
        if not identity:
            return None
        try:
            return self._read(request, metadata, identity)
        except Malformed as error:
            return SymphonyRequest(error.refusal, identity, self)

    def _read(
        self, request: Mapping[str, Any], metadata: Mapping[str, Any], identity: str
    ) -> SymphonyRequest | None:
        target = text_at(metadata, "active-target")
        if target not in ("", self.target):
            return None
        deployment = check_object(_read_body(request), "the body")
        target = target or text_at(deployment, "activeTarget")
        if target not in ("", self.target):
            return None
        if not target:
            raise Malformed("neither active-target nor activeTarget names a target")
        route = text_at(request, "route")
        if route != "instances":
            raise Malformed(f'unknown route "{route[:100]}": expected instances', "unsupported")
        components = _list_stacks(deployment)
        asks = _read_method(text_at(request, "method"), deployment, components, identity)
        return SymphonyRequest(asks, identity, self, components)


def _read_body(request: Mapping[str, Any]) -> Any:
    try:
        content = base64.b64decode(text_at(request, "body"), validate=True)
    except (binascii.Error, ValueError) as error:
        raise Malformed(f"the body is not base64: {error}") from error
    return read_json(content, "the body")


def _list_stacks(deployment: Mapping[str, Any]) -> tuple[Mapping[str, Any], ...]:
    """Return the components of a deployment that are stacks and that this request is about."""
    solution = object_at(deployment, "solutionversion") or object_at(deployment, "solution")
    listed = object_at(solution, "spec").get("components")
    listed = [] if listed is None else listed  # Go's nil
    if not isinstance(listed, list):
        raise Malformed('"components" must be a list')
    start, end = (_read_index(deployment, f"component{edge}Index") for edge in ("Start", "End"))
    if end > start:
        if end > len(listed):
            raise Malformed(f"componentEndIndex is {end}, and there are {len(listed)} components")
        listed = listed[start:end]
    if len(listed) > MOST_COMPONENTS:
        raise Malformed(f"there are more than {MOST_COMPONENTS} components", "too-large")
    components = [check_object(item, "a component") for item in listed]
    names = [text_at(item, "name") for item in components]
    if "" in names or len(set(names)) < len(names):
        raise Malformed("each component must have a name of its own")
    return tuple(item for item in components if _is_stack(item))


def _read_index(deployment: Mapping[str, Any], key: str) -> int:
    """Return an index; Go leaves out those that are 0."""
    value = deployment.get(key, 0)
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise Malformed(f'"{key}" must be a whole number, got {write_json(value)[:100]}')
    return value


def _is_stack(component: Mapping[str, Any]) -> bool:
    return text_at(object_at(component, "properties"), "type") == "stack"


def _read_method(
    method: str,
    deployment: Mapping[str, Any],
    components: Sequence[Mapping[str, Any]],
    identity: str,
) -> Asks:
    names = tuple(component["name"] for component in components)
    if method == "GET":
        return Inventory(names)
    if method not in ("POST", "DELETE"):
        raise Malformed(
            f'unknown method "{method[:100]}": expected GET, POST or DELETE', "unsupported"
        )
    if flag_at(deployment, "isDryRun", default=False):
        raise Malformed("dry runs are not supported", "unsupported")
    if not components:
        raise Malformed("no component of this solution is a stack", "not-a-stack")
    if method == "DELETE":
        return Kill(identity=identity, components=names)
    for component in components:
        _check_action(component)
    texts = {component["name"]: read_component(component) for component in components}
    return Deploy(identity=identity, components=texts)


def _check_action(component: Mapping[str, Any]) -> None:
    """Refuse components that request another action than to be deployed."""
    properties = object_at(component, "properties")
    for action in (text_at(properties, "method"), text_at(properties, "action")):
        if action not in ("", "start", "apply"):
            name = component["name"]
            message = f'the component "{name}" requests "{action[:100]}": expected apply'
            raise Malformed(message, "unsupported")


@attrs.frozen
class SymphonyRequest:
    """A request for this target.

    Attributes:
        identity: Symphony's request-id.
        components: those that it is about.
    """

    asks: Asks
    identity: str
    protocol: Symphony
    components: tuple[Mapping[str, Any], ...] = ()

    def answer(self, reply: Reply) -> tuple[Message, ...]:
        if isinstance(reply, States):
            body = [c for c in self.components if _is_there(c, reply.components.get(c["name"]))]
            return (self._respond(OK, body),)
        if not isinstance(reply, Outcome):
            raise TypeError("Symphony asks no queries")
        if not reply.succeeded:
            state = REFUSED if reply.stage is Stage.REFUSED else FAILED
            return (self._respond(state, {"error": reply.text}),)
        return (self._respond(OK, self._summarize(reply)),)

    def _summarize(self, outcome: Outcome) -> Mapping[str, Any]:
        """Return Symphony's SummarySpec of a command that was accepted."""
        removal, count = isinstance(self.asks, Kill), len(self.components)
        status = {"status": DELETED if removal else UPDATED, "message": outcome.text}
        target = {
            "status": "OK",
            "message": outcome.text,
            "components": {component["name"]: status for component in self.components},
        }
        return {
            "targetCount": 1,
            "successCount": 1,
            "plannedDeployment": count,
            "currentDeployed": count,
            "targets": {self.protocol.target: target},
            "message": outcome.text,
            "skipped": False,
            "isRemoval": removal,
            "allAssignedDeployed": outcome.stage is Stage.DONE,
            "removed": removal and outcome.stage is Stage.DONE,
        }

    def _respond(self, state: int, body: Any) -> Message:
        response = {
            "contentType": "application/json",
            "body": base64.b64encode(write_json(body).encode()).decode(),
            "state": state,
            "metadata": {"request-id": self.identity},
        }
        return Message(self.protocol.answers, write_json(response).encode())


def _is_there(component: Mapping[str, Any], state: ComponentState | None) -> bool:
    """Return whether a component is ready, and deployed from the text that Symphony has."""
    if state is None or not state.ready:
        return False
    try:
        return read_component(component) == state.stack
    except Malformed:
        return False
