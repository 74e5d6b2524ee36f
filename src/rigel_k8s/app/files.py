"""A node's `files`: what lies beside the Rigelfile, in a ConfigMap, mounted as it is."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePosixPath
from typing import TypeAlias

import attrs

from rigel_k8s.app.options import NodeOptions
from rigel_k8s.objects.pods import Object

#: Permissions of a program; other files have Kubernetes' own, 0644.
EXECUTABLE = 0o755


@attrs.frozen
class LocalFile:
    """A file that is mounted."""

    content: bytes
    executable: bool = False


#: A folder's files by their paths below it; that of a file by itself is "".
Folder: TypeAlias = Mapping[str, LocalFile]


@attrs.frozen
class Mounted:
    """One of a node's `files`: the key of each file in the ConfigMap, and its path in the volume.

    Attributes:
        path: in the container; its last part is the path in the volume of what is mounted there.
    """

    path: str
    folder: Folder
    number: int

    @property
    def name(self) -> str:
        """The path in the volume of what is mounted."""
        return PurePosixPath(self.path).name

    def list(self) -> Iterator[tuple[str, str, LocalFile]]:
        """Yield (key, path in the volume, file) of each."""
        for index, (below, file) in enumerate(sorted(self.folder.items())):
            key = re.sub(r"[^\w.-]", "_", below or self.name, flags=re.ASCII)[-200:]
            yield f"{self.number}.{index}.{key}", str(PurePosixPath(self.name, below)), file


def list_mounted(options: NodeOptions, folders: Mapping[str, Folder]) -> list[Mounted]:
    """Return a node's files.

    Args:
        folders: by their paths in the Rigelfile.
    """
    entries = options.files.items()
    return [Mounted(str(at), folders[path], n) for n, (at, path) in enumerate(entries)]


def split_contents(mounted: Sequence[Mounted]) -> tuple[dict[str, str], dict[str, bytes]]:
    """Return (texts, other files) by their keys in the ConfigMap."""
    texts, others = {}, {}
    for one in mounted:
        for key, _, file in one.list():
            try:
                texts[key] = file.content.decode("utf-8")
            except UnicodeDecodeError:
                others[key] = file.content
    return texts, others


def mount_files(
    mounted: Sequence[Mounted], config: str, prefix: str = ""
) -> Iterator[tuple[Object, Object]]:
    """Yield (the pod's volume, the container's mount) of each.

    In the top folder of a volume, Kubernetes makes links to what is in hidden folders: who searches
    it finds each file several times. A path below it leads to plain files. By it, a file also
    covers nothing that lies beside it in the image.

    Args:
        config: the name of the ConfigMap.
        prefix: of the volumes' names.
    """
    for one in mounted:
        name = f"{prefix}files-{one.number}"
        items = [
            {"key": key, "path": path, **({"mode": EXECUTABLE} if file.executable else {})}
            for key, path, file in one.list()
        ]
        mount = {"name": name, "mountPath": one.path, "subPath": one.name, "readOnly": True}
        yield {"name": name, "configMap": {"name": config, "items": items}}, mount


def hash_files(mounted: Sequence[Mounted]) -> str:
    """Return a text that changes with each file."""
    found = hashlib.sha256()
    for one in mounted:
        for key, _, file in one.list():
            found.update(f"{key} {len(file.content)} ".encode() + file.content)
    return found.hexdigest()[:10]
