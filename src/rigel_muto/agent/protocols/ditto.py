"""Commands of Muto's ROS 2 generation: live messages in Ditto's protocol, on one MQTT topic.

The topic in the message is NAMESPACE/NAME/things/live/messages/SUBJECT, where SUBJECT is
stack/commands/METHOD or agent/commands/QUERY. Answers are sent to the header `reply-to`, as the
same message with /outbox in its path. A failure is reported as an error of Ditto.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import attrs

from rigel_muto.agent.commands import (
    Arrival,
    Asks,
    Message,
    Outcome,
    Query,
    Refusal,
    Reply,
    Result,
    Stage,
    States,
)
from rigel_muto.agent.payloads import (
    Malformed,
    check_object,
    flag_at,
    identify,
    is_topic,
    object_at,
    read_command,
    read_object,
    read_query,
    text_at,
    write_json,
)

LIVE = "live/messages/"
ERRORS = "twin/errors"
#: The header of messages whose senders want errors only.
REQUIRED = "response-required"
#: Ditto's names of errors, by our kinds of refusals; all others are UNSUPPORTED.
NAMES = {"malformed": "things:topic.malformed", "too-large": "things:topic.malformed"}
UNSUPPORTED = "things:ditto.unsupported"


@attrs.frozen
class Ditto:
    """The protocol for one device.

    Attributes:
        thing: its id, NAMESPACE:NAME.
        prefix: what stands before it in the MQTT topic.
    """

    thing: str
    prefix: str = "muto"

    @property
    def topic(self) -> str:
        """The one MQTT topic of the device."""
        return f"{self.prefix}/{self.thing}"

    @property
    def channel(self) -> str:
        """How the topics inside the device's messages begin."""
        return f"{self.thing.replace(':', '/', 1)}/things/"

    def hears(self, topic: str) -> bool:
        """Return whether it is the device's topic."""
        return topic == self.topic

    def read(self, arrival: Arrival) -> DittoRequest | None:
        """Return a message's request; None for answers and errors, which no one must answer."""
        envelope: Mapping[str, Any] = {}
        try:
            envelope = read_object(arrival.payload)
            if _is_answer(envelope):
                return None
            asks = self._read(envelope, arrival)
        except Malformed as error:
            asks = error.refusal
        return DittoRequest(asks, envelope, self)

    def _read(self, envelope: Mapping[str, Any], arrival: Arrival) -> Asks:
        headers = object_at(envelope, "headers")
        reply_to = text_at(headers, "reply-to")
        if reply_to and not is_topic(reply_to):
            raise Malformed(f'no answer can be published on the topic "{reply_to[:100]}"')
        correlation = text_at(headers, "correlation-id")
        flag_at(headers, REQUIRED, default=True)
        area, kind = self._read_subject(envelope)
        if area == "agent" and kind == "ping":
            return Query("ping")  # its value is sent back as it is
        content = check_object(envelope.get("value"), '"value"')
        if area == "stack":
            identity = identify(correlation, arrival.topic, arrival.payload)
            return read_command(kind, content, identity)
        return read_query(kind, content)

    def _read_subject(self, envelope: Mapping[str, Any]) -> tuple[str, str]:
        """Return the two parts of the subject: stack or agent, and the command."""
        topic, path = text_at(envelope, "topic"), text_at(envelope, "path")
        if "/things/" not in topic:
            raise Malformed(f'"topic" must be {self.channel}{LIVE}SUBJECT, got "{topic[:100]}"')
        if not topic.startswith(self.channel):
            raise Malformed(f'this is for another thing than "{self.thing}"', "unsupported")
        subject = topic.removeprefix(self.channel)
        area, _, kind = subject.removeprefix(LIVE).partition("/commands/")
        if not subject.startswith(LIVE) or area not in ("stack", "agent"):
            message = f'"{subject[:100]}" is not supported: expected {LIVE}stack/commands/start'
            raise Malformed(message, "unsupported")
        if not path.startswith("/inbox"):
            raise Malformed(f'"path" must begin with /inbox, got "{path[:100]}"')
        return area, kind


def _is_answer(envelope: Mapping[str, Any]) -> bool:
    return str(envelope.get("path")).startswith("/outbox") or str(envelope.get("topic")).endswith(
        f"/things/{ERRORS}"
    )


@attrs.frozen
class DittoRequest:
    """A message on the device's topic.

    Attributes:
        envelope: the message as it came; empty if it is not JSON.
    """

    asks: Asks
    envelope: Mapping[str, Any]
    protocol: Ditto

    def answer(self, reply: Reply) -> tuple[Message, ...]:
        """Return the answer, or the error of Ditto."""
        if isinstance(reply, States):
            raise TypeError("Ditto's protocol has no inventory")
        if isinstance(reply, Outcome) and not reply.succeeded:
            return (self._fail(reply),)
        if not self._reply_to or not flag_at(self._headers, REQUIRED, default=True):
            return ()
        path = self.envelope["path"].replace("/inbox", "/outbox", 1)
        answer = {**self.envelope, "path": path, "value": self._choose_value(reply)}
        return (self._write(self._reply_to, answer),)

    def _choose_value(self, reply: Outcome | Result) -> Any:
        if self.asks == Query("ping"):
            return self.envelope.get("value")
        if isinstance(reply, Result):
            return reply.value
        return {"result": "success", "state": reply.stage.value, "message": reply.text}

    def _fail(self, outcome: Outcome) -> Message:
        """Return the error: to the place for answers, or on the device's topic, as Muto does."""
        kind = self.asks.kind if isinstance(self.asks, Refusal) else ""
        status = 400 if outcome.stage is Stage.REFUSED else 500
        value = {
            "status": status,
            "error": NAMES.get(kind, UNSUPPORTED),
            "message": outcome.text,
            "description": f"The command was not carried out: {outcome.stage.value}.",
        }
        envelope = {
            "topic": f"{self.protocol.channel}{ERRORS}",
            "headers": {"correlation-id": self._correlation},
            "path": "/",
            "value": value,
            "status": status,
        }
        return self._write(self._reply_to or self.protocol.topic, envelope)

    def _write(self, topic: str, envelope: Mapping[str, Any]) -> Message:
        correlation = self._correlation.encode("utf-8") or None
        return Message(topic, write_json(envelope).encode(), correlation)

    @property
    def _headers(self) -> Mapping[str, Any]:
        headers = self.envelope.get("headers")
        return headers if isinstance(headers, dict) else {}

    @property
    def _reply_to(self) -> str:
        """The topic for answers, "" if no usable one is given."""
        topic = self._headers.get("reply-to")
        return topic if isinstance(topic, str) and is_topic(topic) else ""

    @property
    def _correlation(self) -> str:
        """The header, "" if it is not text."""
        try:
            return text_at(self._headers, "correlation-id")
        except Malformed:
            return ""
