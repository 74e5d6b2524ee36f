"""The records of a release: compressed Secrets, one for each revision, and few of them.

A good deploy leaves LIMIT of them, and the good one before it. Until there is one, at most LIMIT
unfinished ones come to that: every look at a release reads all of its records.

A record is a contract with later versions of this tool: its format has a number. It contains no
Secret's data. Anyone may have changed or made one: a Secret of another name is none, and what
cannot be read is an error with the Secret's name.
"""

from __future__ import annotations

import base64
import gzip
import hashlib
import json
import re
import uuid
import zlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, get_args

import attrs

from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.kube.answers import read_object
from rigel_k8s.kube.cluster import Cluster
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.release.types import InventoryItem, ReleaseId, Revision, RevisionStatus

LIMIT = 10
#: Bytes that Kubernetes accepts as the data of a Secret.
MAX_SIZE = 1024 * 1024
#: Bytes that a record may have before it is compressed.
MAX_CONTENT = 48 * MAX_SIZE
#: What is raised where a value is of another shape than it should be.
DAMAGES = (AttributeError, LookupError, TypeError, ValueError)
#: The same of one that is compressed JSON.
UNREADABLE = (*DAMAGES, OSError, EOFError, zlib.error, RecursionError)
FORMAT = 1
TYPE = f"rigel-k8s/release.v{FORMAT}"
OF, NUMBER, STATUS = "rigel-k8s/revision-of", "rigel-k8s/revision", "rigel-k8s/status"
CREATED, BY, DESCRIPTION, VERSION, BACK_TO, FAILURE, SOURCE = (
    "rigel-k8s/created",
    "rigel-k8s/by",
    "rigel-k8s/description",
    "rigel-k8s/tool-version",
    "rigel-k8s/back-to",
    "rigel-k8s/failure",
    "rigel-k8s/source",
)


@attrs.frozen
class Record:
    """A revision as it is kept: what can be read without decompressing it, and the rest.

    Attributes:
        back_to: the revision that this rollback deploys again; None for a deploy.
    """

    release: ReleaseId
    number: int
    status: RevisionStatus
    back_to: int | None
    secret: Mapping[str, Any]

    @property
    def failure(self) -> str:
        """Why it failed; "" if it did not, or that is unknown."""
        return str((self.secret["metadata"].get("annotations") or {}).get(FAILURE, ""))

    @property
    def source(self) -> str:
        """The folder of the Rigelfile; "" if it is not known."""
        return str((self.secret["metadata"].get("annotations") or {}).get(SOURCE, ""))

    @property
    def ref(self) -> ObjectRef:
        """The Secret's reference."""
        return secret_ref(self.release, self.number)

    def revision(self) -> Revision:
        """Return the whole revision.

        Raises:
            ClusterError: it was written by a version of this tool whose format is unknown.
        """
        return decode(self)


def secret_ref(release: ReleaseId, number: int) -> ObjectRef:
    """Return the name of a revision's Secret."""
    return ObjectRef("v1", "Secret", release.namespace, f"rigel.{release.name}.v{number}")


def records(cluster: Cluster, release: ReleaseId) -> list[Record]:
    """Return all records of a release, the oldest first."""
    return read_all(cluster.list("v1", "Secret", release.namespace, labels={OF: release.name}))


def read_all(secrets: Iterable[Mapping[str, Any]]) -> list[Record]:
    """Return the records among Secrets, the oldest first.

    Raises:
        ClusterError: the labels or annotations of one are damaged.
    """
    found = [read(secret) for secret in secrets if number_of(secret)]
    return sorted(found, key=lambda record: record.number)


def number_of(secret: Mapping[str, Any]) -> int:
    """Return the number of a revision by its Secret's name; 0 if it is no revision."""
    meta = secret["metadata"]
    name = rf"rigel\.{re.escape(meta['labels'][OF])}\.v([1-9][0-9]{{0,8}})"
    found = re.fullmatch(name, meta["name"])
    return int(found[1]) if found else 0


