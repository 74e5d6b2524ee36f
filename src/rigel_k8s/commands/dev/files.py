"""Which files are copied into a container, and how they are packed for that; it asks no cluster."""

from __future__ import annotations

import io
import os
import stat
import tarfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from pathlib import Path, PurePosixPath

import attrs

from rigel_k8s.errors import UserError

#: Folders that no container needs from here: what a build makes is made there.
LEFT_OUT = frozenset({"__pycache__", "build", "install", "log", "node_modules"})
#: Files that editors write beside a file, and that exist for a moment.
MOMENTARY = (".swp", ".swx", ".pyc", "~")
#: Bytes of all files together: a copy is made in memory.
LARGEST = 512 * 2**20
#: The member of an archive that names what to remove, each path with a NUL behind it.
REMOVED = "removed"


@attrs.frozen
class Folder:
    """A folder of this computer, and the path that its content has in the container."""

    local: Path
    remote: PurePosixPath


@attrs.frozen
class File:
    """A file or symbolic link as it is now; a changed one differs."""

    local: Path
    changed: int
    size: int
    mode: int


def read_folder(text: str) -> Folder:
    """Return the folder of `DIR:PATH`.

    Raises:
        UserError: DIR is not a folder, or PATH not an absolute path.
    """
    local, _, remote = text.rpartition(":")
    path = PurePosixPath(remote)
    if not local or not path.is_absolute() or path == PurePosixPath("/") or ".." in path.parts:
        raise UserError(
            f'invalid folder "{text}"',
            hint="use DIR:PATH with a full path in the container: --sync src/arm:/ws/src/arm",
        )
    file = Path(local)
    if file.is_file():
        place = path.parent if path.name == file.name else path
        raise UserError(
            f"{local} is not a folder", hint=f"copy its folder: --sync {file.parent}:{place}"
        )
    if not file.is_dir():
        raise UserError(f"{local} is not a folder", hint="name one of this computer before the `:`")
    return Folder(file.absolute(), path)


def is_copied(name: str, *, folder: bool) -> bool:
    """Return whether a file or a folder below DIR belongs into the container, by its name."""
    if folder:
        return not name.startswith(".") and name not in LEFT_OUT
    return not name.startswith(".#") and not name.endswith(MOMENTARY)


def list_files(folders: Iterable[Folder]) -> dict[str, File]:
    """Return what belongs into the container, by its path there."""
    return {path: file for folder in folders for path, file in walk(folder)}


def check_size(folders: Iterable[Folder]) -> None:
    """Raise UserError for a folder that is too large to be copied."""
    for folder in folders:
        size = sum(file.size for _, file in walk(folder))
        if size > LARGEST:
            raise UserError(
                f"{folder.local} has {size / 2**20:,.0f} MiB of files to copy: at most"
                f" {LARGEST / 2**20:g} MiB are possible",
                hint="name a smaller folder; large data belong into the image or on a volume",
            )


def walk(folder: Folder) -> Iterator[tuple[str, File]]:
    """Yield (path in the container, file) of each file and symbolic link of a folder."""
    for above, folders, names in os.walk(folder.local):
        links = [name for name in folders if (Path(above) / name).is_symlink()]
        folders[:] = [name for name in folders if is_copied(name, folder=True)]
        for name in (*links, *names):
            local = Path(above) / name
            with suppress(FileNotFoundError):  # removed meanwhile
                found = local.lstat()
                plain = stat.S_ISREG(found.st_mode) or stat.S_ISLNK(found.st_mode)
                if plain and is_copied(name, folder=False):
                    path = folder.remote / local.relative_to(folder.local).as_posix()
                    yield str(path), File(local, found.st_mtime_ns, found.st_size, found.st_mode)


def compare(before: Mapping[str, File], now: Mapping[str, File]) -> tuple[list[str], list[str]]:
    """Return the paths in the container of what is new or changed, and of what is to be removed."""
    changed = [path for path, file in now.items() if before.get(path) != file]
    return changed, [path for path in before if path not in now]


def pack(
    files: Mapping[str, File], changed: Iterable[str], removed: Iterable[str], at: str
) -> bytes:
    """Return a tar archive for `/`, in a format that busybox reads, too.

    Args:
        at: the folder in the container of the member REMOVED.
    """
    made = io.BytesIO()
    with tarfile.open(fileobj=made, mode="w", format=tarfile.GNU_FORMAT) as archive:

        def add(path: str, content: bytes, mode: int = 0o644) -> None:
            member = tarfile.TarInfo(path.lstrip("/"))
            member.size, member.mode = len(content), stat.S_IMODE(mode)
            if stat.S_ISLNK(mode):
                member.type, member.linkname, member.size = tarfile.SYMTYPE, content.decode(), 0
            archive.addfile(member, io.BytesIO(content))

        for path in changed:
            local, mode = files[path].local, files[path].mode
            with suppress(FileNotFoundError):  # since it was listed: the next change removes it
                is_link = stat.S_ISLNK(mode)
                content = os.fsencode(local.readlink()) if is_link else local.read_bytes()
                # A build installs scripts as executables, which need not be that in the sources.
                add(path, content, mode | 0o111 if content.startswith(b"#!") else mode)
        add(f"{at}/{REMOVED}", "".join(f"{path}\0" for path in removed).encode())
    return made.getvalue()
