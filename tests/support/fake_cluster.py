"""A cluster in memory that refuses what Kubernetes refuses; the one fake of `kube.Cluster`.

It has UIDs, resourceVersions, preconditions, field ownership, finalizers, namespaces and dry runs;
controllers.py adds those of Kubernetes' controllers that releases need. Whatever it promises is in
contract.py, which real API servers are asked too: add to that first.
"""

from __future__ import annotations

import json
import threading
import time
import uuid
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from datetime import datetime, timezone
from types import SimpleNamespace
from typing import Any

import attrs

from rigel_k8s.kube.failures import Missing, Refusal, refusal
from rigel_k8s.kube.resources import Resource, built_in
from rigel_k8s.kube.store import ANYTHING, Onto
from rigel_k8s.kube.watching import WatchEvent, label_selector
from rigel_k8s.objects.refs import ObjectRef, ref_of
from rigel_k8s.objects.rights import Right

from . import fields as ownership
from .controllers import Controllers
from .fields import clone

Live = dict[str, Any]
READS = ("get", "list", "try", "review")
ALL = {"apiGroups": ["*"], "resources": ["*"], "verbs": ["*"]}
#: Kinds whose `generation` counts the changes of their spec.
GENERATIONS = ("Deployment", "DaemonSet", "StatefulSet", "ReplicaSet", "Job")


class Killed(BaseException):
    """The process that used the cluster is dead: `except Exception` does not save it."""


@attrs.define
class Store:
    """What is on the cluster, whoever looks at it.

    Attributes:
        calls: the requests of clients: (verb, object or kind); a dry run is a "try".
        news: all that has happened, for watches.
        controllers: what runs beside the API server; None: nothing happens by itself.
        before: called before each write with (verb, object), to see what is there by then.
        refuse: an admission: (object, whether it is a dry run) -> the error, or None.
        rules: what clients may do, as a Role has it; dry runs and writes are not kept from them.
        die_after: the client is killed right after so many writes.
    """

    objects: dict[ObjectRef, Live] = attrs.field(factory=dict)
    calls: list[tuple[str, ObjectRef | str]] = attrs.field(factory=list)
    news: list[WatchEvent] = attrs.field(factory=list)
    kinds: dict[tuple[str, str], Resource] = attrs.field(factory=built_in)
    controllers: Controllers | None = None
    before: Callable[[str, ObjectRef], None] = lambda verb, ref: None
    refuse: Callable[[Live, bool], Refusal | None] = lambda live, dry_run: None
    rules: list[Mapping[str, Any]] = attrs.field(factory=lambda: [dict(ALL)])
    die_after: int | None = None
    dead: bool = False
    version: int = 100
    lock: threading.RLock = attrs.field(factory=threading.RLock)

    def clone(self) -> Store:
        """Return another cluster with the same objects."""
        objects = {ref: clone(live) for ref, live in self.objects.items()}
        controllers = self.controllers and attrs.evolve(self.controllers)
        return Store(objects, controllers=controllers, version=self.version)

    def commit(self, ref: ObjectRef, old: Live | None, new: Live) -> Live:
        """Store an object; one that has not changed keeps its resourceVersion."""
        meta = new["metadata"]
        if old is not None and substance(old) == substance(new):
            return old
        self.version += 1
        meta["resourceVersion"] = str(self.version)
        meta.setdefault("uid", str(uuid.uuid4()))
        meta.setdefault("creationTimestamp", now())
        if ref.kind in GENERATIONS:
            same = old is not None and old.get("spec") == new.get("spec")
            meta["generation"] = (old or new)["metadata"].get("generation", 0) + (0 if same else 1)
        if meta.get("deletionTimestamp") and not self.is_held(new):
            self.remove(ref)
            return new
        self.objects[ref] = new
        self.news.append(WatchEvent("MODIFIED" if old else "ADDED", clone(new)))
        return new

    def is_held(self, live: Live) -> bool:
        """Whether something holds an object that is being deleted."""
        running = live["kind"] == "Pod" and (live.get("spec") or {}).get("nodeName")
        return bool(live["metadata"].get("finalizers") or running or live["kind"] == "Namespace")

    def remove(self, ref: ObjectRef) -> None:
        if live := self.objects.pop(ref, None):
            self.version += 1
            gone = {**live, "metadata": {**live["metadata"], "resourceVersion": str(self.version)}}
            self.news.append(WatchEvent("DELETED", gone))

    def delete(self, ref: ObjectRef) -> None:
        """Delete an object, or mark it where something holds it."""
        live = clone(self.objects[ref])
        live["metadata"].setdefault("deletionTimestamp", now())
        if self.is_held(live):
            self.commit(ref, self.objects[ref], live)
        else:
            self.remove(ref)

    def tick(self) -> None:
        """Let the controllers go one step on."""
        if self.controllers is not None:
            self.controllers.step(self)


