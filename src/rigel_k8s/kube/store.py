"""The objects of a cluster: read, written by server-side apply and other verbs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import attrs

from rigel_k8s.kube.answers import read_deleted, read_list, read_object, read_review
from rigel_k8s.kube.client import Client
from rigel_k8s.kube.failures import Conflict, Missing, Refusal
from rigel_k8s.kube.resources import path, with_query
from rigel_k8s.kube.watching import label_selector
from rigel_k8s.objects.marks import FIELD_MANAGER
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of


@attrs.frozen
class Onto:
    """What must exist: metadata that the API server compares."""

    metadata: Mapping[str, str] = attrs.field(factory=dict)


ANYTHING = Onto()
NOTHING = Onto({"resourceVersion": "1"})


def this_object(live: Manifest) -> Onto:
    """Return the condition that the object with this UID still exists, in any state."""
    return Onto({"uid": live["metadata"]["uid"]})


def this_state(live: Manifest) -> Onto:
    """Return the condition that an object has not changed at all, not even its status."""
    meta = live["metadata"]
    return Onto({"uid": meta["uid"], "resourceVersion": meta["resourceVersion"]})


def another_object_error(error: Refusal) -> Conflict:
    """Return the error for a 422 about the UID: another object has the name now."""
    conflict = Conflict(error.message, hint=error.hint, details=error.details)
    conflict.status, conflict.reason = 409, "Conflict"
    return conflict


PAGE = 500
DELETES = 3  # attempts to delete an object that others write at the same moment
METADATA_ONLY = "application/json;as=PartialObjectMetadataList;g=meta.k8s.io;v=v1"
PATCHES = {
    "merge": "application/merge-patch+json",
    "strategic": "application/strategic-merge-patch+json",
    "apply": "application/apply-patch+yaml",  # JSON is YAML
}


class Store:
    """Objects in, objects out, without HTTP."""

    client: Client

    def get(self, ref: ObjectRef) -> dict[str, Any] | None:
        """Return an object, None if it or its kind does not exist."""
        try:
            what = f"read {ref}"
            return self.client.call("GET", self.client.path_of(ref, what), what, read_object)
        except Missing:
            return None

    def list(
        self,
        api_version: str,
        kind: str,
        namespace: str | None = None,
        *,
        labels: str | Mapping[str, str] | None = None,
        fields: str | None = None,
        metadata_only: bool = False,
    ) -> list[dict[str, Any]]:
        """Return all objects of a kind, of one namespace or of all; none if the kind is unknown.

        Args:
            labels: a label selector, or labels that must all be there.
            fields: a field selector.
            metadata_only: leave spec, data and status out, which saves time.
        """
        resource = self.client.resources.find(api_version, kind)
        if resource is None:
            return []
        query: dict[str, Any] = {
            "labelSelector": label_selector(labels),
            "fieldSelector": fields,
            "limit": PAGE,
        }
        accept = METADATA_ONLY if metadata_only else "application/json"
        found: list[dict[str, Any]] = []
        while True:
            url = path(api_version, resource, namespace or "", query=query)
            page = self.client.call("GET", url, f"list {kind}s", read_list, accept=accept)
            found += page.get("items") or []
            query["continue"] = page["metadata"].get("continue")
            if not query["continue"]:
                return [{**item, "apiVersion": api_version, "kind": kind} for item in found]

    def apply(
        self,
        manifest: Manifest,
        *,
        force: bool = False,
        dry_run: bool = False,
        onto: Onto = ANYTHING,
    ) -> dict[str, Any]:
        """Apply a manifest server-side and return the resulting object.

        What we patched before, without an apply, is ours: Kubernetes keeps that as a separate
        record, and an apply with another value would conflict with it.

        Args:
            force: take fields over that another manager owns.
            onto: what must exist for the apply to have an effect.

        Raises:
            Conflict: another manager owns fields with other values (`fields` names them), or
                    another object exists than `onto` requires (`fields` is empty).
        """
        ref = ref_of(manifest)
        what = f"apply {ref}"
        query = {
            "fieldManager": FIELD_MANAGER,
            "force": force and "true",
            "dryRun": dry_run and "All",
        }
        url = self.client.path_of(ref, what, query=query)
        body = {**manifest, "metadata": {**manifest["metadata"], **onto.metadata}}
        try:
            return self.client.write("PATCH", url, what, body, PATCHES["apply"])
        except Conflict as error:
            if force or {field.manager for field in error.fields} != {FIELD_MANAGER}:
                raise
        except Refusal as error:
            if "metadata.uid" not in {cause.field for cause in error.causes}:
                raise
            raise another_object_error(error) from error
        return self.apply(manifest, force=True, dry_run=dry_run, onto=onto)

    def create(self, manifest: Manifest, *, dry_run: bool = False) -> dict[str, Any]:
        """Create an object; Conflict (reason AlreadyExists) if it exists."""
        ref = ref_of(manifest)
        what = f"create {ref}"
        resource = self.client.resource(ref.api_version, ref.kind, what)
        query = {"fieldManager": FIELD_MANAGER, "dryRun": dry_run and "All"}
        url = path(ref.api_version, resource, ref.namespace, query=query)
        return self.client.write("POST", url, what, manifest)

    def review(self, api_version: str, kind: str, spec: Mapping[str, Any]) -> Mapping[str, Any]:
        """Send a review, an object that is answered and not kept; return its status."""
        what = f"send a {kind} to the API server"
        url = path(api_version, self.client.resource(api_version, kind, what), "")
        # It stores nothing anyway; a dry run shows that to a reader of a deploy's requests.
        url = with_query(url, {"dryRun": "All"})
        body = {"apiVersion": api_version, "kind": kind, "spec": spec}
        answer = self.client.call("POST", url, what, read_review, body=body, safe=True)
        status: Mapping[str, Any] = answer["status"]
        return status

    def replace(self, manifest: Manifest) -> dict[str, Any]:
        """Replace an object; Conflict if it has a resourceVersion that is no longer current."""
        ref = ref_of(manifest)
        what = f"replace {ref}"
        url = self.client.path_of(ref, what, query={"fieldManager": FIELD_MANAGER})
        return self.client.write("PUT", url, what, manifest)

    def patch(
        self,
        ref: ObjectRef,
        body: object,
        *,
        style: Literal["merge", "strategic"] = "merge",
        subresource: str = "",
    ) -> dict[str, Any]:
        what = f"patch {ref}"
        query = {"fieldManager": FIELD_MANAGER}
        url = self.client.path_of(ref, what, subresource=subresource, query=query)
        return self.client.write("PATCH", url, what, body, PATCHES[style])

    def delete(
        self,
        ref: ObjectRef,
        *,
        uid: str | None = None,
        version: str | None = None,
        grace_seconds: int | None = None,
    ) -> bool:
        """Delete an object and return whether it existed.

        Args:
            uid: delete this very object; Conflict if another one has its name now. After a conflict
                about anything else it is tried again.
            version: delete it in this very state; Conflict if it has changed since.
        """
        options: dict[str, Any] = {
            "kind": "DeleteOptions",
            "apiVersion": "v1",
            "propagationPolicy": "Background",
        }
        conditions = {"uid": uid, "resourceVersion": version}
        if set_conditions := {key: value for key, value in conditions.items() if value}:
            options["preconditions"] = set_conditions
        if grace_seconds is not None:
            options["gracePeriodSeconds"] = grace_seconds
        for _ in range(DELETES):
            try:
                return self._delete(ref, options)
            except Conflict as error:
                if version or not uid:
                    raise
                conflict, live = error, self.get(ref)
                if live is None:
                    return True
                if live["metadata"]["uid"] != uid:
                    raise
        raise Refusal(conflict.message, hint="it still exists: run the command again") from conflict

    def _delete(self, ref: ObjectRef, options: Mapping[str, Any]) -> bool:
        what = f"delete {ref}"
        try:
            url = self.client.path_of(ref, what)
            self.client.call("DELETE", url, what, read_deleted, body=options, safe=True)
        except Missing as error:
            return error.doubtful
        return True
