"""The files of an archive, unpacked in memory.

An archive comes from another person. So it has limits, each path stays below the directory that it
is unpacked into, and only files, directories and links to these are accepted.
"""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import stat
import tarfile
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import PurePosixPath

from rigel_k8s.system.trees import Directory, Entry, File, Link, Tree

#: Bytes of an archive's content with what a tar adds; files, directories and links.
MOST_UNPACKED = 64 * 2**20
MOST_ENTRIES = 10_000
#: Directories in each other, and bytes of a name; Linux has 255.
DEEPEST_PATH, LONGEST_NAME = 50, 255
#: What Python's readers raise if an archive is damaged.
_DAMAGED = (
    *(tarfile.TarError, zipfile.BadZipFile, zlib.error, lzma.LZMAError),
    *(OSError, EOFError, ValueError, ArithmeticError, RuntimeError),
)
_ZIP = (b"PK\x03\x04", b"PK\x05\x06")


class BadArchive(Exception):
    """An archive that is not unpacked; the text has the reason."""


def unpack(content: bytes) -> Tree:
    """Return what is in a tar, perhaps compressed, or in a zip.

    Raises:
        BadArchive: it is neither, is damaged, is too large, or has what no archive of sources has.
    """
    try:
        return _collect(_read_zip(content) if content.startswith(_ZIP) else _read_tar(content))
    except _DAMAGED as error:
        raise BadArchive(f"the archive cannot be read: {error or type(error).__name__}") from error


def enter(tree: Tree, directory: str) -> Tree:
    """Return a tree with the content of one of its directories moved to the top.

    Raises:
        BadArchive: the directory does not exist, or the top has an entry of the same name.
    """
    inside = make_path(directory)
    if not inside:
        return tree
    lead = f"{inside}/"
    if not any(path.startswith(lead) for path in tree):
        raise BadArchive(f'there is no directory "{directory}" in the archive')
    moved = {path[len(lead) :]: entry for path, entry in tree.items() if path.startswith(lead)}
    rest = {p: entry for p, entry in tree.items() if p != inside and not p.startswith(lead)}
    if clash := sorted(moved.keys() & rest.keys()):
        raise BadArchive(f'"{clash[0]}" is in the directory "{directory}" and beside it')
    return {**rest, **moved}


def flatten(tree: Tree) -> Tree:
    """Return a tree without its top directory, if all of it is in that one."""
    tops = {path.partition("/")[0] for path in tree}
    if len(tops) != 1 or not any("/" in path for path in tree):
        return tree
    return enter(tree, tops.pop())


def check_tree(tree: Tree) -> None:
    """Raise BadArchive for a link that leads out, or an entry that is not in a directory."""
    for path, entry in tree.items():
        for parent in PurePosixPath(path).parents:
            if isinstance(tree.get(str(parent)), File | Link):
                raise BadArchive(f'"{path}" is below "{parent}", which is not a directory')
        if isinstance(entry, Link):
            _check_link(path, entry.target)


def _check_link(path: str, target: str) -> None:
    """Refuse a link that leads out, or could by way of another link.

    After the first name a ".." could climb from wherever a link of that name leads to.
    """
    parts = target.split("/")
    climbs = next((n for n, part in enumerate(parts) if part != ".."), len(parts))
    inside = climbs <= path.count("/") and ".." not in parts[climbs:]
    if not target or target.startswith("/") or not inside:
        raise BadArchive(f'the link "{path}" leads out of the archive, to "{target}"')


def make_path(name: str) -> str:
    """Return a name of an archive as a path of a tree; "" for the top.

    Raises:
        BadArchive: it leads out, or is not a valid name of a file.
    """
    parts = [part for part in name.split("/") if part not in ("", ".")]
    if name.startswith("/") or ".." in parts:
        raise BadArchive(f'"{name}" leads out of the archive')
    if not all(part.isprintable() and "\\" not in part for part in parts):
        raise BadArchive(f"a file has a name with characters that no file should have: {name!r}")
    if len(parts) > DEEPEST_PATH or any(len(part.encode()) > LONGEST_NAME for part in parts):
        raise BadArchive(f'the name "{name[:LONGEST_NAME]}" is too long')
    return "/".join(parts)


