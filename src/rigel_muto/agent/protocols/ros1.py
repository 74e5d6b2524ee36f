"""Commands of Muto's ROS 1 generation: the MQTT topic names the command.

THING/stack/commands/METHOD   start, apply or kill; the payload is a stack or names one
THING/agent/commands/QUERY    a question about the ROS graph

Answers are sent to MQTT 5's ResponseTopic. The result of a query is sent to `target.topic` in the
payload, if it has one, after a first answer "Started".
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs

from rigel_muto.agent.commands import (
    Arrival,
    Asks,
    Message,
    Refusal,
    Reply,
    Result,
    States,
)
from rigel_muto.agent.payloads import (
    Malformed,
    identify,
    is_topic,
    object_at,
    read_command,
    read_object,
    read_query,
    text_at,
    write_json,
)

#: What is on the device's other topics; Muto answers it with this text.
NO_COMMAND = Refusal("unknown-command", "None")


@attrs.frozen
class Place:
    """Where to send an answer."""

    topic: str
    correlation: bytes | None

    def write(self, value: Any) -> Message:
        return Message(self.topic, write_json(value).encode(), self.correlation)


@attrs.frozen
class Ros1:
    """The protocol for one device.

    Attributes:
        thing: its id, NAMESPACE:NAME.
    """

    thing: str

    @property
    def topic(self) -> str:
        return f"{self.thing}/#"

    def hears(self, topic: str) -> bool:
        """Return whether a topic is the device's."""
        return topic.startswith(f"{self.thing}/")

    def read(self, arrival: Arrival) -> Ros1Request:
        place = _find_place(arrival)
        area, _, rest = arrival.topic.removeprefix(f"{self.thing}/").partition("/commands/")
        if area not in ("stack", "agent"):
            return Ros1Request(NO_COMMAND, arrival.topic, place, None)
        target = None
        try:
            content = read_object(arrival.payload)
            target = _read_target(content)
            values = {key: value for key, value in content.items() if key != "target"}
            if area == "stack":
                asks: Asks = read_command(rest, values, _identify(arrival, target))
            else:
                asks = read_query(rest, values)
        except Malformed as error:
            asks = error.refusal
        return Ros1Request(asks, arrival.topic, place, target)


def _find_place(arrival: Arrival) -> Place | None:
    if arrival.response_topic is None or not is_topic(arrival.response_topic):
        return None
    return Place(arrival.response_topic, arrival.correlation)


def _read_target(content: Mapping[str, Any]) -> Place | None:
    """Return the place that the payload itself gives for the answer. Raises Malformed."""
    target = object_at(content, "target")
    topic, correlation = text_at(target, "topic"), text_at(target, "correlation")
    if not topic:
        return None
    if not is_topic(topic):
        raise Malformed(f'no answer can be published on the topic "{topic[:100]}" of "target"')
    return Place(topic, correlation.encode("utf-8") or None)


def _identify(arrival: Arrival, target: Place | None) -> str:
    correlation = arrival.correlation or (target and target.correlation) or b""
    return identify(correlation.hex(), arrival.topic, arrival.payload)


@attrs.frozen
class Ros1Request:
    """A message on one of the device's topics.

    Attributes:
        place: where MQTT's properties request the answer.
        target: where the payload requests it.
    """

    asks: Asks
    topic: str
    place: Place | None
    target: Place | None

    def answer(self, reply: Reply) -> tuple[Message, ...]:
        """Return the answers: of a query two, if there are two places for them."""
        first, last = self.place or self.target, self.target or self.place
        if first is None or last is None:
            return ()
        if self.asks == NO_COMMAND:
            return (Message(first.topic, NO_COMMAND.message.encode(), first.correlation),)
        if isinstance(reply, Result):
            result = last.write(reply.value)
            return (result,) if first == last else (first.write({"status": "Started"}), result)
        if isinstance(reply, States):
            raise TypeError("Muto's ROS 1 generation has no inventory")
        if not reply.succeeded:
            return (first.write({"status": "EXCEPTION", "error": reply.text}),)
        state = {"state": reply.stage.value, "message": reply.text}
        return (first.write({"result": "success", "command": self.topic, **state}),)
