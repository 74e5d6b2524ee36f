"""Follows a topic of ROS 2, or calls the parameter services of a node. Python 3.6, with rclpy.

    ros2_tools.py REQUEST

Why in a pod: the types, the middleware and its configuration are those of the nodes there. REQUEST
is JSON with `do`: `echo` or `count` (`topic`, `type`, `publishers`: how many nodes publish;
`field`, `most` and `count` for echo), or `get` and `set` (`node`, `values` by name). lines.py has
the form of the answers. The node is hidden, has no services, and leaves the graph at the end.
"""

import importlib
import os
import threading
import time

import lines

DISCOVERY = 3.0  # seconds for a topic's publishers to be discovered
ANSWER = 5.0  # seconds for a node to be discovered and to answer
LOOK = 1.0  # seconds between looks at a topic's publishers
DEPTH = 100  # messages that wait to be handed over

#: The field of a ParameterValue, by its type.
VALUES = (
    *("", "bool_value", "integer_value", "double_value", "string_value", "byte_array_value"),
    *("bool_array_value", "integer_array_value", "double_array_value", "string_array_value"),
)
NOT_SET, DOUBLE, DOUBLES, STRINGS = 0, 3, 8, 9
TYPES = {bool: 1, int: 2, float: DOUBLE, str: 4}


class Helper(object):
    """A hidden node."""

    def __init__(self):
        try:
            import rclpy
            from rclpy.executors import SingleThreadedExecutor
        except ImportError as error:
            raise lines.Failure("no-library", "rclpy: %s" % error)
        rclpy.init(args=[], signal_handler_options=rclpy.signals.SignalHandlerOptions.NO)
        self._shutdown = rclpy.shutdown
        self.node = rclpy.create_node(
            "_rigel_k8s_%d" % os.getpid(), enable_rosout=False, start_parameter_services=False
        )
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)

    def spin(self, seconds):
        """Do what is due, at most for that long."""
        self._executor.spin_once(timeout_sec=seconds)

    def close(self):
        """Leave the graph."""
        self.node.destroy_node()
        self._shutdown()


def main(request):
    """Do what is requested."""
    helper = Helper()
    try:
        if request["do"] in ("echo", "count"):
            follow(helper, request)
        else:
            lines.write(Parameters(helper, request["node"]).answer(request))
    finally:
        helper.close()


def follow(helper, request):
    """Print a topic's messages, or once a second how many came."""
    kind, counts = find_class(request["type"]), request["do"] == "count"
    path = request.get("field", ())
    lines.select(kind(), path)
    queue, counter = (
        lines.Queue(None if request.get("count") else lines.MOST),
        lines.Counter(time.monotonic),
    )
    topic = Topic(helper, request, kind, counter.add if counts else queue.put, counts)
    topic.subscribe()
    threading.Thread(target=topic.spin, daemon=True).start()
    try:
        while counts:
            time.sleep(1)
            lines.write(dict(counter.take(), publishers=len(topic.look())))
        lines.print_messages(
            queue, request, lambda message, plain: convert(lines.select(message, path), plain)
        )
    finally:
        topic.ended.set()
        topic.idle.wait(1)


def find_class(name):
    """Return the class of a type.

    Raises:
        Failure: the image does not have it.
    """
    package, _, own = name.rpartition("/")
    try:
        return getattr(importlib.import_module(package.replace("/", ".")), own)
    except (ImportError, AttributeError, ValueError):
        raise lines.Failure("no-type", name)


class Topic(object):
    """A subscription that fits all publishers of a topic, also those that come later."""

    def __init__(self, helper, request, kind, receive, raw):
        self._helper, self._request, self._kind = helper, request, kind
        self._receive, self._raw = receive, raw
        self._subscription, self._chosen = None, None
        self.ended, self.idle = threading.Event(), threading.Event()

    def look(self):
        """Return (whether it is reliable, whether it is latched) of each publisher."""
        from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

        found = self._helper.node.get_publishers_info_by_topic(self._request["topic"])
        return [
            (
                one.qos_profile.reliability == ReliabilityPolicy.RELIABLE,
                one.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL,
            )
            for one in found
            if one.topic_type == self._request["type"]
        ]

    def subscribe(self):
        """Subscribe, once the publishers that are known are discovered."""
        until = time.monotonic() + DISCOVERY
        while len(self.look()) < self._request["publishers"] and time.monotonic() < until:
            self._helper.spin(0.01)
        self._fit(choose_qos(self.look()))

    def spin(self):
        """Receive messages until the end."""
        looked = time.monotonic()
        while not self.ended.is_set():
            self._helper.spin(0.1)
            if time.monotonic() > looked + LOOK:
                looked, chosen = time.monotonic(), choose_qos(self.look())
                if chosen != self._chosen and self.look():
                    self._fit(chosen)
        self.idle.set()

    def _fit(self, chosen):
        from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

        reliable, latched = self._chosen = chosen
        reliability = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        qos = QoSProfile(depth=DEPTH, reliability=reliability, durability=durability)
        if self._subscription is not None:
            self._helper.node.destroy_subscription(self._subscription)
        try:
            self._subscription = self._helper.node.create_subscription(
                self._kind, self._request["topic"], self._receive, qos, raw=self._raw
            )
        except Exception:  # its package has no library for Python
            raise lines.Failure("no-type", self._request["type"])


