"""Keeps a feed up to date with a release: one set of watches for all open pages.

A *session* is the life of these watches. It ends when the cluster does not answer, since a watch
over a lost connection may be silent for minutes; the next one begins when the cluster answers.
Meanwhile pages keep what they show, with its age.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import attrs

from rigel_k8s.commands.rosgraph import LiveGraph, look
from rigel_k8s.commands.targets import Release
from rigel_k8s.errors import ClusterError
from rigel_k8s.objects.facts import is_ending
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.naming import ROS_NAME_ANNOTATION
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.release.history import History
from rigel_k8s.release.lease import DURATION, holder, is_alive, lease_ref
from rigel_k8s.release.revisions import OF, Record
from rigel_k8s.release.rollout.crashes import STEADY, CrashLog, count_crashes
from rigel_k8s.release.rollout.surroundings import Surroundings
from rigel_k8s.release.rollout.view import EVENT, HELPFUL, POD, Kind, ReleaseView
from rigel_k8s.release.status import KINDS, ReleaseStatus, describe_release
from rigel_k8s.ui.contact import Contact
from rigel_k8s.ui.feed import Feed
from rigel_k8s.ui.graphs import GraphReader
from rigel_k8s.ui.nodes import node_entry, release_entry
from rigel_k8s.ui.times import write_now

SECRET: Kind = ("v1", "Secret")
LEASE: Kind = ("coordination.k8s.io/v1", "Lease")
SESSION = 3600.0  # seconds that watches live before they begin again
PAUSE = 2.0  # seconds before the next session, if the cluster has refused one
CALM = 0.1  # seconds in which changes are collected before pages get them


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
        self.found, self.feed = found, feed
        self._over = threading.Event()
        self._contact = Contact(found.cluster, report, self._publish_trouble)
        self._graph = GraphReader(feed, lambda: read(found))
        self._crashes = CrashLog()
        self._history = History(ROS_NAME_ANNOTATION)
        self._lease: tuple[str, float] = ("", 0.0)
        self._nodes: dict[str, Any] = {}
        self._threads = [
            threading.Thread(target=target, name=f"rigel-ui-{name}", daemon=True)
            for name, target in (
                ("watch", self._watch),
                ("contact", self._contact.run),
                ("graph", self._graph.run),
            )
        ]

    def start(self) -> None:
        """Begin to read."""
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """End all threads, without waiting for the answers to their requests."""
        self._over.set()
        self._contact.close()
        self._graph.close()

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
        while not self._over.is_set():
            if self._contact.lost.is_set():
                self._over.wait(0.2)
                continue
            try:
                helpful = HELPFUL | {SECRET, LEASE}
                with ReleaseView(
                    self.found.cluster, self.found.id.namespace, SESSION, helpful
                ) as view:
                    self._follow(view)
            except ClusterError as error:
                self._publish_trouble(error.message + (f" ({error.hint})" if error.hint else ""))
                self._over.wait(PAUSE)
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
        while not self._contact.lost.is_set() and time.monotonic() < end:
            fresh = view.refresh(1.0)
            now = time.monotonic()
            if not view.complete or not (fresh or self._is_due(shown, now)):
                continue
            self._publish_trouble("")
            self._show(view, now)
            shown = now
            self._over.wait(CALM)

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
            entries = self._history.make_entries(records)
            shown = {f"revision/{one.number}": attrs.asdict(one) for one in entries}
            self.feed.publish("revision", shown)
        self._graph.show(self._nodes, view.objects[POD].values())

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
                good=found.good,
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