def read(secret: Mapping[str, Any]) -> Record:
    """Return the record that a Secret is.

    Raises:
        ClusterError: its labels or annotations are damaged.
    """
    meta = secret["metadata"]
    labels, back = meta["labels"], (meta.get("annotations") or {}).get(BACK_TO) or "0"
    release, number = ReleaseId(meta["namespace"], labels[OF]), number_of(secret)
    if labels.get(NUMBER) != str(number):
        raise damaged_error(release, number, secret, f"its label {NUMBER} is {labels.get(NUMBER)}")
    if (status := labels.get(STATUS)) not in get_args(RevisionStatus):
        raise damaged_error(release, number, secret, f"its label {STATUS} is {status}")
    if not re.fullmatch("[0-9]{1,9}", back):
        raise damaged_error(release, number, secret, f"its annotation {BACK_TO} is {back}")
    return Record(release, number, status, int(back) or None, secret)


def versions(kept: Iterable[Record]) -> list[str]:
    """Return a value that changes when any record does."""
    return [str(record.secret["metadata"]["resourceVersion"]) for record in kept]


def history(cluster: Cluster, release: ReleaseId) -> list[Revision]:
    """Return a release's revisions, the oldest first."""
    found = [record.revision() for record in records(cluster, release)]
    good = [revision.number for revision in found if revision.status == "good"]
    return [
        attrs.evolve(revision, status="superseded") if revision.number in good[:-1] else revision
        for revision in found
    ]


def find_last_good(cluster: Cluster, release: ReleaseId) -> Revision | None:
    """Return the newest revision that became ready, None if none did."""
    good = [record for record in records(cluster, release) if record.status == "good"]
    return good[-1].revision() if good else None


def find_good(kept: Iterable[Record]) -> int:
    """Return the number of the newest revision that became ready, 0 if none did."""
    return max((record.number for record in kept if record.status == "good"), default=0)


def create(cluster: Cluster, revision: Revision) -> None:
    """Write a new record; Conflict where another run has written this number."""
    cluster.create(encode(revision))


def update(cluster: Cluster, revision: Revision) -> None:
    """Overwrite a record's status, inventory and failure."""
    secret = encode(revision)
    metadata = {name: secret["metadata"][name] for name in ("labels", "annotations")}
    body = {"metadata": metadata, "data": secret["data"]}
    cluster.patch(secret_ref(revision.release, revision.number), body)


def forget_old(cluster: Cluster, kept: Sequence[Record]) -> None:
    """Delete the oldest records beyond LIMIT, but not the last good two: `rollback` needs both."""
    good = [record for record in kept if record.status == "good"][-2:]
    forget(cluster, [record for record in kept[:-LIMIT] if record not in good])


def forget_unfinished(
    cluster: Cluster, kept: Sequence[Record], target: int | None
) -> Sequence[Record]:
    """Delete the oldest unfinished records, and return the others; there is room for a new one.

    Args:
        target: the revision that the new one goes back to; it stays.
    """
    unfinished = [record for record in kept if record.status != "good"]
    old = [record for record in unfinished[: 1 - LIMIT] if record.number != target]
    forget(cluster, old)
    return [record for record in kept if record not in old]


def forget(cluster: Cluster, old: Iterable[Record]) -> None:
    """Delete records."""
    cluster.parallel(lambda record: cluster.delete(record.ref), old)


def record(revision: Revision) -> Record:
    """Return the record of a revision as it has just been written."""
    return read(encode(revision))


def choose_recordable(manifests: Iterable[Manifest]) -> tuple[Manifest, ...]:
    """Return the manifests that a record may contain: all but Secrets."""
    return tuple(manifest for manifest in manifests if manifest["kind"] != "Secret")


def encode(revision: Revision) -> dict[str, Any]:
    ref = secret_ref(revision.release, revision.number)
    data = base64.b64encode(compress(write_content(revision))).decode()
    notes = {
        CREATED: revision.created,
        BY: revision.by,
        DESCRIPTION: revision.description,
        VERSION: revision.tool_version,
    }
    if revision.back_to is not None:
        notes[BACK_TO] = str(revision.back_to)
    if revision.failure:
        notes[FAILURE] = revision.failure
    if revision.source:
        notes[SOURCE] = revision.source
    return {
        "apiVersion": "v1",
        "kind": "Secret",
        "type": TYPE,
        "metadata": {
            "name": ref.name,
            "namespace": ref.namespace,
            "labels": {
                OF: revision.release.name,
                NUMBER: str(revision.number),
                STATUS: revision.status,
            },
            "annotations": notes,
        },
        "data": {"release": data},
    }


