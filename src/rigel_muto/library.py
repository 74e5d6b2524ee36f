"""Finds stacks by their ids: in the JSON files of one directory."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from types import MappingProxyType

from rigel_k8s.errors import UserError
from rigel_k8s.rigelfile.limits import MOST_BYTES
from rigel_k8s.rigelfile.source import Source, strip_places
from rigel_k8s.system.local_files import read_text
from rigel_muto.formats import list_stacks
from rigel_muto.reading import read
from rigel_muto.remarks import NotFound, Unreadable
from rigel_muto.stack import Stack

#: Files that are searched for an id: how many, how large together, and the endings of their names.
MOST_FILES = 300
MOST_SEARCHED = 4 * MOST_BYTES
SUFFIXES = (".json", ".yaml", ".yml")


class Ambiguous(NotFound):
    """There are several stacks of that name, or too many to search all."""


class Library:
    """The stacks in the files of a directory.

    Args:
        home: the directory that files must be in, unless they are in a trusted one.
        chosen: the files of ids that several files have.
    """

    def __init__(
        self, directory: Path, home: Path, chosen: Mapping[str, str] = MappingProxyType({})
    ) -> None:
        self._directory = directory
        self._home = home
        self._chosen = chosen
        self._read: dict[str, tuple[Stack, ...]] = {}

    def open(self, name: str) -> tuple[Stack, ...]:
        """Return the stacks of a file.

        Raises:
            Unreadable: its content is wrong.
            UserError: it may not be read.
            OSError, UnicodeDecodeError: it cannot be read.
        """
        return _parse(self._directory / name, self._open_text(name))

    def find(self, identifier: str) -> Stack:
        """Return the stack of an id.

        Raises:
            NotFound: no file has it, or several have different ones.
        """
        chosen = self._chosen.get(identifier)
        found = [
            (file, stack)
            for file, text in self._texts.items()
            if identifier in text and chosen in (None, file)
            for stack in self._list_stacks(file)
            if identifier in stack.ids
        ]
        stacks = [strip_places(stack.place) for _, stack in found]
        if found and all(stack == stacks[0] for stack in stacks):
            return found[0][1]
        place = f"the files of {self._directory}" if chosen is None else chosen
        if not found:
            raise NotFound(f'no stack "{identifier}" in {place}')
        files = list(dict.fromkeys(file for file, _ in found))
        message = f'the stack "{identifier}" exists more than once in {place}'
        if len(files) == 1:
            raise Ambiguous(f"{message}: name it differently there")
        raise Ambiguous(
            f"{message}, in {' and '.join(files)}: choose one with"
            f" `rigel muto convert --reference {identifier}={files[0]}`, or in `muto` with"
            f' `references: {{"{identifier}": {files[0]}}}`'
        )

    def _open_text(self, name: str) -> str:
        return read_text(self._directory / name, self._home, MOST_BYTES, what="a stack")

    @cached_property
    def _texts(self) -> dict[str, str]:
        """The texts of the files; unreadable and forbidden ones are left out.

        Raises:
            Ambiguous: there is too much to search.
        """
        texts: dict[str, str] = {}
        files = sorted(file for file in self._directory.iterdir() if file.suffix in SUFFIXES)
        for file in files[: MOST_FILES + 1]:
            with suppress(UserError, OSError, UnicodeDecodeError):
                texts[file.name] = self._open_text(file.name)
            if len(texts) > MOST_FILES or sum(map(len, texts.values())) > MOST_SEARCHED:
                message = f"more than {MOST_FILES} files, or more than {MOST_SEARCHED} characters"
                raise Ambiguous(f"{self._directory} has {message}: name the stack by its file")
        return texts

    def _list_stacks(self, name: str) -> tuple[Stack, ...]:
        """Return the stacks of a file, the same ones at each call."""
        if name not in self._read:
            try:
                self._read[name] = _parse(self._directory / name, self._texts[name])
            except Unreadable:
                self._read[name] = ()
        return self._read[name]


def _parse(path: Path, text: str) -> tuple[Stack, ...]:
    return list_stacks(read(Source(str(path), text)))
