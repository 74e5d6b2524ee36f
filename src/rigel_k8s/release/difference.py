"""A plan as text, as `diff -u` shows it; pure."""

from __future__ import annotations

import base64
import difflib
import hashlib
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, TypeAlias

import attrs
import yaml

from rigel_k8s.objects.marks import NAME_LABEL
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.objects.text import join_words
from rigel_k8s.release.hiding import cover, hide
from rigel_k8s.release.labelling import HASH_ANNOTATION
from rigel_k8s.release.plan import substance
from rigel_k8s.release.types import Step

HIDDEN_NOTES = (
    HASH_ANNOTATION,
    "deployment.kubernetes.io/revision",
    "kubectl.kubernetes.io/last-applied-configuration",  # the whole object, with its secrets
)
#: The end of a name that changes with the content.
DIGEST = re.compile(r"-[0-9a-f]{10}$")
#: What stands for a text of several lines while the rest is written, and how YAML writes that.
MARK = "!lines "
MARKED = re.compile(rf"( *)(.*)'{MARK}(\d+)'\n")
#: The line above a text's lines, and that above the lines of a difference.
HEAD = re.compile(r" *(.*): \|-?\n")
HUNK = re.compile(r"^@@ -(\d+).*")

#: A file as it was and as it will be, None where it is not.
Change: TypeAlias = tuple[str | None, str | None]


def compare_objects(
    before: Iterable[Manifest], after: Iterable[Manifest], names: tuple[str, str]
) -> str:
    """Return what differs in two revisions' objects as a unified diff, "" if nothing does.

    Args:
        names: of the revisions.
    """
    old, new = ({ref_of(one): one for one in objects} for objects in (before, after))
    steps = [
        Step("create" if ref not in old else "change", ref, live=old.get(ref), result=new[ref])
        for ref in new
    ]
    steps += [Step("prune", ref, live=old[ref]) for ref in old if ref not in new]
    return difference(sorted(steps, key=lambda step: step.ref), names)


def difference(steps: Iterable[Step], names: tuple[str, str] = ("cluster", "Rigelfile")) -> str:
    """Return what steps change as a unified diff, "" if they change nothing.

    An object whose name has a digest of its content is compared with the one whose place it takes.
    Of such objects with the same change in a file, the first one shows it and names the others.
    """
    writes = [step for step in steps if step.writes]
    made = {stem(step.ref) for step in writes if step.action == "create"}
    gone = {stem(step.ref): step for step in writes if step.action == "prune"}
    gone = {key: step for key, step in gone.items() if key in made}
    pairs = [
        (step, gone.get(stem(step.ref)) if step.action == "create" else None)
        for step in writes
        if gone.get(stem(step.ref)) is not step
    ]
    changes = [list_changes(step, before) for step, before in pairs]
    places: dict[Change, list[Step]] = {}
    for (step, _), its in zip(pairs, changes, strict=True):
        for change in its.values():
            places.setdefault(change, []).append(step)
    return "".join(
        step_difference(step, before, {key: places[change] for key, change in its.items()}, names)
        for (step, before), its in zip(pairs, changes, strict=True)
    )


def list_changes(step: Step, gone: Step | None) -> dict[str, Change]:
    """Return the files of a ConfigMap that differ from those of the one whose place it takes."""
    if gone is None or step.ref.kind != "ConfigMap":
        return {}
    sides = (gone.live or {}, step.result or {})
    old, new = ({**(one.get("data") or {}), **(one.get("binaryData") or {})} for one in sides)
    keys = sorted({*old, *new})
    return {key: (old.get(key), new.get(key)) for key in keys if old.get(key) != new.get(key)}


def leave_out(config: Manifest | None, keys: Collection[str]) -> Manifest | None:
    """Return a ConfigMap without some files."""
    if config is None or not keys:
        return config
    parts = {name: config[name] for name in ("data", "binaryData") if name in config}
    kept = {
        name: {key: text for key, text in part.items() if key not in keys}
        for name, part in parts.items()
    }
    return {**config, **kept}


def stem(ref: ObjectRef) -> ObjectRef:
    """Return an object's reference without the digest of its content."""
    return attrs.evolve(ref, name=DIGEST.sub("", ref.name))


