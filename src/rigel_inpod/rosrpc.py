"""XML-RPC to ROS masters and nodes, just enough of it and quick to start.

Why: a probe runs every few seconds in every pod. Importing the standard library's xmlrpc client
takes five times as long as Python takes to start; this needs the C module `_socket` only. It is
independent of probes. Python 2.7 and 3.
"""

try:
    import _socket as socket  # half of `import socket` is for classes that are not needed here
except ImportError:  # not CPython
    import socket
import time

CALLER = "/rigel_probe"
LARGEST = 16 << 20  # bytes of an answer: that of a master with 100,000 topics has less
LARGEST_OF_NODE = 1 << 20  # bytes of a node's answer
DEEPEST = 100  # lists inside of each other in an answer; ROS' own have 5


class CallFailed(Exception):
    """The call failed; the message is the cause, in a few words."""


class Refused(CallFailed):
    """The server has answered with an error; the message is its own."""


class Api(object):
    """One ROS XML-RPC server; keeps its connection for further calls."""

    def __init__(self, uri, deadline, caller=CALLER, largest=LARGEST):
        """`deadline` is the time.time() at which every call has ended."""
        self.uri, self._caller, self._largest = uri, caller, largest
        self.host, self.port = split(uri)
        self._deadline = deadline
        self._socket = None

    def call(self, method, *arguments):
        """Return (code, message, value), the answer of every ROS method."""
        body = request(method, (self._caller,) + arguments)
        reused = self._socket is not None
        try:
            answer = self._post(body)
        except CallFailed:
            if not reused:
                raise
            answer = self._post(body)  # the server had closed the kept connection
        if isinstance(answer, list) and answer and isinstance(answer[0], list):
            return ["1", "", answer]  # roscpp answers getBusStats without a code
        if not isinstance(answer, list) or len(answer) != 3:
            raise CallFailed("it does not speak ROS")
        return answer

    def ask(self, method, *arguments):
        """Return a method's value; raise Refused if the server refuses."""
        code, message, value = self.call(method, *arguments)
        if code != "1":
            raise Refused(str(message))
        return value

    def local_address(self):
        """Return the address that this side of the connection has."""
        return self._socket.getsockname()[0] if self._socket is not None else None

    def close(self):
        """Close the connection."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _post(self, body):
        try:
            if self._socket is None:
                self._socket = self._connect()
            self._settimeout(self._socket)
            head = "POST /RPC2 HTTP/1.1\r\nHost: %s:%d\r\nContent-Type: text/xml\r\n"
            head += "Content-Length: %d\r\n\r\n"
            self._socket.sendall((head % (self.host, self.port, len(body))).encode() + body)
            return self._read()
        except CallFailed:
            self.close()
            raise
        except Exception as error:  # socket.error is not an OSError in Python 2
            self.close()
            raise CallFailed(reason(error))

    def _connect(self):
        failure = CallFailed("no address")
        for family, kind, protocol, _, address in socket.getaddrinfo(
            self.host.encode("ascii"), self.port, 0, socket.SOCK_STREAM
        ):
            found = socket.socket(family, kind, protocol)
            try:
                self._settimeout(found)
                found.connect(address)
                return found
            except Exception as error:
                found.close()
                failure = error
        raise failure

    def _settimeout(self, connection):
        left = self._deadline - time.time()
        if left <= 0:
            raise CallFailed("timed out")
        connection.settimeout(left)

    def _read(self):
        data = b""
        while b"\r\n\r\n" not in data:
            data += self._some()
            if len(data) > self._largest:
                raise CallFailed("its answer is too large")
        head, _, body = data.partition(b"\r\n\r\n")
        status, _, fields = head.decode("latin-1").partition("\r\n")
        if " 200" not in status:
            raise CallFailed("it answered " + status)
        fields = dict(line.lower().split(":", 1) for line in fields.split("\r\n") if ":" in line)
        length = int(fields["content-length"])
        if length > self._largest:
            raise CallFailed("its answer is too large")
        while len(body) < length:
            body += self._some()
        if status.startswith("HTTP/1.0") or "close" in fields.get("connection", ""):
            self.close()
        return parse(body.decode("utf-8", "replace"))

    def _some(self):
        self._settimeout(self._socket)
        data = self._socket.recv(65536)
        if not data:
            raise CallFailed("it closed the connection")
        return data


def split(uri):
    """Return (host, port) of an http URI; raises CallFailed if it is not one."""
    rest = uri.partition("://")[2].partition("/")[0]
    host, _, port = rest.rpartition(":")
    if not uri.startswith("http://") or not host or not port.isdigit():
        raise CallFailed("%r is not http://HOST:PORT" % str(uri))
    return host.strip("[]"), int(port)


def reason(error):
    """Return an exception's message, without the system's error numbers."""
    if "timed out" in str(error):
        return "timed out"
    text = error.args[1] if len(error.args) > 1 else str(error)
    return str(text) or error.__class__.__name__


def request(method, arguments):
    """Return the body of a call; its arguments are texts, and lists of them."""
    values = "".join("<param>%s</param>" % encode(a) for a in arguments)
    text = "<?xml version='1.0'?><methodCall><methodName>%s</methodName><params>%s</params>"
    return ((text + "</methodCall>") % (method, values)).encode("utf-8")


def encode(value):
    """Return a value in XML."""
    if isinstance(value, list):
        inner = "".join(encode(item) for item in value)
        return "<value><array><data>%s</data></array></value>" % inner
    return "<value>%s</value>" % escape(value)


def escape(text):
    """Return text as XML character data."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


def parse(text):
    """Return an answer's value: nested lists of text; every scalar is text, a struct too.

    Raises:
        CallFailed: the answer is a fault, or not an answer.
    """
    lists, plain = [[]], None
    for piece in text.split("<")[1:]:
        tag, _, words = piece.partition(">")
        if tag == "fault":
            raise CallFailed("it answered with a fault")
        if tag == "value" or tag in ("string", "int", "i4", "boolean", "double"):
            plain = words
        elif tag == "array":
            lists.append([])
            plain = None
            if len(lists) > DEEPEST:
                raise CallFailed("its answer is too deep")
        elif tag == "/array":
            done = lists.pop()
            lists[-1].append(done)
        elif tag == "/value" and plain is not None:
            lists[-1].append(unescape(plain))
            plain = None
    if len(lists) != 1 or len(lists[0]) != 1:
        raise CallFailed("it does not speak ROS")
    return lists[0][0]


def unescape(text):
    """Return what the XML character data means."""
    if "&" not in text:
        return text
    for name, sign in (("lt", "<"), ("gt", ">"), ("quot", '"'), ("apos", "'"), ("amp", "&")):
        text = text.replace("&%s;" % name, sign)
    return text
