"""A small `ros2` for images without ros2cli, which PyPI does not have.

It is rigel-k8s's own, written on rclpy: what this project's demo and tests use, with upstream's
words and output. It has no daemon: each command discovers the graph again, for --spin-time seconds.
Runs inside the image only.
"""

import argparse
import os
import sys

from programs import Failure

ABOUT = "A part of ros2cli by rigel-k8s: PyPI has no wheel of upstream's."


def main(words):
    if words[:1] in (["run"], ["launch"]):  # the rest is theirs, options too
        module = "programs" if words[0] == "run" else "launch"
        return getattr(__import__(module), words[0])(words[1:])
    options = parser().parse_args(words)
    return getattr(__import__("graph"), options.call)(options)


def parser():
    top = argparse.ArgumentParser(prog="ros2", description=ABOUT)
    groups = top.add_subparsers(metavar="COMMAND", required=True)
    groups.add_parser("run", help="run an executable of a package: run PACKAGE EXECUTABLE [ARGS]")
    groups.add_parser("launch", help="start an XML launch file: launch [PACKAGE] FILE [ARG:=VALUE]")
    node = groups.add_parser("node").add_subparsers(metavar="VERB", required=True)
    verb(node, "list", "list_nodes", "all nodes")
    param = groups.add_parser("param").add_subparsers(metavar="VERB", required=True)
    verb(param, "get", "get_parameter", "one parameter", "node", "name")
    topic = groups.add_parser("topic").add_subparsers(metavar="VERB", required=True)
    found = verb(topic, "list", "list_topics", "all topics")
    found.add_argument("-t", "--show-types", action="store_true")
    verb(topic, "info", "describe_topic", "its type, publishers and subscribers", "topic")
    found = verb(topic, "echo", "echo", "print its messages", "topic")
    found.add_argument("type", nargs="?")
    found.add_argument("--once", action="store_true")
    found.add_argument("--field", default="", help="one field, as in header.stamp")
    about = "publish: pub /chatter std_msgs/msg/String 'data: hi'"
    found = verb(topic, "pub", "publish", about, "topic", "type", "values")
    found.add_argument("-r", "--rate", type=float, default=1.0)
    found.add_argument("-1", "--once", action="store_true")
    return top


def verb(verbs, name, call, about, *places):
    found = verbs.add_parser(name, help=about, description=about)
    for place in places:
        found.add_argument(place)
    found.add_argument("--spin-time", type=float, default=3.0, help="seconds to discover the graph")
    found.set_defaults(call=call)
    return found


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except Failure as failure:
        sys.exit(str(failure))
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:  # `ros2 topic echo ... | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