@attrs.define
class FakeCluster:
    """One client of a `Store`; `as_manager` is another one."""

    store: Store = attrs.field(factory=Store)
    manager: str = "rigel"
    namespace: str = "default"
    server: str = "https://fake"
    context_name: str = "fake"
    outages: Callable[[], float] = float

    def __enter__(self) -> FakeCluster:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing is kept open."""

    def endure(self, tell: Callable[[str], None], cancel: threading.Event) -> None:
        """It is away as long as `outages` says, and answers all the same."""

    def sum_outages(self) -> float:
        return self.outages()

    def guard_writes(self, guard: Callable[[], None]) -> AbstractContextManager[None]:
        """Nothing is sent a second time here."""
        del guard
        return nullcontext()

    def server_version(self) -> str:
        return "v1.34.4"

    def as_manager(self, manager: str) -> FakeCluster:
        """Return a client that writes as another field manager."""
        return attrs.evolve(self, manager=manager)

    @property
    def objects(self) -> dict[ObjectRef, Live]:
        return self.store.objects

    @property
    def calls(self) -> list[tuple[str, ObjectRef | str]]:
        return self.store.calls

    @property
    def writes(self) -> list[tuple[str, ObjectRef | str]]:
        """The requests that were to change something, refused ones too."""
        return [call for call in self.calls if call[0] not in READS]

    # Reading.

    def get(self, ref: ObjectRef) -> Live | None:
        with self.store.lock:
            self.note("get", ref)
            self.store.tick()
            return clone(self.objects.get(ref))

    def list(
        self,
        api_version: str,
        kind: str,
        namespace: str | None = None,
        *,
        labels: str | Mapping[str, str] | None = None,
        fields: str | None = None,
        metadata_only: bool = False,
    ) -> list[Live]:
        with self.store.lock:
            self.note("list", kind)
            self.store.tick()
            wanted = Selection(api_version, kind, namespace or "", label_selector(labels), fields)
            found = [clone(live) for live in self.objects.values() if wanted.has(live)]
        if metadata_only:
            return [{k: o[k] for k in ("apiVersion", "kind", "metadata")} for o in found]
        return found

    def watch(
        self,
        api_version: str,
        kind: str,
        namespace: str | None = None,
        *,
        labels: str | Mapping[str, str] | None = None,
        fields: str | None = None,
        seconds: float = 300.0,
        cancel: threading.Event | None = None,
        listed: Callable[[], None] | None = None,
    ) -> Iterator[WatchEvent]:
        wanted = Selection(api_version, kind, namespace or "", label_selector(labels), fields)
        deadline = time.monotonic() + seconds
        with self.store.lock:
            if self.store.dead:
                return
            self.note("list", kind)
            there = [clone(live) for live in self.objects.values() if wanted.has(live)]
            seen = len(self.store.news)
        yield from (WatchEvent("ADDED", live) for live in there)
        if listed:
            listed()
        while time.monotonic() < deadline and not (cancel and cancel.is_set()):
            with self.store.lock:
                if self.store.dead:
                    return
                self.store.tick()
                fresh, seen = self.store.news[seen:], len(self.store.news)
            yield from (
                attrs.evolve(event, object=clone(event.object))
                for event in fresh
                if wanted.has(event.object)
            )
            if not fresh:
                time.sleep(0.001)

    def nodes(self) -> Sequence[Live]:
        return self.list("v1", "Node")

    def serves(self, api_version: str, kind: str) -> bool:
        with self.store.lock:
            self.store.tick()
            return (api_version, kind) in self.store.kinds

    def events(self, live: Mapping[str, Any]) -> Sequence[Live]:
        about = f"involvedObject.uid={live['metadata']['uid']}"
        return self.list("v1", "Event", live["metadata"].get("namespace"), fields=about)

    # Writing.

    def apply(
        self,
        manifest: Mapping[str, Any],
        *,
        force: bool = False,
        dry_run: bool = False,
        onto: Onto = ANYTHING,
    ) -> Live:
        ref, what = ref_of(manifest), f"apply {ref_of(manifest)}"
        with self.store.lock:
            self.note("try" if dry_run else "apply", ref)
            old = self.find(ref, what)
            check_condition(what, ref, old, onto)
            said = ownership.leaves(manifest)
            base: Live = old or {**dict(manifest), "metadata": name_fields(ref)}
            others = ownership.conflicts(base, said, self.manager)
            if others and not force:
                raise field_conflict(what, others)
            new = ownership.merge(base, {**manifest, "metadata": free_of_status(manifest)})
            entries = base["metadata"].get("managedFields") or []
            before = ownership.find_owned_paths(base, self.manager, "Apply")
            theirs = {path for _, path in others}
            kept = ownership.record(entries, self.manager, "Apply", said, theirs, ref.api_version)
            still = {p for e in kept for p in ownership.paths(e["fieldsV1"])}
            for path in sorted(before - still):  # an item as a whole before its parts
                new = ownership.remove_leaf(new, path)
            new["metadata"]["managedFields"] = kept
            return self.write(what, ref, old, new, dry_run=dry_run)

    def create(self, manifest: Mapping[str, Any], *, dry_run: bool = False) -> Live:
        ref, what = ref_of(manifest), f"create {ref_of(manifest)}"
        with self.store.lock:
            self.note("try" if dry_run else "create", ref)
            if self.find(ref, what) is not None:
                raise make_refusal(what, 409, "AlreadyExists", f'"{ref.name}" already exists')
            new = fill_defaults(clone(dict(manifest)))
            new["metadata"]["managedFields"] = ownership.record(
                [], self.manager, "Update", ownership.leaves(new), (), ref.api_version
            )
            return self.write(what, ref, None, new, dry_run=dry_run)

    def review(self, api_version: str, kind: str, spec: Mapping[str, Any]) -> Mapping[str, Any]:
        """Answer what we may do."""
        assert api_version == "authorization.k8s.io/v1"
        with self.store.lock:
            self.note("review", kind)
        if kind == "SelfSubjectRulesReview":
            return {"resourceRules": self.store.rules, "incomplete": False}
        asked = spec["resourceAttributes"]
        resource = "/".join(filter(None, (asked["resource"], asked["subresource"])))
        right = Right(asked["group"], resource, asked["verb"])
        return {"allowed": any(map(right.is_granted_by, self.store.rules))}

    def replace(self, manifest: Mapping[str, Any]) -> Live:
        ref, what = ref_of(manifest), f"replace {ref_of(manifest)}"
        with self.store.lock:
            self.note("replace", ref)
            old = self.require(ref, what)
            new = clone(dict(manifest))
            return self.update(what, ref, old, new)

    def patch(self, ref: ObjectRef, body: Mapping[str, Any]) -> Live:
        what = f"patch {ref}"
        with self.store.lock:
            self.note("patch", ref)
            old = self.require(ref, what)
            new = merge_patched(old, body)
            return self.update(what, ref, old, new)

    def delete(
        self,
        ref: ObjectRef,
        *,
        uid: str | None = None,
        version: str | None = None,
        grace_seconds: int | None = None,
    ) -> bool:
        what = f"delete {ref}"
        with self.store.lock:
            self.note("delete", ref)
            live = self.find(ref, what)
            if live is None:
                return False
            if uid and uid != live["metadata"]["uid"]:
                raise wrong_uid(what, uid, live)
            if version and version != live["metadata"]["resourceVersion"]:
                raise modified(what, ref)
            self.store.delete(ref)
            self.die_if_due()
            return True

    # Pods.

    def logs(self, *args: Any, **options: Any) -> Iterator[str]:
        return iter(["last words"])

    def follow_end(self, namespace: str, pod: str, container: str, *, seconds: float) -> Any:
        """Tell whether a container runs, as its pod's status says: there is no runtime to ask."""
        live = self.objects.get(ObjectRef("v1", "Pod", namespace, pod)) or {}
        states = (live.get("status") or {}).get("containerStatuses") or []
        runs = all("running" in s["state"] for s in states if s["name"] == container)
        return SimpleNamespace(ended=not runs, over=True, settled=True, abort=lambda: None)

    def parallel(
        self, function: Callable[[Any], Any], items: Iterable[Any], *, width: int = 1
    ) -> list[Any]:
        """One after the other, so that the order of requests can be told."""
        return [function(item) for item in items]

    def gather(self, *calls: Callable[[], Any]) -> tuple[Any, ...]:
        return tuple(self.parallel(lambda call: call(), calls))

    # What the requests have in common.

    def note(self, verb: str, about: ObjectRef | str) -> None:
        """Take a request; nobody is there to send one after a kill."""
        if self.store.dead:
            raise Killed
        self.calls.append((verb, about))
        if isinstance(about, ObjectRef) and verb not in READS:
            self.store.before(verb, about)

    def find(self, ref: ObjectRef, what: str) -> Live | None:
        """Return an object; Missing where its kind, or its namespace, is not there."""
        resource = self.store.kinds.get((ref.api_version, ref.kind))
        if resource is None:
            error = Missing(f"cannot {what}: the cluster has no kind {ref.kind}")
            error.status, error.reason = 404, "NoKind"
            raise error
        home = ObjectRef("v1", "Namespace", "", ref.namespace)
        if resource.namespaced and home not in self.objects:
            raise make_refusal(what, 404, "NotFound", f'namespaces "{ref.namespace}" not found')
        return self.objects.get(ref)

    def require(self, ref: ObjectRef, what: str) -> Live:
        live = self.find(ref, what)
        if live is None:
            raise make_refusal(what, 404, "NotFound", f'"{ref.name}" not found')
        return live

    def update(self, what: str, ref: ObjectRef, old: Live, new: Live) -> Live:
        """Store what an update (not an apply) makes of an object."""
        meta, was = new["metadata"], old["metadata"]
        if meta.get("uid") not in (None, was["uid"]):
            raise wrong_uid(what, meta["uid"], old)
        if meta.get("resourceVersion") not in (None, was["resourceVersion"]):
            raise modified(what, ref)
        entries = meta.get("managedFields") or was.get("managedFields") or []
        for key in ("uid", "creationTimestamp", "generation", "deletionTimestamp"):
            meta.pop(key, None)
            if key in was:
                meta[key] = was[key]
        if "status" in old:
            new["status"] = clone(old["status"])
        new = fill_defaults(new)
        set_now, gone = ownership.compare(old, new)
        mine = {
            path
            for entry in entries
            if ownership.is_of(entry, self.manager, "Update")
            for path in ownership.paths(entry["fieldsV1"])
        }
        meta["managedFields"] = ownership.record(
            entries,
            self.manager,
            "Update",
            (mine | set_now) - gone,
            set_now | gone,
            ref.api_version,
        )
        return self.write(what, ref, old, new)

    def write(
        self, what: str, ref: ObjectRef, old: Live | None, new: Live, *, dry_run: bool = False
    ) -> Live:
        """Check what is to be stored, and store it where it is no dry run."""
        new = fill_defaults(new)
        if error := self.store.refuse(new, dry_run):
            raise error
        check(what, ref, old, new)
        home = self.objects.get(ObjectRef("v1", "Namespace", "", ref.namespace)) or {"metadata": {}}
        if old is None and home["metadata"].get("deletionTimestamp"):
            text = f"unable to create new content in namespace {ref.namespace}"
            raise make_refusal(what, 403, "Forbidden", f"{text} because it is being terminated")
        if not dry_run:
            stored = clone(self.store.commit(ref, old, new))
            self.die_if_due()
            return stored
        if old is None:
            new["metadata"].setdefault("uid", str(uuid.uuid4()))
        else:
            new["metadata"]["resourceVersion"] = old["metadata"]["resourceVersion"]
        return clone(new)

    def die_if_due(self) -> None:
        """Die where the test wants it."""
        if self.store.die_after is not None:
            self.store.die_after -= 1
            if self.store.die_after <= 0:
                self.store.dead = True
                raise Killed

    # For tests.

    def scale(self, ref: ObjectRef, replicas: int) -> Live:
        """Write an object's `scale`, as `kubectl scale` and autoscalers do.

        The number then has no owner: Kubernetes 1.37 does not record who did it.
        """
        what = f"scale {ref}"
        with self.store.lock:
            old = self.require(ref, what)
            path: ownership.Path = ("f:spec", "f:replicas")
            entries = old["metadata"].get("managedFields") or []
            kept = ownership.record(entries, "", "", (), {path}, ref.api_version)
            new = clone(old)
            new["spec"]["replicas"] = replicas
            new["metadata"]["managedFields"] = kept
            return self.write(what, ref, old, new)

    def settle(self, steps: int = 50) -> None:
        """Let the controllers do all that they have to."""
        with self.store.lock:
            for _ in range(steps):
                self.store.tick()

    def revive(self) -> None:
        """Let requests through again after a kill: another process sends them."""
        self.store.dead, self.store.die_after = False, None

    def names(self, *kinds: str) -> set[str]:
        """Return the names of all objects of some kinds."""
        return {ref.name for ref in self.objects if ref.kind in kinds}


