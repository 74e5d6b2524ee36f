"""The `files` of nodes: read for a deploy, and checked with the options."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import NoReturn, TypeAlias, TypeVar

from rigel_k8s.app.files import Folder, LocalFile
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.errors import UserError
from rigel_k8s.option_text import has_template
from rigel_k8s.problems import Path as OptionPath
from rigel_k8s.problems import Problem
from rigel_k8s.system.local_files import read_bytes
from rigel_k8s.system.trust import Untrusted

#: Bytes of the files of all nodes: a Secret of one mebibyte keeps a revision with all of them.
MOST_BYTES = 512 * 1024
#: Files of one folder: each is written into the pod's template.
MOST_FILES = 200
LARGER = "put large ones into the image, or on a volume of `persistent_storage`"
TOO_LARGE = UserError(
    f"the files of all nodes have more than {MOST_BYTES // 1024} KiB", hint=LARGER
)


def read_files(options: OrchestrationOptions, directory: Path, home: Path) -> dict[str, Folder]:
    """Return the files of all nodes, by their paths in the Rigelfile.

    Args:
        directory: the application's, where relative paths begin.
        home: the Rigelfile's; files outside of it need trust.

    Raises:
        Untrusted: one is elsewhere.
        UserError: one cannot be read, or they are too many or too large.
    """
    return collect(_read_each(options, directory, home), "", lambda path: path)


def check_local_files(
    options: OrchestrationOptions, directory: Path, home: Path
) -> Iterator[Problem]:
    """Yield what read_files would refuse; a path with a template waits."""
    return explain(_read_each(options, directory, home), "", "bad-file")


def _read_each(options: OrchestrationOptions, directory: Path, home: Path) -> Iterator[Use[Folder]]:
    named = (
        (("nodes", str(key), "files", str(at)), name)
        for key, node in options.nodes.items()
        for at, name in node.files.items()
    )
    return read_each(
        named, lambda name: read_folder(directory / name, home), _size, MOST_BYTES, TOO_LARGE
    )


def _size(folder: Folder) -> int:
    return sum(len(file.content) for file in folder.values())


def read_folder(path: Path, home: Path) -> Folder:
    """Return what is at a path. Raises as read_files does."""
    if not path.is_dir():
        return {"": _read_file(path, home)}
    names = sorted(_list_files(path))
    if not names:
        raise UserError(f"{path} is an empty folder", hint="remove it here, or add files")
    if len(names) > MOST_FILES:
        raise UserError(f"{path} has {len(names)} files, more than {MOST_FILES}", hint=LARGER)
    return {name.relative_to(path).as_posix(): _read_file(name, home) for name in names}


def _list_files(folder: Path) -> Iterator[Path]:
    """Yield what is in a folder and those below it, but for folders; links are not followed."""

    def refuse(error: OSError) -> NoReturn:
        raise _cannot_read(Path(error.filename), error)

    for top, folders, files in os.walk(folder, onerror=refuse):
        yield from (Path(top, name) for name in files)
        yield from (Path(top, name) for name in folders if Path(top, name).is_symlink())


def _read_file(path: Path, home: Path) -> LocalFile:
    try:
        content = read_bytes(path, home, MOST_BYTES, what="files", larger=LARGER)
    except OSError as error:
        raise _cannot_read(path, error) from error
    return LocalFile(content, executable=os.access(path, os.X_OK))


def _cannot_read(path: Path, error: OSError) -> UserError:
    hint = "write its path relative to the application's directory"
    return UserError(f"cannot read {path}: {error.strerror}", hint=hint)


T = TypeVar("T")
#: The path of the option, the file's path as written, and its content or what is wrong with it.
Use: TypeAlias = tuple[OptionPath, str, T | UserError]


def read_each(
    named: Iterable[tuple[OptionPath, str]],
    read: Callable[[str], T],
    size: Callable[[T], int],
    most: int,
    excess: UserError,
) -> Iterator[Use[T]]:
    """Yield each use of files; the one with which there are too many is the last.

    Args:
        named: (path of the option, path as written), as often as it is used.
        read: returns a file's content; raises UserError.
        size: of a content, which counts at each use; `most` of all together.
        excess: the result of a use that is too much.
    """
    found: dict[str, T | UserError] = {}
    total = 0
    for path, name in named:
        if name not in found:
            try:
                found[name] = read(name)
            except UserError as error:
                found[name] = error
        result = found[name]
        total += 0 if isinstance(result, UserError) else size(result)
        if total > most:
            yield path, name, excess
            return
        yield path, name, result


def collect(
    uses: Iterable[Use[T]], what: str, option: Callable[[OptionPath], OptionPath]
) -> dict[str, T]:
    """Return the contents by their paths as written. Raises UserError for the first without one.

    Args:
        what: how messages of the files begin, which is left out.
        option: returns what of an option's path the error begins with instead.
    """
    contents = {}
    for path, name, result in uses:
        if isinstance(result, UserError):
            text = f"{'.'.join(map(str, option(path)))}: {result.message.removeprefix(what)}"
            raise type(result)(text, hint=result.hint) from result
        contents[name] = result
    return contents


def explain(uses: Iterable[Use[T]], what: str, kind: str) -> Iterator[Problem]:
    """Yield what `collect` would refuse, as problems of a kind; a path with a template waits."""
    for path, name, result in uses:
        if isinstance(result, UserError) and not has_template(name):
            found = "untrusted" if isinstance(result, Untrusted) else kind
            message = result.message.removeprefix(what)
            yield Problem(path, "; ".join(filter(None, (message, result.hint))), found)