def choose_qos(publishers):
    """Return (reliable, latched) of a subscription that hears them all.

    Args:
        publishers: the same of each. Without any, what every publisher can serve.
    """
    return tuple(bool(publishers) and all(one) for one in (list(zip(*publishers)) or ((), ())))


def convert(value, plain):
    """Return a message or a field of it as plain values."""
    fields = lines.list_fields(value)
    if fields:
        return {name: convert(getattr(value, name), plain) for name in fields}
    if isinstance(value, bytes):  # a `byte` is one of length 1
        return ord(value) if len(value) == 1 else plain.items(value, int)
    if isinstance(value, str):
        return plain.text(value)
    if isinstance(value, (bool, int, float)):
        return value
    if hasattr(value, "tolist"):
        return convert(value.tolist(), plain) if value_is_scalar(value) else _array(value, plain)
    if hasattr(value, "__len__") and hasattr(value, "__getitem__"):
        return plain.items(value, lambda one: convert(one, plain))
    return {}  # a message without fields


def value_is_scalar(value):
    """Whether a value of numpy is a number."""
    return not hasattr(value, "__len__")


def _array(value, plain):
    return plain.items(value, lambda one: one.tolist() if hasattr(one, "tolist") else one)


class Parameters(object):
    """The parameters of one node, by its services."""

    def __init__(self, helper, node):
        from rcl_interfaces import srv

        self._helper, self._name, self._kinds = helper, node, srv

    def answer(self, request):
        """Return what is requested: `names` of all, `values`, and `refused` with the reason."""
        names = sorted(self._call("ListParameters").result.names)
        wanted = list(request["values"]) or names
        answer = {"names": names}
        known = [name for name in wanted if name in names]
        if request["do"] == "set":
            answer["refused"] = self._set(request["values"], known)
        else:
            answer["values"] = dict(zip(known, self._get(known)))
        return answer

    def _get(self, names):
        found = self._call("GetParameters", names=names).values if names else []
        if len(found) != len(names) > 1:  # one has no value, and no other was returned
            return [self._get([name])[0] for name in names]
        return [read_value(value) for value in found] or [None for _ in names]

    def _set(self, values, known):
        """Set all values or none; return why they are refused, None if they are not."""
        from rcl_interfaces.msg import Parameter, ParameterValue

        types = dict(
            zip(known, self._call("GetParameterTypes", names=known).types if known else ())
        )
        made = []
        for name, value in values.items():
            try:
                kind = choose_type(value, types.get(name, NOT_SET))
            except lines.Failure as error:
                raise lines.Failure(error.word, 'the value of "%s" %s' % (name, error))
            value = [float(one) for one in value] if kind == DOUBLES else value
            value = float(value) if kind == DOUBLE else value
            made.append(Parameter(name=name, value=ParameterValue(type=kind)))
            setattr(made[-1].value, VALUES[kind], value)
        done = self._call("SetParametersAtomically", parameters=made).result
        return None if done.successful else done.reason or "without a reason"

    def _call(self, kind, **fields):
        """Call one of the services and return its response.

        Raises:
            Failure: it is not there, or does not answer.
        """
        until, its = time.monotonic() + ANSWER, getattr(self._kinds, kind)
        own = "".join("_" + c.lower() if c.isupper() else c for c in kind).lstrip("_")
        client = self._helper.node.create_client(its, "%s/%s" % (self._name, own))
        while not client.service_is_ready():
            if time.monotonic() > until:
                raise lines.Failure("no-service", "does not offer its parameters")
            self._helper.spin(0.01)
        future = client.call_async(its.Request(**fields))
        while not future.done():
            if time.monotonic() > until + ANSWER:
                raise lines.Failure("no-answer", "does not answer")
            self._helper.spin(0.05)
        return future.result()


def read_value(value):
    """Return the value of a ParameterValue, None if it is not set."""
    if value.type == NOT_SET:
        return None
    return convert(getattr(value, VALUES[value.type]), lines.Plain(None))


def choose_type(value, declared):
    """Return the type of a parameter's new value; a whole number may be a double.

    Raises:
        Failure: no type has such a value.
    """
    if isinstance(value, list):
        kinds = {type(one) for one in value}
        if not kinds:
            return declared if declared > 4 else STRINGS
        if kinds <= {int, float} and (len(kinds) == 2 or declared == DOUBLES):
            return DOUBLES
        if len(kinds) == 1 and kinds <= set(TYPES):
            return TYPES[kinds.pop()] + 5
    elif type(value) in TYPES:
        return DOUBLE if type(value) is int and declared == DOUBLE else TYPES[type(value)]
    raise lines.Failure(
        "no-value", "is neither a number, a text, true or false, nor a list of one kind"
    )


if __name__ == "__main__":
    lines.run(main)