@attrs.frozen
class Selection:
    """Which objects a list or a watch is about."""

    api_version: str
    kind: str
    namespace: str
    labels: str
    fields: str | None

    def has(self, live: Mapping[str, Any]) -> bool:
        ref = ref_of(live)
        if (ref.api_version, ref.kind) != (self.api_version, self.kind):
            return False
        if ref.namespace and self.namespace not in ("", ref.namespace):
            return False
        own = live["metadata"].get("labels") or {}
        return all(fits(term, own) for term in filter(None, self.labels.split(","))) and all(
            at(live, term.partition("=")[0]) == term.partition("=")[2]
            for term in filter(None, (self.fields or "").split(","))
        )


def fits(term: str, labels: Mapping[str, str]) -> bool:
    """Whether labels fulfil one term of a selector: `a=b`, `a!=b`, `a` or `!a`."""
    if "!=" in term:
        key, _, value = term.partition("!=")
        return labels.get(key) != value
    if "=" in term:
        key, _, value = term.partition("=")
        return labels.get(key) == value.removeprefix("=")
    return term[1:] not in labels if term.startswith("!") else term in labels


def at(live: Mapping[str, Any], path: str) -> str:
    found: Any = live
    for key in path.split("."):
        found = (found or {}).get(key)
    return str(found or "")