def write_content(revision: Revision) -> bytes:
    """Return what a revision's Secret holds, before it is compressed."""
    payload = {
        "format": FORMAT,
        "objects": choose_recordable(revision.objects),
        "inventory": [[*attrs.astuple(item.ref), item.uid] for item in revision.inventory],
        "options": revision.options,
    }
    return json.dumps(payload, separators=(",", ":"), sort_keys=True).encode()


def compress(content: bytes) -> bytes:
    """Return a revision's content as it is kept."""
    return gzip.compress(content, 6, mtime=0)


def check_size(revision: Revision) -> None:
    """Refuse a revision that no Secret can hold, also when all its objects have their UIDs.

    Raises:
        UserError: it is too large.
    """
    complete = attrs.evolve(
        revision,
        inventory=tuple(
            InventoryItem(item.ref, item.uid or fake_uid(item.ref)) for item in revision.inventory
        ),
    )
    content = write_content(complete)
    if len(content) <= MAX_SIZE:  # the usual case: it need not be compressed to be small enough
        return
    size = len(compress(content))
    if size > MAX_SIZE:
        raise UserError(
            f"the record of {revision.release.name} would take {size // 1024} KiB, and a Secret of"
            f" Kubernetes holds {MAX_SIZE // 1024} KiB; nothing was changed",
            hint="divide it into several jobs with a deployment_name of their own, or put large"
            " texts into the image instead of the Rigelfile",
        )


def fake_uid(ref: ObjectRef) -> str:
    """Return a text as long as a UID that compresses as badly."""
    return str(uuid.UUID(bytes=hashlib.sha256(str(ref).encode()).digest()[:16]))


def decode(record: Record) -> Revision:
    secret = record.secret
    try:
        payload = json.loads(decompress(base64.b64decode(secret["data"]["release"])))
        if payload["format"] != FORMAT:
            known = f"its format is {payload['format']}, this version reads format {FORMAT}"
            raise unreadable_error(record, known)
        objects = tuple(map(read_object, payload["objects"]))
        named = [attrs.astuple(ref_of(manifest)) for manifest in objects]
        inventory = [[*words] for words in payload["inventory"]]
        options = dict(payload["options"] or {})
        if not all(isinstance(word, str) for words in (*named, *inventory) for word in words):
            raise TypeError("what is to be text is none")
        items = tuple(InventoryItem(ObjectRef(*words[:4]), words[4]) for words in inventory)
    except UNREADABLE as error:
        raise unreadable_error(record, "it is damaged") from error
    notes = secret["metadata"].get("annotations") or {}
    return Revision(
        release=record.release,
        number=record.number,
        status=record.status,
        created=notes.get(CREATED, ""),
        by=notes.get(BY, ""),
        objects=objects,
        inventory=items,
        options=options,
        description=notes.get(DESCRIPTION, ""),
        tool_version=notes.get(VERSION, ""),
        back_to=record.back_to,
        failure=record.failure,
        source=record.source,
    )


def decompress(content: bytes) -> bytes:
    """Return the content of a record, which may not be larger than MAX_CONTENT."""
    unpacker = zlib.decompressobj(wbits=zlib.MAX_WBITS | 16)  # gzip's format
    found = unpacker.decompress(content, MAX_CONTENT)
    if not unpacker.eof:
        raise EOFError
    return found


def unreadable_error(record: Record, why: str) -> ClusterError:
    """Return the error for a record that cannot be read."""
    return damaged_error(record.release, record.number, record.secret, why)


def damaged_error(
    release: ReleaseId, number: int, secret: Mapping[str, Any], why: str
) -> ClusterError:
    """Return the error for a revision whose Secret cannot be read."""
    written = (secret["metadata"].get("annotations") or {}).get(VERSION) or "an unknown"
    ref = secret_ref(release, number)
    return ClusterError(
        f"revision {number} of {release.name} cannot be read: {why}",
        hint=f"it was written by version {written} of rigel-k8s: use that, or delete it:"
        f" kubectl -n {ref.namespace} delete secret {ref.name}",
    )
