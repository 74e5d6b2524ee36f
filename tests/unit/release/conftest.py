"""The one fake of these tests: a cluster in memory, with server-side apply as far as needed."""

from __future__ import annotations

import copy
import itertools
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import attrs
import pytest

from rigel_k8s.kube.failures import Conflict, Missing, Refusal
from rigel_k8s.kube.watching import WatchEvent, label_selector
from rigel_k8s.objects.refs import ObjectRef, ref_of


def fields(value: Any) -> dict[str, Any]:
    """Return the ownership of all of a value, as server-side apply would record it."""
    if isinstance(value, dict):
        return {f"f:{key}": fields(part) for key, part in value.items()}
    return {}


@attrs.define
class FakeCluster:
    """Objects in memory; `calls` are the requests that it got.

    Attributes:
        settle: what a controller makes of an object, called when it is stored.
        refuse: returns the error that a dry run ends with, or None.
    """

    objects: dict[ObjectRef, dict[str, Any]] = attrs.field(factory=dict)
    calls: list[tuple[str, ObjectRef | str]] = attrs.field(factory=list)
    settle: Callable[[dict[str, Any]], None] = lambda live: None
    refuse: Callable[[Mapping[str, Any]], Refusal | None] = lambda manifest: None
    numbers: Iterator[int] = attrs.field(factory=itertools.count)

    @property
    def writes(self) -> list[tuple[str, ObjectRef | str]]:
        return [call for call in self.calls if call[0] not in ("get", "list", "try")]

    def store(self, manifest: Mapping[str, Any], uid: str = "") -> dict[str, Any]:
        live = copy.deepcopy(dict(manifest))
        number = str(next(self.numbers))
        live["metadata"] |= {"uid": uid or f"u{number}", "resourceVersion": number}
        live["metadata"].setdefault("generation", 1)
        self.settle(live)
        self.objects[ref_of(live)] = live
        return copy.deepcopy(live)

    def get(self, ref: ObjectRef) -> dict[str, Any] | None:
        self.calls.append(("get", ref))
        return copy.deepcopy(self.objects.get(ref))

    def list(
        self,
        api_version: str,
        kind: str,
        namespace: str | None = None,
        *,
        labels: Any = None,
        fields: Any = None,
        metadata_only: bool = False,
    ) -> list[dict[str, Any]]:
        self.calls.append(("list", kind))
        wanted = set(filter(None, label_selector(labels).split(",")))
        return [
            copy.deepcopy(live)
            for ref, live in self.objects.items()
            if (ref.api_version, ref.kind) == (api_version, kind)
            and namespace in (None, "", ref.namespace)
            and wanted <= {f"{k}={v}" for k, v in (live["metadata"].get("labels") or {}).items()}
        ]

    def apply(
        self, manifest: Mapping[str, Any], *, force: bool = False, dry_run: bool = False
    ) -> dict[str, Any]:
        ref = ref_of(manifest)
        self.calls.append(("try" if dry_run else "apply", ref))
        if dry_run and (error := self.refuse(manifest)):
            raise error
        old = self.objects.get(ref)
        body = {k: v for k, v in manifest.items() if k not in ("apiVersion", "kind")}
        owner = {"manager": "rigel", "operation": "Apply", "apiVersion": "v1"}
        new = copy.deepcopy(dict(manifest))
        new["metadata"]["managedFields"] = [{**owner, "fieldsV1": fields(body)}]
        if dry_run:
            version = {"resourceVersion": old["metadata"]["resourceVersion"]} if old else {}
            return {**new, "metadata": {**new["metadata"], "uid": "dry", **version}}
        return self.store(new, old["metadata"]["uid"] if old else "")

    def create(self, manifest: Mapping[str, Any]) -> dict[str, Any]:
        ref = ref_of(manifest)
        self.calls.append(("create", ref))
        if ref in self.objects:
            error = Conflict(f"{ref} exists")
            error.status, error.reason = 409, "AlreadyExists"
            raise error
        return self.store(manifest)

    def replace(self, manifest: Mapping[str, Any]) -> dict[str, Any]:
        self.calls.append(("replace", ref_of(manifest)))
        return self.store(manifest, self.objects[ref_of(manifest)]["metadata"]["uid"])

    def patch(self, ref: ObjectRef, body: Mapping[str, Any]) -> dict[str, Any]:
        self.calls.append(("patch", ref))
        if ref not in self.objects:
            raise Missing(f"{ref} not found")
        live = self.objects[ref]
        live["metadata"]["labels"] = {
            **(live["metadata"].get("labels") or {}),
            **(body.get("metadata", {}).get("labels") or {}),
        }
        live |= {key: value for key, value in body.items() if key != "metadata"}
        live["metadata"]["resourceVersion"] = str(next(self.numbers))
        return copy.deepcopy(live)

    def delete(self, ref: ObjectRef, *, uid: str | None = None) -> bool:
        self.calls.append(("delete", ref))
        return self.objects.pop(ref, None) is not None

    def watch(self, api_version: str, kind: str, *args: Any, **options: Any) -> Iterator[Any]:
        for live in self.list(api_version, kind):
            yield WatchEvent("ADDED", live)

    def serves(self, api_version: str, kind: str) -> bool:
        return True

    def events(self, live: Mapping[str, Any]) -> list[dict[str, Any]]:
        return []

    def logs(self, *args: Any, **options: Any) -> Iterator[str]:
        return iter(["last words"])

    def parallel(self, function: Callable[[Any], Any], items: Iterable[Any]) -> list[Any]:
        return [function(item) for item in items]


@attrs.define
class Recorder:
    """A reporter that remembers."""

    lines: list[str] = attrs.field(factory=list)
    warnings: list[str] = attrs.field(factory=list)

    def line(self, text: str) -> None:
        self.lines.append(text)

    def warn(self, text: str) -> None:
        self.warnings.append(text)

    def progress(self, key: str, state: str, *, done: bool = False) -> None:
        """States are not looked at here."""


@pytest.fixture
def fake() -> FakeCluster:
    """A cluster in memory with the namespace `n`."""
    cluster = FakeCluster()
    cluster.store({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": "n"}})
    return cluster


@pytest.fixture
def report() -> Recorder:
    """A reporter that remembers."""
    return Recorder()