def now() -> str:
    return datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")


def substance(live: Live) -> Live:
    meta = {k: v for k, v in live["metadata"].items() if k not in ("resourceVersion", "generation")}
    return {**live, "metadata": meta}


def name_fields(ref: ObjectRef) -> dict[str, str]:
    return {"name": ref.name, **({"namespace": ref.namespace} if ref.namespace else {})}


def free_of_status(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of an applied manifest's metadata that an apply may set."""
    names = (*ownership.UNOWNED_META[2:],)
    return {key: value for key, value in manifest["metadata"].items() if key not in names}


def merge_patched(value: Any, patch: Any) -> Any:
    """Return a value with a JSON merge patch (RFC 7396)."""
    if not isinstance(patch, Mapping):
        return clone(patch)
    result = clone(dict(value)) if isinstance(value, Mapping) else {}
    for key, part in patch.items():
        if part is None:
            result.pop(key, None)
        else:
            result[key] = merge_patched(result.get(key), part)
    return result


def fill_defaults(live: Live) -> Live:
    """Fill in what Kubernetes fills in, as far as somebody has tripped over it."""
    if live["kind"] == "Job":  # each has a label of its own
        own = live["metadata"].setdefault("uid", str(uuid.uuid4()))
        selector = live["spec"].setdefault("selector", {"matchLabels": {"controller-uid": own}})
        meta = live["spec"]["template"].setdefault("metadata", {})
        meta["labels"] = {**(meta.get("labels") or {}), **selector["matchLabels"]}
    if live["kind"] == "Deployment":
        spec = live["spec"]
        spec.setdefault("replicas", 1)
        strategy = spec.setdefault("strategy", {})
        if strategy.setdefault("type", "RollingUpdate") == "RollingUpdate":
            rolling = strategy.setdefault("rollingUpdate", {})
            rolling.setdefault("maxSurge", "25%")
            rolling.setdefault("maxUnavailable", "25%")
    return live


def check(what: str, ref: ObjectRef, old: Live | None, new: Live) -> None:
    """Raise where Kubernetes' own validation refuses."""
    if ref.kind not in ("Deployment", "Job"):
        return
    spec, causes = new["spec"], []
    if ref.kind == "Job":
        if old is not None and old["spec"]["template"] != spec["template"]:
            text = f"Invalid value: {json.dumps(spec['template'])}: field is immutable"
            causes.append(cause("FieldValueInvalid", text, "spec.template"))
    elif spec["strategy"]["type"] == "Recreate" and spec["strategy"].get("rollingUpdate"):
        text = "Forbidden: may not be specified when strategy `type` is 'Recreate'"
        causes.append(cause("FieldValueForbidden", text, "spec.strategy.rollingUpdate"))
    if old is not None and old["spec"].get("selector") != spec.get("selector"):
        text = f"Invalid value: {json.dumps(spec['selector'])}: field is immutable"
        causes.append(cause("FieldValueInvalid", text, "spec.selector"))
    if causes:
        told = ", ".join(f"{c['field']}: {c['message']}" for c in causes)
        text = f'{ref.kind} "{ref.name}" is invalid: {told}'
        raise make_refusal(what, 422, "Invalid", text, causes)


def cause(reason: str, message: str, field: str) -> dict[str, str]:
    return {"reason": reason, "message": message, "field": field}


def field_conflict(what: str, others: Sequence[tuple[str, ownership.Path]]) -> Refusal:
    causes = [
        cause(
            "FieldManagerConflict", f'conflict with "{manager}" using v1', ownership.name_of(path)
        )
        for manager, path in others
    ]
    told = ", ".join(c["field"] for c in causes)
    text = f"Apply failed with {len(causes)} conflict(s): {told}"
    return make_refusal(what, 409, "Conflict", text, causes)


def check_condition(what: str, ref: ObjectRef, old: Live | None, onto: Onto) -> None:
    """Refuse an apply onto something else than it says."""
    uid, version = (onto.metadata.get(key) for key in ("uid", "resourceVersion"))
    if old is None:
        if uid:
            raise make_refusal(what, 409, "Conflict", f"uid mismatch: {uid}, and nothing is there")
        return
    if uid not in (None, old["metadata"]["uid"]):
        raise wrong_uid(what, str(uid), old)
    if version not in (None, old["metadata"]["resourceVersion"]):
        raise modified(what, ref)


def modified(what: str, ref: ObjectRef) -> Refusal:
    text = "the object has been modified; please apply your changes to the latest version"
    told = f'Operation cannot be fulfilled on "{ref.name}": {text}'
    return make_refusal(what, 409, "Conflict", told)


def wrong_uid(what: str, uid: str, live: Live) -> Refusal:
    text = f"Precondition failed: UID in precondition: {uid}, UID in object meta: "
    return make_refusal(what, 409, "Conflict", text + live["metadata"]["uid"])


def make_refusal(
    what: str, status: int, reason: str, message: str, causes: Sequence[Mapping[str, str]] = ()
) -> Refusal:
    """Return the error that the client makes of such an answer."""
    answer = {"message": message, "reason": reason, "details": {"causes": list(causes)}}
    body = json.dumps(answer).encode()
    return refusal(status, body, what, context="fake", server="https://fake")
