"""What the ROS master and its nodes report, as one line of JSON. Python 2.7 and 3.

    ros1_graph.py [SPAN]

Why: only a pod reaches the master and the nodes. It registers nothing, so that no node notices a
new subscriber. Contract: the keys are those that rigel_graph/ros1.py reads; "error" is the reason
why the master did not answer. Every request has a deadline: a node that hangs costs ANSWER seconds
and no other node's answer. Counters are read twice, SPAN seconds apart, or once if it is 0.
"""

import json
import os
import socket
import sys
import time
from functools import partial
from multiprocessing.pool import ThreadPool

import rosrpc

MASTER = 5.0  # seconds for all of the master's answers
ANSWER = 3.0  # seconds for each of a node's two rounds
MOST_THREADS = 100


def look(uri, span):
    """Return the graph of the master at this URI; raise CallFailed if it does not answer."""
    master = rosrpc.Api(uri, time.time() + MASTER)
    publishers, subscribers, services = master.ask("getSystemState")
    types = dict(master.ask("getTopicTypes"))
    parts = (publishers, subscribers, services)
    names = sorted({name for part in parts for _, owners in part for name in owners})
    return {
        "publishers": dict(publishers),
        "subscribers": dict(subscribers),
        "services": dict(services),
        "types": types,
        "nodes": ask_nodes([(name, find_node(master, name)) for name in names], span),
    }


def find_node(master, name):
    """Return a node's URI, "" if the master does not have it."""
    try:
        return master.ask("lookupNode", name)
    except rosrpc.CallFailed:
        return ""


def ask_nodes(places, span):
    """Return each node's answers, many requested at the same time."""
    found = [{"name": name, "uri": uri} for name, uri in places]
    ThreadPool(min(MOST_THREADS, len(found)) or 1).map(partial(ask_node, span=span), found)
    return found


def ask_node(node, span):
    """Add a node's answers; those that did not arrive in time are left out."""
    try:
        node["address"] = address_of(node["uri"])
        api = rosrpc.Api(node["uri"], time.time() + ANSWER)
        node["pid"] = api.ask("getPid")
        node["publications"] = api.ask("getPublications")
        node["subscriptions"] = api.ask("getSubscriptions")
        first, began = api.ask("getBusStats"), time.time()
        api.close()
        node["at"], node["stats"] = began, [first]
        if not span:
            return
        time.sleep(span)
        later = rosrpc.Api(node["uri"], time.time() + ANSWER)
        second = later.ask("getBusStats")
        node["seconds"] = time.time() - began
        node["stats"] = [first, second]
        later.close()
    except rosrpc.CallFailed as error:
        node["error"] = str(error)


def address_of(uri):
    """Return the address of a URI's host, "" if its name has none here."""
    try:
        return socket.gethostbyname(rosrpc.split(uri)[0])
    except (EnvironmentError, UnicodeError):
        return ""


def main(words):
    """Print the graph."""
    uri = os.environ.get("ROS_MASTER_URI", "http://localhost:11311")
    try:
        found = look(uri, float(words[0]) if words else 1.0)
    except rosrpc.CallFailed as error:
        found = {"error": "the ROS master at %s does not answer: %s" % (uri, error)}
    sys.stdout.write(json.dumps(found, sort_keys=True) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
