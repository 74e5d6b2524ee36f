"""What pages show of a release, from what its watches have seen; pure.

It remembers what a single look does not show: which nodes have crashed lately, whether a Lease is
still renewed, and on which machine a node was before its pod was replaced.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import attrs

from rigel_k8s.objects.facts import is_ending
from rigel_k8s.objects.marks import RELEASE_LABEL
from rigel_k8s.objects.naming import ROS_NAME_ANNOTATION
from rigel_k8s.objects.podnodes import split
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.release.history import History
from rigel_k8s.release.locking import DURATION, holder, is_alive, lease_ref
from rigel_k8s.release.revisions import OF, Record, read_all, versions
from rigel_k8s.release.rollout.standing import STEADY, CrashLog, count_crashes
from rigel_k8s.release.rollout.view import EVENT, HELPFUL, POD, Kind, ReleaseView
from rigel_k8s.release.status import (
    KINDS,
    choose_part,
    describe_release,
    find_missing,
    list_owned,
)
from rigel_k8s.release.types import ReleaseId
from rigel_ui.feed import Entries
from rigel_ui.nodes import node_entry, release_entry

SECRET: Kind = ("v1", "Secret")
LEASE: Kind = ("coordination.k8s.io/v1", "Lease")
#: Kinds that a page does without where the right to see them is missing.
OPTIONAL = HELPFUL | {SECRET, LEASE}


class Overview:
    """Makes entries of what a view shows.

    Attributes:
        nodes: the entries of the nodes as they were made last, by workload; None: no release.
    """

    def __init__(self, release: ReleaseId) -> None:
        self.nodes: Entries | None = None
        self._release = release
        self._crashes = CrashLog()
        self._known: set[ObjectRef] = set()
        self._history = History(ROS_NAME_ANNOTATION)
        self._lease: tuple[str, float] = ("", 0.0)
        self._owned: tuple[Sequence[str], Sequence[ObjectRef]] = ((), ())

    def watch(self, view: ReleaseView) -> None:
        """Let a view watch what the entries are made of."""
        view.watch([*KINDS, POD], labels=f"{RELEASE_LABEL}={self._release.name}")
        view.watch([EVENT], fields="type=Warning")
        view.watch([SECRET], labels=f"{OF}={self._release.name}")
        view.watch([LEASE], fields=f"metadata.name={lease_ref(self._release).name}")

    def is_due(self, shown: float, now: float) -> bool:
        """Whether time alone has changed something since: a crash, a Lease that is not renewed."""
        passing = [(since, STEADY) for since in self._crashes.changed.values()]
        passing.append((self._lease[1], DURATION))
        return any(shown < since + lasts <= now for since, lasts in passing)

    def describe(self, view: ReleaseView, now: float) -> Mapping[str, Entries]:
        related = view.find_related()
        records = None
        if SECRET not in view.refused:
            records = read_all(view.objects[SECRET].values())
        live = [list(view.objects[kind].values()) for kind in KINDS]
        found = describe_release(self._release, live, related, records)
        if found is None:
            self.nodes = None
            gone = ("node", "box", "topic", "dot", "revision", "problems")
            return {"release": {"release": {"absent": True}}, **{group: {} for group in gone}}

        seen = {kind: there for (_, kind), there in zip(KINDS, live, strict=True)}
        missing = find_missing(self._list_owned(records or ()), seen)
        found = attrs.evolve(found, missing=tuple(missing))
        changing = self._find_holder(view, now)
        before = self.nodes or {}
        rolling = found.revision_status == "pending" and changing != ""

        items = {
            (part["kind"], part["metadata"]["name"]): (one, part)
            for kind in live
            for one in kind
            for part in split(one)
        }
        newest = [
            [choose_part(pod, w.name) for pod in related.list_newest_pods(items[w.kind, w.name][0])]
            for w in found.workloads
        ]
        refs = [ref_of(items[w.kind, w.name][1]) for w in found.workloads]
        for ref, pods in zip(refs, newest, strict=True):
            self._note_crashes(ref, pods, now)
        unsteady = self._crashes.find_unsteady(now)
        self.nodes = {
            workload.name: node_entry(
                workload,
                pods,
                crashed=ref in unsteady,
                machine=str(before.get(workload.name, {}).get("machine", "")),
                rolling=rolling,
                good=found.good,
            )
            for workload, ref, pods in zip(found.workloads, refs, newest, strict=True)
        }

        whole = release_entry(found, self.nodes, changing=changing)
        made = {
            "node": {f"node/{name}": node for name, node in self.nodes.items()},
            "release": {"release": whole},
        }
        if records is not None:
            entries = self._history.make_entries(records)
            made["revision"] = {f"revision/{one.number}": attrs.asdict(one) for one in entries}
        return made

    def _list_owned(self, records: Sequence[Record]) -> Sequence[ObjectRef]:
        """Return what the newest revision has made; it is read again only if it has changed."""
        newest = versions(records[-1:])
        if newest != self._owned[0]:
            self._owned = newest, list_owned(records)
        return self._owned[1]

    def _note_crashes(self, ref: ObjectRef, pods: Sequence[Manifest], now: float) -> None:
        """Note how often a workload's pods have crashed, except those that are being terminated.

        The first look at a workload only serves for comparison.
        """
        staying = {pod["metadata"]["uid"]: pod for pod in pods if not is_ending(pod)}
        if ref not in self._known:
            self._known.add(ref)
            self._crashes.counts.update((uid, count_crashes(pod)) for uid, pod in staying.items())
        self._crashes.note(ref, staying.values(), now)
        if not any(map(self._crashes.counts.get, staying)):  # all of them are new
            self._crashes.changed.pop(ref, None)

    def _find_holder(self, view: ReleaseView, now: float) -> str | None:
        """Return who changes the release, "" for no one; None if the Lease cannot be read."""
        if LEASE in view.refused:
            return None
        lease = view.find(lease_ref(self._release))
        if lease is None or is_alive(lease) is False:
            return ""
        renewed = str(lease["spec"].get("renewTime"))
        if renewed != self._lease[0]:
            self._lease = (renewed, now)
        return holder(lease) if now - self._lease[1] < DURATION else ""
