"""Keeps a feed up to date with a release: one set of watches for all open pages.

A *session* is the life of these watches. It ends when the cluster does not answer, since a watch
over a lost connection may be silent for minutes; the next one begins when the cluster answers.
Meanwhile pages keep what they show, with its age.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from datetime import datetime, timezone
from typing import Any

from rigel_k8s.commands.rosgraph import LiveGraph, look, picture_of
from rigel_k8s.commands.targets import Release
from rigel_k8s.errors import ClusterError, RigelK8sError
from rigel_k8s.kube.failures import Refusal
from rigel_k8s.objects.facts import is_ending, stays_ready
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.release.lease import DURATION, holder, is_alive, lease_ref
from rigel_k8s.release.revisions import OF, Record
from rigel_k8s.release.rollout.crashes import STEADY, CrashLog, count_crashes
from rigel_k8s.release.rollout.surroundings import Surroundings
from rigel_k8s.release.rollout.view import EVENT, HELPFUL, POD, Kind, ReleaseView
from rigel_k8s.release.status import KINDS, ReleaseStatus, describe_release
from rigel_k8s.rosgraph.drawing.picture import Picture
from rigel_k8s.rosgraph.types import RosGraph
from rigel_k8s.ui.boxes import describe, keep_lost, make_boxes, make_topics
from rigel_k8s.ui.feed import Feed
from rigel_k8s.ui.history import History
from rigel_k8s.ui.nodes import READY, STOPPED, node_entry, release_entry

SECRET: Kind = ("v1", "Secret")
LEASE: Kind = ("coordination.k8s.io/v1", "Lease")
SESSION = 3600.0  # seconds that watches live before they begin again
HEARTBEAT = 3.0  # seconds between two requests that test whether the cluster answers
LATE = 10.0  # seconds without an answer after which it counts as unreachable
PAUSE = 2.0  # seconds before the next session, if the cluster has refused one
CALM = 0.1  # seconds in which changes are collected before pages get them
GRAPH_CALM = 1.5  # seconds after a change of pods before the ROS graph is read
GRAPH_AGE = 30.0  # seconds after which it is read again while a page is open


class Live:
    """Reads a release until `close`, and publishes what pages show of it.

    Args:
        report: takes a line for the terminal when the cluster becomes unreachable, and when it
            answers again.
        read: reads the ROS graph.
    """

    def __init__(
        self,
        found: Release,
        feed: Feed,
        report: Callable[[str], None],
        read: Callable[[Release], LiveGraph] = look,
    ) -> None:
        self.found, self.feed, self.report = found, feed, report
        self.over = threading.Event()
        self._lost = threading.Event()
        self._answered = 0.0
        self._crashes = CrashLog()
        self._history = History()
        self._lease: tuple[str, float] = ("", 0.0)
        self._nodes: dict[str, Any] = {}
        self._graph = GraphReader(self, read)
        self._threads = [
            threading.Thread(target=target, name=f"rigel-ui-{name}", daemon=True)
            for name, target in (
                ("watch", self._watch),
                ("heartbeat", self._listen),
                ("graph", self._graph.run),
            )
        ]

    def start(self) -> None:
        """Begin to read."""
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """End all threads, without waiting for the answers to their requests."""
        self.over.set()
        self._lost.set()
        self._graph.wake()

    # Whether the cluster answers.

    def _listen(self) -> None:
        """Start to ask the cluster, and note its loss if it does not answer for LATE seconds."""
        threading.Thread(target=self._ask, name="rigel-ui-ask", daemon=True).start()
        while not self.over.is_set():
            if self._answered and time.monotonic() - self._answered > LATE:
                self._lose(f"the cluster at {self.found.cluster.server} does not answer")
            self.over.wait(1.0)

    def _ask(self) -> None:
        self._answered = time.monotonic()
        while not self.over.is_set():
            try:
                self.found.cluster.server_version()
            except Refusal as error:
                # A refusal is an answer as well: the user has no right to read the version.
                if error.status == 0 or error.status >= 500:
                    self._lose(error.message)
                else:
                    self._find()
            except RigelK8sError as error:
                self._lose(error.message)
            else:
                self._find()
            self.over.wait(HEARTBEAT)

    def _find(self) -> None:
        """Note that the cluster answers."""
        self._answered = time.monotonic()
        if self._lost.is_set() and not self.over.is_set():
            self._lost.clear()
            self.report("the cluster answers again")

    def _lose(self, message: str) -> None:
        """Note that the cluster does not answer; the session ends."""
        if self._lost.is_set():
            return
        self._lost.set()
        self.report(f"{message}; waiting for it")
        self._publish_trouble(message)

    def _publish_trouble(self, message: str) -> None:
        """Publish what keeps pages from being up to date, "" for nothing."""
        cluster = self.found.cluster
        old = self.feed.get("cluster") or {}
        since = old.get("since") if old.get("message") and message else write_now()
        self.feed.publish(
            "cluster",
            {
                "cluster": {
                    "server": cluster.server,
                    "context": cluster.context_name,
                    "release": self.found.id.name,
                    "namespace": self.found.id.namespace,
                    "message": message,
                    "since": since if message else "",
                }
            },
        )

    # Sessions.

    def _watch(self) -> None:
        self._publish_trouble("connecting to the cluster")
        while not self.over.is_set():
            if self._lost.is_set():
                self.over.wait(0.2)
                continue
            try:
                helpful = HELPFUL | {SECRET, LEASE}
                with ReleaseView(
                    self.found.cluster, self.found.id.namespace, SESSION, helpful
                ) as view:
                    self._follow(view)
            except ClusterError as error:
                self._publish_trouble(error.message + (f" ({error.hint})" if error.hint else ""))
                self.over.wait(PAUSE)
            except Exception as error:  # a page that stands still must not look live
                self._publish_trouble(
                    f"this page is no longer updated: {error!r}; start rigel ui again"
                )
                raise

    def _follow(self, view: ReleaseView) -> None:
        """Publish what a view shows, until the session ends."""
        release = self.found.id
        own = f"{RELEASE_LABEL}={release.name}"
        view.watch([*KINDS, POD], labels=own)
        view.watch([EVENT], fields="type=Warning")
        view.watch([SECRET], labels=f"{OF}={release.name}")
        view.watch([LEASE], fields=f"metadata.name={lease_ref(release).name}")
        end = time.monotonic() + SESSION
        shown = 0.0
        while not self._lost.is_set() and time.monotonic() < end:
            fresh = view.refresh(1.0)
            now = time.monotonic()
            if not view.complete or not (fresh or self._is_due(shown, now)):
                continue
            self._publish_trouble("")
            self._show(view, now)
            shown = now
            self.over.wait(CALM)

    def _is_due(self, shown: float, now: float) -> bool:
        """Whether time alone has changed something since: a crash, a Lease that is not renewed."""
        passing = [(since, STEADY) for since in self._crashes.changed.values()]
        passing.append((self._lease[1], DURATION))
        return any(shown < since + lasts <= now for since, lasts in passing)

    def _show(self, view: ReleaseView, now: float) -> None:
        around = view.look_around(warnings=True)
        secrets = view.objects[SECRET].values()
        records = sorted((Record(self.found.id, s) for s in secrets), key=lambda r: r.number)
        hidden = SECRET in view.refused
        found = describe_release(
            self.found.id,
            [view.objects[kind].values() for kind in KINDS],
            around,
            None if hidden else records,
        )
        if found is None:
            self._nodes = {}
            self.feed.publish("release", {"release": {"absent": True}})
            for group in ("node", "box", "topic", "dot", "revision", "problems"):
                self.feed.publish(group, {})
            return
        changing = self._find_holder(view, now)
        rolling = found.revision_status == "pending" and changing != ""
        self._nodes = self._describe(view, found, around, now, rolling=rolling)
        self.feed.publish("node", {f"node/{name}": node for name, node in self._nodes.items()})
        whole = release_entry(found, self._nodes, changing=changing)
        self.feed.publish("release", {"release": whole})
        if not hidden:
            self.feed.publish("revision", self._history.make_entries(records))
        self._graph.see(view.objects[POD].values())
        self.draw()

    def _describe(
        self,
        view: ReleaseView,
        found: ReleaseStatus,
        around: Surroundings,
        now: float,
        *,
        rolling: bool,
    ) -> dict[str, Any]:
        """Return the entries of the nodes."""
        live = {
            (item["kind"], item["metadata"]["name"]): item
            for kind in KINDS
            for item in view.objects[kind].values()
        }
        items = [live[workload.kind, workload.name] for workload in found.workloads]
        newest = [around.list_newest_pods(item) for item in items]
        for item, pods in zip(items, newest, strict=True):
            self._note_crashes(ref_of(item), pods, now)
        unsteady = self._crashes.find_unsteady(now)
        return {
            workload.name: node_entry(
                workload,
                pods,
                crashed=ref_of(item) in unsteady,
                machine=str(self._nodes.get(workload.name, {}).get("machine", "")),
                rolling=rolling,
            )
            for workload, item, pods in zip(found.workloads, items, newest, strict=True)
        }

    def _note_crashes(self, ref: ObjectRef, pods: list[Manifest], now: float) -> None:
        """Note how often a workload's pods have crashed, except those that are being terminated.

        The first count of a workload only serves for comparison. A count that has become smaller
        is that of other pods.
        """
        staying = [pod for pod in pods if not is_ending(pod)]
        count = sum(map(count_crashes, staying))
        if count >= self._crashes.counts.get(ref, count + 1):
            self._crashes.note(ref, staying, now)
        else:
            self._crashes.changed.pop(ref, None)
        self._crashes.counts[ref] = count

    def _find_holder(self, view: ReleaseView, now: float) -> str | None:
        """Return who changes the release, "" for no one; None if the Lease cannot be read."""
        if LEASE in view.refused:
            return None
        lease = view.find(lease_ref(self.found.id))
        if lease is None or is_alive(lease) is False:
            return ""
        renewed = str(lease["spec"].get("renewTime"))
        if renewed != self._lease[0]:
            self._lease = (renewed, now)
        return holder(lease) if now - self._lease[1] < DURATION else ""

    # The ROS graph.

    def draw(self) -> None:
        """Publish boxes and topics, from the nodes and the graph that was read last."""
        read = self._graph.found
        graph = read.graph if read else None
        picture = picture_of(read) if read else None
        boxes = make_boxes(self._nodes, graph, picture)
        self.feed.publish("box", boxes)
        if graph is not None and picture is not None:
            self._draw_topics(graph, picture)
        text = describe(boxes, self.feed.list_group("topic"))
        self.feed.publish("dot", {"dot": {"text": text}})

    def _draw_topics(self, graph: RosGraph, picture: Picture) -> None:
        present = {
            name for topic in graph.topics for name in (*topic.publishers, *topic.subscribers)
        }
        away = {
            node["name"]
            for node in self._nodes.values()
            if node["state"] not in (READY, STOPPED) or node["name"] not in present
        }
        topics = keep_lost(self.feed.list_group("topic"), make_topics(graph, picture), away)
        self.feed.publish("topic", topics)


class GraphReader:
    """Reads the ROS graph when pods have changed, and now and then while a page is open."""

    def __init__(self, live: Live, read: Callable[[Release], LiveGraph]) -> None:
        self._live, self._look = live, read
        self._wake = threading.Event()
        self._pods: frozenset[tuple[str, bool]] | None = None
        self._due = 0.0
        self.found: LiveGraph | None = None

    def see(self, pods: Any) -> None:
        """Take in the pods: if others are ready than before, the graph has changed."""
        ready = frozenset((pod["metadata"]["uid"], stays_ready(pod)) for pod in pods)
        if ready != self._pods:
            self._pods = ready
            self._due = time.monotonic() + GRAPH_CALM
            self.wake()

    def wake(self) -> None:
        """Look whether there is something to do."""
        self._wake.set()

    def run(self) -> None:
        """Read until the end."""
        read = 0.0
        while not self._live.over.is_set():
            due = self._due
            self._wake.wait(max(0.02, due - time.monotonic()) if due else 1.0)
            self._wake.clear()
            now = time.monotonic()
            old = self._live.feed.watched and now - read > GRAPH_AGE
            if self._pods and ((self._due and now >= self._due) or old):
                self._due = 0.0
                self._read()
                read = time.monotonic()

    def _read(self) -> None:
        state: dict[str, Any] = {"message": "", "read": write_now()}
        try:
            self.found = self._look(self._live.found)
        except RigelK8sError as error:
            old: Mapping[str, Any] = self._live.feed.get("graph") or {}
            state = {"message": error.message, "read": old.get("read", "")}
        else:
            problems = [problem.to_json() for problem in self.found.problems]
            self._live.feed.publish("problems", {"problems": problems})
            self._live.draw()
        if not self._live.over.is_set():
            self._live.feed.publish("graph", {"graph": state})


def write_now() -> str:
    """Return the present time as Kubernetes writes it."""
    return datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")
