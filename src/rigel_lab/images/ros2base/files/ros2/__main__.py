"""A small `ros2` for images without ros2cli, which PyPI does not have.

It is rigel-k8s's own, written on rclpy: the commands that people type to look into a running graph,
with upstream's words and output if upstream has the command. It has no daemon: each command
discovers the graph again, for --spin-time seconds. Runs inside the image only.
"""

import argparse
import os
import sys

from failure import Failure

ABOUT = "A part of ros2cli by rigel-k8s: PyPI has no wheel of upstream's."


def main(words):
    if words[:1] in (["run"], ["launch"]):  # the rest is theirs, options too
        module = "programs" if words[0] == "run" else "launch"
        return getattr(__import__(module), words[0])(words[1:])
    options = parser().parse_args(words)
    if not hasattr(options, "call"):
        parser().parse_args([*words, "--help"])
    module, function = options.call
    return getattr(__import__(module), function)(options)


def parser():
    top = argparse.ArgumentParser(prog="ros2", description=ABOUT)
    groups = top.add_subparsers(metavar="COMMAND")
    for name, about, verbs in (
        ("topic", "list, show, echo and publish topics", topic_verbs),
        ("node", "list and show nodes", node_verbs),
        ("param", "list, get and set parameters", param_verbs),
        ("service", "list services", service_verbs),
    ):
        group = groups.add_parser(name, help=about, description=about)
        verbs(group.add_subparsers(metavar="VERB"))
    groups.add_parser("run", help="run an executable of a package: run PACKAGE EXECUTABLE [ARGS]")
    groups.add_parser("launch", help="start an XML launch file: launch [PACKAGE] FILE [ARG:=VALUE]")
    return top


def topic_verbs(verbs):
    found = verb(verbs, "list", "graph.topics", "all topics")
    found.add_argument("-t", "--show-types", action="store_true")
    found.add_argument("-c", "--count-topics", action="store_true")
    found.add_argument("--include-hidden-topics", action="store_true")
    verb(verbs, "type", "graph.topic_type_of", "a topic's type").add_argument("topic")
    found = verb(verbs, "info", "graph.topic_info", "its publishers and subscribers")
    found.add_argument("topic")
    found.add_argument("-v", "--verbose", action="store_true")
    found = verb(verbs, "echo", "topics.echo", "print its messages")
    found.add_argument("topic")
    found.add_argument("type", nargs="?")
    found.add_argument("--once", action="store_true")
    found.add_argument("--field", help="one field, as in header.stamp")
    found = verb(verbs, "hz", "topics.hz", "print how often messages arrive")
    found.add_argument("topic")
    found.add_argument("-w", "--window", type=int, default=10000)
    found = verb(verbs, "pub", "topics.pub", "publish: pub /chatter std_msgs/msg/String 'data: hi'")
    found.add_argument("topic")
    found.add_argument("type")
    found.add_argument("values", nargs="?", default="{}", help="YAML")
    found.add_argument("-r", "--rate", type=float, default=1.0)
    found.add_argument("-1", "--once", action="store_true")
    found.add_argument("-t", "--times", type=int, default=0)
    found.add_argument("-w", "--wait-matching-subscriptions", type=int)


def node_verbs(verbs):
    found = verb(verbs, "list", "graph.nodes", "all nodes")
    found.add_argument("-a", "--all", action="store_true", help="also hidden ones")
    found.add_argument("-c", "--count-nodes", action="store_true")
    verb(verbs, "info", "graph.node_info", "a node's topics and services").add_argument("node")


def param_verbs(verbs):
    verb(verbs, "list", "parameters.listed", "a node's parameters").add_argument("node")
    found = verb(verbs, "get", "parameters.get", "one parameter")
    found.add_argument("node")
    found.add_argument("name")
    found.add_argument("--hide-type", action="store_true")
    found = verb(verbs, "set", "parameters.put", "change one parameter")
    found.add_argument("node")
    found.add_argument("name")
    found.add_argument("value", help="YAML")


def service_verbs(verbs):
    found = verb(verbs, "list", "graph.services", "all services")
    found.add_argument("-t", "--show-types", action="store_true")
    found.add_argument("--include-hidden-services", action="store_true")


def verb(verbs, name, call, about):
    found = verbs.add_parser(name, help=about, description=about)
    found.add_argument("--spin-time", type=float, default=3.0, help="seconds to discover the graph")
    found.add_argument("--no-daemon", action="store_true", help="accepted, without effect")
    found.set_defaults(call=call.split("."))
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
