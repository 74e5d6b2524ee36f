"""What is read of ROS 1 from inside a release's pods: the graph, parameters, the gate's state.

Why a program in a pod: nodes register addresses that only pods reach, and their own API has what no
master has: whether a node answers, the types it uses, how many messages it has sent. It runs where
the master runs, whose container always has a Python; the gate decides which pods may call it, and
is asked in its own container. The programs make the requests; this module decides what the answers
mean.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rigel_exporter.ros1_traffic import Ledger
from rigel_gate.calls import DESCRIBE_GATE
from rigel_graph.discovery.inside import run_inside
from rigel_graph.pods import GraphPod, read_pods
from rigel_graph.types import (
    GateStatus,
    GraphNode,
    GraphService,
    GraphTopic,
    NameConflict,
    RosGraph,
    WaitingNode,
    compare_types,
)
from rigel_inpod.sent import PYTHONS, read_module
from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.kube.failures import explain_exec
from rigel_k8s.objects.facts import is_ending, runs
from rigel_k8s.objects.marks import NAME_LABEL
from rigel_k8s.objects.pods import GATE_CONTAINER, MASTER_NAME, MASTER_PORT
from rigel_k8s.release.pods import list_pods
from rigel_k8s.release.types import ReleaseId

#: Every exporter's name begins with it. What reads the graph is left out of it.
EXPORTER_NAME = "/ros_exporter"
#: How the names of our own programs begin that follow a topic.
HIDDEN = "/_rigel"
#: What the master and nodes report instead of an unknown type.
NO_TYPE = ("", "*")
#: Seconds that the gate has to answer, the start of a Python included.
LIMIT = 10.0
ASK = f"""
import sys, xmlrpc.client
gate = xmlrpc.client.ServerProxy("http://127.0.0.1:{MASTER_PORT}")
sys.stdout.write(gate.{DESCRIBE_GATE}("/rigel")[2])
"""


def read(cluster: Cluster, pods: Sequence[GraphPod], span: float) -> RosGraph:
    """Return the graph as the master and its nodes report it, without machines and pods.

    Raises:
        ClusterError: no pod runs in which to run the request, or the master does not answer.
    """
    return parse(ask(cluster, pods, span))


def ask(cluster: Cluster, pods: Sequence[GraphPod], span: float) -> Mapping[str, Any]:
    """Return what the master and its nodes answer. Raises as read."""
    modules = [
        ("rosrpc", read_module("rigel_inpod.rosrpc")),
        ("ros1_graph", read_module("rigel_inpod.sent.ros1_graph")),
    ]
    return run_inside(cluster, choose_pod(pods), modules, [str(span)], pythons=PYTHONS)


def choose_pod(pods: Sequence[GraphPod]) -> GraphPod:
    """Return the pod in which to run the request: the master's, else a node's that is ready.

    Raises:
        ClusterError: none runs.
    """
    masters = [pod for pod in pods if pod.is_master]
    running = [pod for pod in masters or pods if pod.running and not pod.is_exporter]
    if not running:
        what = "roscore" if masters else "no pod of the release"
        verb = "does not run" if masters else "runs"
        raise ClusterError(
            f"cannot read the ROS graph: {what} {verb}", hint="`rigel status` shows the cause"
        )
    return max(running, key=lambda pod: (pod.ready, pod.name))


def parse(answer: Mapping[str, Any]) -> RosGraph:
    """Return the graph that rigel_inpod/sent/ros1_graph.py has printed."""
    said = {one["name"]: one for one in answer["nodes"] if not is_exporter(one["name"])}
    rates = measure_rates(said.values())
    topics = sorted({*answer["publishers"], *answer["subscribers"]})
    made = [parse_topic(name, answer, said, rates.get(name)) for name in topics]
    services = [
        GraphService(name, providers=tuple(sorted(set(owners))))
        for name, owners in sorted(answer["services"].items())
        if not all(is_exporter(owner) for owner in owners)
    ]
    return RosGraph(
        nodes=tuple(
            GraphNode(name, address=one.get("address", ""), up="pid" in one)
            for name, one in sorted(said.items())
        ),
        topics=tuple(topic for topic in made if topic.publishers or topic.subscribers),
        services=tuple(services),
    )


def parse_topic(
    name: str, answer: Mapping[str, Any], said: Mapping[str, Mapping[str, Any]], rate: float | None
) -> GraphTopic:
    """Return one topic; its type is the one that most of its nodes use."""
    publishers = list_others(answer["publishers"].get(name, ()))
    subscribers = list_others(answer["subscribers"].get(name, ()))
    used = [
        (node, kind)
        for part, nodes in (("publications", publishers), ("subscriptions", subscribers))
        for node in nodes
        for topic, kind in said.get(node, {}).get(part, ())
        if topic == name and kind not in NO_TYPE
    ]
    kind, mismatches = compare_types(used)
    if not kind and answer["types"].get(name) not in NO_TYPE:
        kind = answer["types"].get(name, "")
    return GraphTopic(name, kind, publishers, subscribers, mismatches, rate)


def list_others(names: Iterable[str]) -> tuple[str, ...]:
    """Return names of nodes, sorted, without exporters'."""
    return tuple(sorted({name for name in names if not is_exporter(name)}))


