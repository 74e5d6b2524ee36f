"""Keeps a feed up to date with a release: one set of watches for all open pages.

A *session* is the life of these watches. It ends when the cluster does not answer, since a watch
over a lost connection may be silent for minutes; the next one begins when the cluster answers.
Meanwhile pages keep what they show, with its age.

Three threads: one asks every few seconds whether the cluster answers, one follows the watches and
publishes, one reads the ROS graph (`graphs`). Only the second one decides that the cluster is lost.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from rigel_graph.commands.graph import LiveGraph, look
from rigel_k8s.commands.targets import Release
from rigel_k8s.errors import ClusterError, RigelK8sError
from rigel_k8s.kube.failures import Refusal
from rigel_k8s.release.rollout.view import POD, ReleaseView
from rigel_ui.feed import Feed
from rigel_ui.graphs import GraphReader, write_now
from rigel_ui.overview import OPTIONAL, Overview

HEARTBEAT = 3.0  # seconds between two requests whether the cluster answers
LATE = 10.0  # seconds without an answer after which the cluster counts as unreachable
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
        self._cluster, self._release = found.cluster, found.id
        self._feed, self._report = feed, report
        self._over = threading.Event()
        self._answered = time.monotonic()
        self._failure = ""  # why the last request had no answer
        self._overview = Overview(found.id)
        self._graph = GraphReader(feed, lambda: read(found))
        self._threads = [
            threading.Thread(target=target, name=f"rigel-ui-{name}", daemon=True)
            for name, target in (
                ("ask", self._ask),
                ("watch", self._watch),
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
        self._graph.close()

    def _ask(self) -> None:
        """Ask whether the cluster answers, and note how that ends."""
        while not self._over.is_set():
            failure = ""
            try:
                self._cluster.server_version()
            except Refusal as error:
                # A refusal is an answer as well: the user has no right to read the version.
                failure = error.message if error.status == 0 or error.status >= 500 else ""
            except RigelK8sError as error:
                failure = error.message
            self._failure = failure
            if not failure:
                self._answered = time.monotonic()
            self._over.wait(HEARTBEAT)

    def _find_loss(self) -> str:
        """Return why the cluster counts as unreachable, "" if it does not."""
        if not self._failure and time.monotonic() - self._answered > LATE:
            return f"the cluster at {self._cluster.server} does not answer"
        return self._failure

    def _watch(self) -> None:
        """Follow one session after the other; report when the cluster is lost, and its return."""
        self._publish_trouble("connecting to the cluster")
        lost = False
        while not self._over.is_set():
            if loss := self._find_loss():
                if not lost:
                    self._report(f"{loss}; waiting for it")
                    self._publish_trouble(loss)
                lost = True
                self._over.wait(0.2)
                continue
            if lost:
                self._report("the cluster answers again")
            lost = False
            try:
                namespace = self._release.namespace
                with ReleaseView(self._cluster, namespace, SESSION, OPTIONAL) as view:
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
        overview = self._overview
        overview.watch(view)
        end = time.monotonic() + SESSION
        shown = 0.0
        while not self._over.is_set() and not self._find_loss() and time.monotonic() < end:
            fresh = view.refresh(1.0)
            now = time.monotonic()
            if not view.complete or not (fresh or overview.is_due(shown, now)):
                continue
            self._publish_trouble("")
            for group, entries in overview.describe(view, now).items():
                self._feed.publish(group, entries)
            if overview.nodes is not None:
                self._graph.show(overview.nodes, view.objects[POD].values())
            shown = now
            self._over.wait(CALM)

    def _publish_trouble(self, message: str) -> None:
        """Publish what keeps pages from being up to date, "" for nothing."""
        old = self._feed.get("cluster") or {}
        since = old.get("since") if old.get("message") and message else write_now()
        entry = {
            "server": self._cluster.server,
            "context": self._cluster.context_name,
            "release": self._release.name,
            "namespace": self._release.namespace,
            "message": message,
            "since": since if message else "",
        }
        self._feed.publish("cluster", {"cluster": entry})
