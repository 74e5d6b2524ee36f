"""The shape of an API server's answers: only checked values leave this package.

Proxies, login pages and broken servers answer too. A reader here takes parsed JSON and returns it
as the type that other packages rely on, or raises ValueError with the reason.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

#: What an object may have apart from `metadata`, and is a mapping if it is there.
MAPPINGS = ("spec", "status", "data")
EVENTS = frozenset({"ADDED", "MODIFIED", "DELETED", "BOOKMARK", "ERROR"})


def parse(body: bytes) -> Any:
    """Return JSON as values; raises ValueError if it is not JSON."""
    try:
        return json.loads(body)
    except RecursionError as error:
        raise ValueError("it is nested too deeply") from error
    except UnicodeDecodeError as error:
        raise ValueError("it is not UTF-8") from error
    except ValueError as error:
        raise ValueError("it is not JSON" if body.strip() else "it is empty") from error


def read_mapping(value: Any) -> dict[str, Any]:
    """Return a JSON object."""
    if not isinstance(value, dict):
        raise ValueError(f"it is {describe(value)} where an object is expected")
    return value


def read_object(value: Any) -> dict[str, Any]:
    """Return a Kubernetes object: it has a name, and what should be a mapping is one."""
    found = read_mapping(value)
    meta = read_metadata(found)
    if not isinstance(meta.get("name"), str):
        raise ValueError("its metadata has no name")
    for key in ("uid", "resourceVersion"):
        if not isinstance(meta.get(key, ""), str):
            raise ValueError(f"its metadata.{key} is {describe(meta[key])}")
    for part, keys in ((meta, ("labels", "annotations")), (found, MAPPINGS)):
        for key in keys:
            if not isinstance(part.get(key) or {}, dict):
                raise ValueError(f"its {key} is {describe(part[key])}")
    return found


def read_deleted(value: Any) -> dict[str, Any]:
    """Return the answer to a deletion: a Status of success, or the object while it ends."""
    found = read_mapping(value)
    if found.get("kind") != "Status":
        return read_object(found)
    if found.get("status") != "Success":
        raise ValueError("it is a Status without success")
    return found


def read_review(value: Any) -> dict[str, Any]:
    """Return a review that the API server has answered: it has a status."""
    found = read_mapping(value)
    if not isinstance(found.get("status"), dict):
        raise ValueError("it has no status")
    return found


def read_list(value: Any) -> dict[str, Any]:
    """Return a list of Kubernetes objects; `items` may be null."""
    found = read_mapping(value)
    read_metadata(found)
    if "items" not in found or not isinstance(found["items"] or [], list):
        raise ValueError("it has no list of items")
    for item in found["items"] or []:
        read_object(item)
    return found


def read_start(value: Any) -> dict[str, Any]:
    """Return a list from which a watch continues: it has a version, and each object a UID."""
    found = read_list(value)
    if not isinstance(found["metadata"].get("resourceVersion"), str):
        raise ValueError("its metadata has no resourceVersion")
    for item in found["items"] or []:
        read_watched(item)
    return found


def read_watched(value: Any) -> dict[str, Any]:
    """Return an object that a watch remembers by its UID."""
    found = read_object(value)
    if "uid" not in found["metadata"]:
        raise ValueError("its metadata has no uid")
    return found


def read_event(value: Any) -> tuple[str, dict[str, Any]]:
    """Return the type and the object of an event of a watch."""
    found = read_mapping(value)
    kind = found.get("type")
    if kind not in EVENTS:
        raise ValueError("it is not an event of a watch")
    if kind == "ERROR":
        return kind, read_mapping(found.get("object"))
    if kind == "BOOKMARK":
        read_metadata(read_mapping(found.get("object")))
        return kind, found["object"]
    return kind, read_watched(found.get("object"))


def read_version(value: Any) -> str:
    """Return the API server's version."""
    version = read_mapping(value).get("gitVersion")
    if not isinstance(version, str):
        raise ValueError("it names no version")
    return version


def read_kinds(value: Any) -> dict[str, Any]:
    """Return the resource list of an API version; `resources` may be null."""
    found = read_mapping(value)
    if "resources" not in found or not isinstance(found["resources"] or [], list):
        raise ValueError("it has no list of resources")
    for entry in find_mappings(found, "resources"):
        if not isinstance(entry.get("name"), str) or not isinstance(entry.get("kind"), str):
            raise ValueError("it lists a resource without a name")
    return {**found, "resources": find_mappings(found, "resources")}


def read_metadata(value: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the metadata of an object or a list."""
    meta = value.get("metadata")
    if not isinstance(meta, dict):
        raise ValueError("it has no metadata")
    return meta


def find_mapping(value: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """Return a part that is a mapping, an empty one if it is anything else."""
    part = value.get(key)
    return part if isinstance(part, dict) else {}


def find_mappings(value: Mapping[str, Any], key: str) -> list[Mapping[str, Any]]:
    """Return the mappings of a list; none if it is not a list."""
    part = value.get(key)
    return [one for one in part if isinstance(one, dict)] if isinstance(part, list) else []


def describe(value: object) -> str:
    """Return the type of a JSON value, as a phrase."""
    names = {dict: "an object", list: "a list", str: "text", bool: "a boolean", type(None): "null"}
    return names.get(type(value), "a number")
