"""Follows a topic of ROS 1. Python 2.7 and 3, with rospy.

    ros1_tools.py REQUEST

Why in a pod: only pods reach the nodes, and have the types. REQUEST is JSON as ros2_tools.py takes
it, with `do`: `echo` or `count`. lines.py has the form of the answers. The node's name begins with
an underscore: our graphs leave it out.
"""

import os
import time
import warnings

import lines


def main(request):
    """Do what is requested."""
    try:
        import roslib.message
        import rospy
    except ImportError as error:
        raise lines.Failure("no-library", "rospy: %s" % error)
    counts = request["do"] == "count"
    kind = rospy.AnyMsg if counts else roslib.message.get_message_class(request["type"])
    if kind is None:
        raise lines.Failure("no-type", request["type"])
    path = request.get("field", ())
    if not counts:
        lines.select(kind(), path)
    warnings.simplefilter("ignore")  # the underscore
    rospy.init_node("_rigel_k8s_%d" % os.getpid(), disable_signals=True, disable_rosout=True)
    queue, counter = (
        lines.Queue(None if request.get("count") else lines.MOST),
        lines.Counter(time.time),
    )
    topic = rospy.Subscriber(
        request["topic"], kind, counter.add if counts else queue.put, tcp_nodelay=True
    )
    try:
        while counts:
            time.sleep(1)
            lines.write(dict(counter.take(), publishers=topic.get_num_connections()))
        lines.print_messages(
            queue, request, lambda message, plain: convert_part(message, path, plain)
        )
    finally:
        rospy.signal_shutdown("done")


def convert_part(message, path, plain):
    """Return a part of a message as plain values."""
    kind = message._type
    for name in path:
        kind = message._slot_types[message.__slots__.index(name)]
        message = getattr(message, name)
    return convert(message, kind, plain)


def convert(value, kind, plain):
    """Return a field as plain values, by its type."""
    base, _, array = kind.partition("[")
    if array:
        if base in ("uint8", "char") and not isinstance(value, (list, tuple)):
            return plain.items(bytearray(value), int)
        return plain.items(value, lambda one: convert(one, base, plain))
    if base in ("time", "duration"):
        return {"secs": value.secs, "nsecs": value.nsecs}
    if base == "string":
        text = value.decode("utf-8", "replace") if isinstance(value, bytes) else value
        return plain.text(text)
    if hasattr(value, "_slot_types"):
        fields = zip(value.__slots__, value._slot_types)
        return {name: convert(getattr(value, name), its, plain) for name, its in fields}
    return value


if __name__ == "__main__":
    lines.run(main)