def is_exporter(name: str) -> bool:
    """Whether a node is a ROS exporter, or another program of ours that looks."""
    return name == EXPORTER_NAME or name.startswith((f"{EXPORTER_NAME}_", HIDDEN))


def measure_rates(counted: Iterable[Mapping[str, Any]]) -> dict[str, float]:
    """Return messages per second by topic, from publishers' counters; only topics with messages.

    A publisher counts by connection: a topic without subscribers counts nothing.
    """
    rates: dict[str, float] = {}
    for node in counted:
        if not node.get("seconds", 0) > 0:
            continue
        ledger, before = Ledger(), {}
        for stats in node["stats"]:
            before = {part.topic: part.messages for part in ledger.totals() if is_sent(part)}
            ledger.add(node["name"], node["uri"], stats)
        for part in ledger.totals():
            if is_sent(part) and part.messages:
                grown = (part.messages - before.get(part.topic, 0)) / node["seconds"]
                rates[part.topic] = rates.get(part.topic, 0.0) + grown
    return rates


def is_sent(part: Any) -> bool:
    """Whether a count is of messages that a node published."""
    return bool(part.direction == "published")


def list_parameters(cluster: Cluster, release: ReleaseId) -> list[str]:
    """Return the names of all parameters.

    Raises:
        UserError: the release does not use ROS 1.
        ClusterError: the master does not answer.
    """
    return list(ask_master(cluster, release)["names"])


def read_parameter(cluster: Cluster, release: ReleaseId, name: str) -> tuple[Any, ...]:
    """Return a parameter's value alone; nothing if it does not exist. Raises as list_parameters."""
    found = ask_master(cluster, release, name)
    return (found["value"],) if "value" in found else ()


def write_parameters(cluster: Cluster, release: ReleaseId, values: Mapping[str, Any]) -> None:
    """Set parameters, by their full names. Raises as list_parameters."""
    ask_master(
        cluster,
        release,
        *(word for name, value in values.items() for word in (name, json.dumps(value))),
    )


def ask_master(cluster: Cluster, release: ReleaseId, *words: str) -> Mapping[str, Any]:
    """Return what ros1_parameters.py answers to these words. Raises as above."""
    pods = read_pods(list_pods(cluster, release))
    if pods and all(pod.ros.dds for pod in pods):
        raise UserError(
            f"{release.name} has no ROS master with parameters",
            hint="`rigel param list NODE` shows those of a ROS 2 node",
        )
    modules = [("ros1_parameters", read_module("rigel_inpod.sent.ros1_parameters"))]
    return run_inside(cluster, choose_pod(pods), modules, words, pythons=PYTHONS)


def read_gate(cluster: Cluster, release: ReleaseId) -> GateStatus | None:
    """Return the state of the gate, which the master does not have; None if no gate runs."""
    names = [
        pod["metadata"]["name"]
        for pod in list_pods(cluster, release, {NAME_LABEL: MASTER_NAME})
        if runs(pod.get("status") or {}, GATE_CONTAINER) and not is_ending(pod)
    ]
    if not names:
        return None
    command = ["python3", "-E", "-S", "-B", "-c", ASK]
    try:
        done = cluster.run(
            release.namespace, names[-1], command, container=GATE_CONTAINER, timeout=LIMIT
        )
    except ClusterError as error:
        return GateStatus(problem=explain_exec(error))
    if done.code != 0:
        errors = done.stderr.decode("utf-8", "replace").splitlines()
        return GateStatus(problem=errors[-1] if errors else f"exit code {done.code}")
    answer = json.loads(done.stdout)
    return GateStatus(
        waiting=tuple(
            WaitingNode(one["node"], one["api"], one["owner"]) for one in answer["waiting"]
        ),
        conflicts=tuple(
            NameConflict(one["node"], one["old"], one["new"], one["time"])
            for one in answer["conflicts"]
        ),
        silent=tuple(answer["silent"]),
        has_master=answer["has_master"],
        restarts=answer["restarts"],
        blocked=answer["blocked"],
        refused=tuple(answer["refused"]),
        unkept=tuple(answer["unkept"]),
        notes=tuple(answer.get("notes", ())),
    )