def step_difference(
    step: Step, gone: Step | None, places: Mapping[str, Sequence[Step]], names: tuple[str, str]
) -> str:
    """Return what one step changes.

    Args:
        gone: the step that removes the object whose place it takes.
        places: the steps that change a file alike, by its key here.
        names: where the two sides are from.
    """
    known = {key for key, (first, *_) in places.items() if first is not step}
    if places and known == places.keys():
        return ""
    before = gone or step
    was, will = leave_out(before.live, known), leave_out(step.result, known)
    old = lines(was if before.action != "create" else None, will, "as it is")
    new = lines(will if step.action != "prune" else None, was, "changed")
    heads = f"{before.ref} ({names[0]})", f"{step.ref} ({names[1]})"
    unified = difflib.unified_diff(old, new, *heads)
    found = [HUNK.sub(lambda hunk: name_text(hunk, old), line) for line in unified]
    for key, steps in places.items():
        metas = [one.result["metadata"] for one in steps if one is not step and one.result]
        if metas and key not in known:
            others = [(meta.get("labels") or {}).get(NAME_LABEL, meta["name"]) for meta in metas]
            found.append(f"{key}: the same change restarts {join_words(dict.fromkeys(others))}\n")
    return "".join(found)


def name_text(hunk: re.Match[str], old: Sequence[str]) -> str:
    """Return the line above the lines of a difference, with the key of the text they begin in."""
    key, depth = "", 0
    for line in old[: int(hunk[1])]:
        indent = len(line) - len(line.lstrip(" "))
        if not key or indent <= depth:
            head = HEAD.fullmatch(line)
            key, depth = (f" {head[1]}", indent) if head else ("", 0)
    return f"{hunk[0]}{key}"


def lines(shown: Manifest | None, other: Manifest | None, word: str) -> list[str]:
    """Return an object as lines of YAML, each line of a text as one of them.

    Hidden values that differ from `other` are marked.
    """
    if shown is None:
        return []
    content: dict[str, Any] = hide(shorten_binary(substance(shown)), other, word)
    notes = content["metadata"].get("annotations") or {}
    notes = {key: value for key, value in notes.items() if key not in HIDDEN_NOTES}
    content["metadata"] = {**content["metadata"], "annotations": notes}
    if content["kind"] == "Secret":
        there = (other or {}).get("data") or {}
        data = content.get("data") or {}
        content["data"] = {key: cover(data[key], there.get(key), word) for key in data}
    dumper = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
    texts: list[str] = []
    written = str(yaml.dump(set_aside(content, texts), Dumper=dumper, width=1000))
    return [made for line in written.splitlines(keepends=True) for made in put_back(line, texts)]


def set_aside(value: Any, texts: list[str]) -> Any:
    """Return a value with marks for texts of several lines, which are added to `texts`."""
    if isinstance(value, dict):
        return {key: set_aside(item, texts) for key, item in value.items()}
    if isinstance(value, list):
        return [set_aside(item, texts) for item in value]
    if isinstance(value, str) and ("\n" in value or value.startswith(MARK)):
        texts.append(value)
        return f"{MARK}{len(texts) - 1}"
    return value


def put_back(line: str, texts: Sequence[str]) -> Iterator[str]:
    """Yield a line of YAML; in the place of a mark, a block with a text's lines.

    YAML's writers refuse such a block for tabs, and for spaces at the end of a line.
    """
    match = MARKED.fullmatch(line)
    if match is None:
        yield line
        return
    indent, head, number = match.groups()
    text = texts[int(number)]
    yield f"{indent}{head}|{'' if text.endswith(chr(10)) else '-'}\n"
    for one in text.removesuffix("\n").split("\n"):
        shown = (c if c.isprintable() or c == "\t" else ascii(c)[1:-1] for c in one)
        yield f"{indent}  {''.join(shown)}\n"


def shorten_binary(manifest: Manifest) -> dict[str, Any]:
    """Return an object whose binary files are not shown themselves, only which they are."""
    files = manifest.get("binaryData") or {}
    shown = {name: describe_file(base64.b64decode(text)) for name, text in files.items()}
    return {**manifest, "binaryData": shown} if shown else dict(manifest)


def describe_file(content: bytes) -> str:
    """Return a file's size, and a digest that shows whether two are equal."""
    return f"({len(content)} bytes, sha256 {hashlib.sha256(content).hexdigest()[:16]})"
