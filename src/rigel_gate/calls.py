"""The ROS master's API: calls and answers as values, read only as far as they are needed."""

from __future__ import annotations

import re
import xmlrpc.client
from typing import Any, NamedTuple

from rigel_gate.registry import (
    PARAMETER,
    PUBLISHER,
    SERVICE,
    SUBSCRIBER,
    Registration,
    resolve_name,
)

_BLANK = re.compile(rb"\s+|<\?.*?\?>|<!--.*?-->", re.DOTALL)
_CALL = re.compile(rb"<methodCall(?:\s[^<>]*)?>")
_METHOD = re.compile(rb"<methodName\s*>\s*([\w.:/]+)\s*</methodName\s*>")
_OTHER_METHOD = re.compile(rb"</[^<>]*methodName\s*>")
#: Bytes of a call, and of an answer, above which it is read and written in a thread: tiny values
#: take 10 ms there.
LARGE = 2**18
#: The caller's name in the gate's own calls to masters and nodes.
GATE = "/rigel_k8s_gate"
#: What the gate answers itself, for probes and stop hooks of pods and for `rigel`.
DESCRIBE_POD = "rigelDescribePod"
HAND_OVER = "rigelHandOver"
DESCRIBE_GATE = "rigelDescribeGate"


class BadCall(Exception):
    """The request is not an XML-RPC call, or does not have its method's arguments."""


def check(body: bytes) -> None:
    """Raise BadCall for a document that declares types or entities, and for one in UTF-16.

    Python's XML parser expands entities without a limit before Expat 2.4. No ROS client uses them.
    """
    if b"<!DOCTYPE" in body or b"\0" in body:
        raise BadCall("a document type is not accepted")


def _read_tag(pattern: re.Pattern[bytes], body: bytes, at: int) -> re.Match[bytes]:
    """Return the tag that follows next, after any comments; raises BadCall."""
    blank = _BLANK.match(body, at)
    while blank:
        at = blank.end()
        blank = _BLANK.match(body, at)
    found = pattern.match(body, at)
    if not found:
        raise BadCall("it does not begin with a methodName")
    return found


class Call:
    """A call of the master's API.

    Attributes:
        method: its name.
        body: the call as XML.
        is_large: it is read in a thread; so is what is made of its arguments.
    """

    def __init__(
        self,
        method: str,
        params: tuple[Any, ...] | None = None,
        body: bytes | None = None,
        *,
        is_large: bool = False,
    ) -> None:
        self.method = method
        self.is_large = is_large
        self._params: tuple[Any, ...] | BadCall | None = params
        self._body = body

    @classmethod
    def read(cls, body: bytes) -> Call:
        """Return the call that an XML document makes; of a small one only its method is looked at.

        roscore, which reads the same document, must find the same method: of several elements it
        would take the last one.
        """
        check(body)
        found = _read_tag(_METHOD, body, _read_tag(_CALL, body, 0).end())
        if body.find(b"methodName", found.end()) > 0 and _OTHER_METHOD.search(body, found.end()):
            raise BadCall("more than one methodName")
        call = cls(found.group(1).decode(), body=body, is_large=len(body) > LARGE)
        if call.is_large:
            call._read_params()
        return call

    @property
    def params(self) -> tuple[Any, ...]:
        found = self._read_params() if self._params is None else self._params
        if isinstance(found, BadCall):
            raise found
        return found

    def _read_params(self) -> tuple[Any, ...] | BadCall:
        try:
            self._params = xmlrpc.client.loads(self._body or b"")[0]
        except Exception as error:  # expat's errors, and those of malformed values
            self._params = BadCall(str(error))
        return self._params

    @property
    def body(self) -> bytes:
        """The call as XML."""
        if self._body is None:
            text = xmlrpc.client.dumps(self.params, self.method, allow_none=True)
            self._body = text.encode("utf-8")
        return self._body

    def texts(self, count: int) -> tuple[str, ...]:
        """Return its first arguments, which must all be text."""
        found = self.params[:count]
        if len(found) < count or not all(isinstance(one, str) for one in found):
            raise BadCall(f"{self.method} needs {count} texts")
        return found


class Answer:
    """An answer of the master's API: [code, message, value], or a fault."""

    def __init__(self, value: Any = None, body: bytes | None = None) -> None:
        self._value = value
        self._body = body

    @classmethod
    def good(cls, message: str, value: Any) -> Answer:
        return cls([1, message, value])

    @property
    def body(self) -> bytes:
        """The answer as XML."""
        if self._body is None:
            text = xmlrpc.client.dumps((self._value,), methodresponse=True, allow_none=True)
            self._body = text.encode("utf-8")
        return self._body

    @property
    def value(self) -> Any:
        """[code, message, value], and for a fault [-1, its text, 0]."""
        if self._value is None:
            try:
                check(self._body or b"")
                self._value = xmlrpc.client.loads(self._body or b"")[0][0]
            except Exception as error:
                self._value = [-1, str(error), 0]
        return self._value

    @property
    def is_success(self) -> bool:
        value = self.value
        return isinstance(value, list) and len(value) == 3 and value[0] == 1

    @property
    def result(self) -> Any:
        """The value of a success, None otherwise."""
        return self.value[2] if self.is_success else None


def fault(message: str) -> Answer:
    """Return the answer to a call that cannot be read."""
    text = xmlrpc.client.dumps(xmlrpc.client.Fault(1, message), allow_none=True)
    return Answer(body=text.encode("utf-8"))


class Removal(NamedTuple):
    """A registration that a node withdraws; a service's `uri` is its own."""

    kind: str
    key: str
    node: str
    uri: str


_REGISTER = {
    "registerPublisher": PUBLISHER,
    "registerSubscriber": SUBSCRIBER,
    "registerService": SERVICE,
    "subscribeParam": PARAMETER,
}
_UNREGISTER = {f"un{method}": kind for method, kind in _REGISTER.items()}


def registration_of(call: Call) -> Registration | None:
    """Return what a call registers, None for another call."""
    kind = _REGISTER.get(call.method)
    if kind is None:
        return None
    if kind == PARAMETER:
        node, api, key = call.texts(3)
        return Registration(kind, resolve_name(key, node), node, api, "")
    node, key, detail, api = call.texts(4)
    return Registration(kind, resolve_name(key, node), node, api, detail)


def removal_of(call: Call) -> Removal | None:
    """Return what a call unregisters, None for another call."""
    kind = _UNREGISTER.get(call.method)
    if kind is None:
        return None
    if kind == PARAMETER:
        node, uri, key = call.texts(3)
    else:
        node, key, uri = call.texts(3)
    return Removal(kind, resolve_name(key, node), node, uri)


def describe_call(call: Call) -> str:
    """Return what a call registers or sets, for people to read."""
    one = registration_of(call)
    return (
        f"{one.kind} {one.key} of {one.node} at {one.api}" if one else f"parameter {call.params[1]}"
    )


def call_of(one: Registration) -> Call:
    """Return the call by which a registration is made."""
    if one.kind == PARAMETER:
        return Call("subscribeParam", (one.node, one.api, one.key))
    methods = {kind: method for method, kind in _REGISTER.items()}
    return Call(methods[one.kind], (one.node, one.key, one.detail, one.api))