def _collect(entries: Iterator[tuple[str, Entry]]) -> Tree:
    """Return the entries by their paths, each of them once."""
    tree: dict[str, Entry] = {}
    for count, (name, entry) in enumerate(entries):
        if count == MOST_ENTRIES:
            raise BadArchive(f"the archive has more than {MOST_ENTRIES} entries")
        path = make_path(name)
        twice = path in tree and not (isinstance(entry, Directory) and tree[path] == entry)
        if twice or (not path and not isinstance(entry, Directory)):
            raise BadArchive(f'"{name}" is in the archive twice')
        if path:
            tree[path] = entry
    if not any(isinstance(entry, File) for entry in tree.values()):
        raise BadArchive("there is no file in the archive")
    return tree


def _read_tar(content: bytes) -> Iterator[tuple[str, Entry]]:
    """Yield the entries of a tar, decompressed first: to skip one takes as long as to read it."""
    with _open_compressed(content) as stream:
        unpacked = stream.read(MOST_UNPACKED + 1)
    _refuse_large(len(unpacked))
    with tarfile.open(fileobj=io.BytesIO(unpacked), mode="r:") as archive:
        for info in archive:
            yield info.name, _read_tar_entry(archive, info)


def _open_compressed(content: bytes) -> io.BufferedIOBase:
    """Return a stream of what gzip, bzip2 or xz have compressed, or of the content itself."""
    stream = io.BytesIO(content)
    if content.startswith(b"\x1f\x8b"):
        return gzip.GzipFile(fileobj=stream)
    if content.startswith(b"BZh"):
        return bz2.BZ2File(stream)
    if content.startswith(b"\xfd7zXZ"):
        return lzma.LZMAFile(stream)
    return stream


def _read_tar_entry(archive: tarfile.TarFile, info: tarfile.TarInfo) -> Entry:
    if info.isdir():
        return Directory()
    if info.issym():
        return Link(info.linkname)
    if info.islnk():
        raise BadArchive(f'"{info.name}" is a hard link: pack it with --hard-dereference')
    if not info.isreg() or info.issparse():
        raise BadArchive(f'"{info.name}" is neither a file nor a directory nor a symbolic link')
    file = archive.extractfile(info)
    assert file is not None, "a regular file has content"
    content = file.read()
    if len(content) != info.size:
        raise BadArchive("the archive cannot be read: it ends too early")
    return File(content, bool(info.mode & stat.S_IXUSR))


def _read_zip(content: bytes) -> Iterator[tuple[str, Entry]]:
    read = 0
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        for info in archive.infolist():
            mode = info.external_attr >> 16
            with archive.open(info) as file:
                part = file.read(MOST_UNPACKED - read + 1)
            read += len(part)
            _refuse_large(read)
            yield info.filename, _make_zip_entry(info, mode, part)


def _make_zip_entry(info: zipfile.ZipInfo, mode: int, content: bytes) -> Entry:
    """Return an entry of a zip; its mode is 0 if it was not packed on Unix."""
    if info.is_dir():
        return Directory()
    kind = stat.S_IFMT(mode)
    if kind == stat.S_IFLNK:
        return Link(content.decode())
    if kind not in (0, stat.S_IFREG):
        raise BadArchive(f'"{info.filename}" is neither a file nor a directory nor a symbolic link')
    return File(content, bool(mode & stat.S_IXUSR))


def _refuse_large(size: int) -> None:
    if size > MOST_UNPACKED:
        raise BadArchive(f"the archive has more than {MOST_UNPACKED} bytes")
