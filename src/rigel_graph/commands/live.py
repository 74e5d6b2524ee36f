"""A release as it runs: its pods, its graph, and how a program in a pod is asked."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import attrs

from rigel_graph.discovery.members import members
from rigel_graph.pods import read_pods
from rigel_graph.reading import choose_ros, list_objects, read_graph
from rigel_graph.tools import ROS1, ROS2, CannotRun, Tool
from rigel_graph.types import GraphNode, GraphTopic, RosGraph
from rigel_k8s.commands.pods import Pod, find_matching, no_node_error, pod_of
from rigel_k8s.commands.targets import Release
from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.objects.podnodes import split_all
from rigel_k8s.objects.pods import MASTER_NAME
from rigel_k8s.rigelfile import name_nearest

TRIED = 4  # pods, of different nodes, until none is expected to have what the others lack
#: Reasons of a pod's image; another pod's may differ.
OF_IMAGE = ("no-library", "no-type")


@attrs.frozen
class Live:
    """A release's pods and its graph, without rates.

    Attributes:
        generation: `1`, `2`, or `none`.
    """

    release: Release
    pods: Sequence[Pod]
    graph: RosGraph
    generation: str

    @property
    def tool(self) -> Tool:
        """The program for its ROS.

        Raises:
            UserError: it has no ROS.
        """
        tools = {"1": ROS1, "2": ROS2}
        if self.generation not in tools:
            raise UserError(
                f"{self.release.id.name} has no ROS nodes, only DDS",
                hint="`rigel topic list` lists its topics",
            )
        return tools[self.generation]

    def find_topic(self, name: str) -> GraphTopic:
        """Return a topic.

        Raises:
            UserError: no node has it; suggests a similar one.
        """
        full = name if name.startswith("/") else f"/{name}"
        topics = {topic.name: topic for topic in self.graph.topics}
        if full in topics:
            return topics[full]
        public = [topic.name for topic in self.graph.topics if topic.is_public]
        raise UserError(
            f'no node has a topic "{full}"{name_nearest(full, public)}',
            hint=f"topics are: {', '.join(public)}" if public else "the release has no topics",
        )

    def find_node(self, name: str) -> GraphNode:
        """Return a node, by its ROS name or its name in the Rigelfile.

        Raises:
            UserError: it does not exist, or its pod has several nodes.
        """
        nodes = {node.name: node for node in self.graph.nodes if node.registered}
        if name in nodes:
            return nodes[name]
        if name.startswith("/"):
            raise UserError(
                f'no node "{name}" is in the ROS graph{name_nearest(name, nodes)}',
                hint=f"its nodes are: {', '.join(nodes)}" if nodes else None,
            )
        pods = find_matching(self.pods, name)
        if not pods:
            raise no_node_error(self.release, name, self.pods)
        its = [node for node in nodes.values() if node.workload == pods[0].workload]
        if len(its) != 1:
            raise UserError(
                f"{name} has {len(its) or 'no'} nodes in the ROS graph",
                hint=f"name one: {', '.join(node.name for node in its)}"
                if its
                else "see what is wrong with `rigel status`",
            )
        return its[0]

    def ask(
        self, request: Mapping[str, Any], nodes: Collection[str], only: str | None, library: str
    ) -> Iterator[Mapping[str, Any]]:
        """Yield the answers of the program in a pod.

        Args:
            nodes: in whose pods it is tried first.
            only: in this node's pod alone, by any of its names.
            library: what a tool of another machine would do, for the hint.

        Raises:
            UserError: a part of the request is wrong; no pod runs, or has what it needs.
        """
        places = {(one.pod, one.workload) for one in self.graph.nodes if one.name in nodes}
        pods = order_pods(self.choose_pods(only), places)
        if not pods:
            raise ClusterError("no pod runs in which to ask", hint="see why with `rigel status`")
        failures: list[CannotRun] = []
        for pod in pods:
            try:
                yield from self.tool.run(self.release.cluster, pod, request)
                return
            except CannotRun as error:
                if error.word not in OF_IMAGE:
                    raise explain(error) from error
                failures.append(error)
        raise explain_image(failures[0], [pod.name for pod in pods], self.tool, library)

    def choose_pods(self, only: str | None) -> Sequence[Pod]:
        """Return the pods of one node, or all. Raises as find_node."""
        if only is None:
            return self.pods
        chosen = find_matching(self.pods, only)
        if not chosen:
            node = self.find_node(only)
            chosen = [pod for pod in self.pods if pod.name == node.pod]
        return chosen


def open_live(found: Release) -> Live:
    """Return what runs of a connected release. Raises as read_graph."""
    listed = list_objects(found.cluster, found.id)
    graph = read_graph(found.cluster, found.id, span=0.0, listed=listed)
    ros = choose_ros(read_pods(listed.pods), members(listed.pods))
    return Live(found, [pod_of(item) for item in split_all(listed.pods)], graph, ros.name)


def order_pods(pods: Sequence[Pod], preferred: Collection[tuple[str, str]]) -> list[Pod]:
    """Return the pods to try, one of each workload.

    Args:
        preferred: (pod, workload) of those that come first if they run; then ready ones.
    """
    able = [pod for pod in pods if pod.phase == "Running" and pod.scripts and not pod.helper]
    able.sort(
        key=lambda pod: (
            (pod.name, pod.workload) not in preferred,
            not pod.ready,
            pod.workload == MASTER_NAME,
        )
    )
    first = {pod.workload: pod for pod in reversed(able)}
    return [pod for pod in able if first[pod.workload] is pod][:TRIED]


def explain(error: CannotRun) -> Exception:
    """Return the error for a request that no pod can fulfil."""
    if error.word in ("no-field", "no-value"):
        return UserError(error.text)
    return ClusterError(f"the node {error.text}")


def explain_image(error: CannotRun, pods: Sequence[str], tool: Tool, command: str) -> ClusterError:
    """Return the error for images that lack the library or the type."""
    what = f"type {error.text}" if error.word == "no-type" else f"{tool.library} ({error.text})"
    where = f"the pod {pods[0]}" if len(pods) == 1 else f"the pods {', '.join(pods)}"
    return ClusterError(
        f"the image of {where} does not have the {what}",
        hint="name a node whose image has it with --node, or run a program of this computer:"
        f" `rigel join -- {command}`",
    )
