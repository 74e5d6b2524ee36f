"""The stack that a user names: a file, an id, a thing of a Ditto, or the stack itself.

Ids are searched for in the JSON and YAML files of one directory, then in a Ditto.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, MutableMapping
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from urllib.parse import urlsplit

from rigel_k8s.errors import RigelK8sError, UserError
from rigel_k8s.rigelfile.limits import MOST_BYTES
from rigel_k8s.rigelfile.source import Source, YamlNode, strip_places
from rigel_k8s.system.local_files import read_text
from rigel_muto.ditto import Access, Ditto
from rigel_muto.formats import list_stacks
from rigel_muto.reading import read
from rigel_muto.remarks import NotFound, Unreadable, error
from rigel_muto.stack import Stack

SCHEMES = ("http://", "https://")
#: Returns the stack of an id, or raises NotFound or Unreadable.
Find = Callable[[str], Stack]
#: Files that are searched for an id: how many, how large together, and the endings of their names.
MOST_FILES = 300
MOST_SEARCHED = 4 * MOST_BYTES
SUFFIXES = (".json", ".yaml", ".yml")


def open_stack(
    name: str | YamlNode,
    directory: Path,
    home: Path,
    ask: Find | None,
    chosen: Mapping[str, str] = MappingProxyType({}),
) -> tuple[Stack, Find]:
    """Return the stack of a name, and what finds those that it refers to.

    Args:
        name: a file in or below the directory, an id, or the stack itself. Ids are looked for in
            the files of the directory (of the file, if there is one), then by `ask`.
        home: the directory that files must be in, unless they are in a trusted one.
        ask: finds stacks elsewhere; None: nowhere else.
        chosen: the files of ids that several files have.

    Raises:
        NotFound: the stack or the file does not exist.
        Unreadable: its content is wrong.
        UserError: it may not be read.
    """
    if isinstance(name, YamlNode):
        stacks = list_stacks(name)
        if len(stacks) > 1:
            message = f"this is a list of {len(stacks)} stacks"
            raise Unreadable(error(name, message, "not-a-stack"))
        return stacks[0], _look_in_both(Library(directory, home, chosen), ask)
    path = directory / name
    # os.path's answers False for a name that no file can have.
    if not os.path.exists(path) and path.suffix not in SUFFIXES:  # noqa: PTH110
        find = _look_in_both(Library(directory, home, chosen), ask)
        return find(name), find
    library = Library(path.parent, home, chosen)
    try:
        stacks = library.open(path.name)
    except OSError as fault:
        raise NotFound(f"{path} cannot be read: {fault.strerror}") from fault
    except UnicodeDecodeError as fault:
        raise NotFound(f"{path} is not UTF-8") from fault
    if len(stacks) > 1:
        ids = ", ".join(stack.label for stack in stacks)
        raise NotFound(f"{path} has {len(stacks)} stacks, name one by its id: {ids}")
    return stacks[0], _look_in_both(library, ask)


def _look_in_both(library: Library, ask: Find | None) -> Find:
    def find(identifier: str) -> Stack:
        try:
            return library.find(identifier)
        except NotFound as missing:
            if ask is None or isinstance(missing, Ambiguous):
                raise
            return ask(identifier)

    return find


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


class Twin:
    """The things of one Ditto.

    Args:
        url: the part before /api/2/things.
        fetched: texts that were fetched before, by their URLs; what is fetched is added.
    """

    def __init__(
        self,
        url: str,
        access: Access,
        environ: Mapping[str, str],
        fetched: MutableMapping[str, str],
    ) -> None:
        self._ditto = Ditto(url, access, environ)
        self._fetched = fetched
        self._stacks: dict[str, Stack] = {}

    def find(self, identifier: str) -> Stack:
        """Return the stack of an id, the same one at each call.

        Raises:
            NotFound: the thing does not exist.
            Unreadable: it is not a stack.
            UserError: the variable of a secret is not set, or the secret would be sent unencrypted.
            RigelK8sError: Ditto cannot be reached, or refuses.
        """
        if identifier not in self._stacks:
            url = self._ditto.url_of(identifier)
            if url not in self._fetched:
                self._fetched[url] = self._fetch(url)
            self._stacks[identifier] = list_stacks(read(Source(url, self._fetched[url])))[0]
        return self._stacks[identifier]

    def _fetch(self, url: str) -> str:
        """Return Ditto's content of a URL."""
        answer = self._ditto.request("GET", url)
        if answer.status == 404:
            raise NotFound(f"there is no thing {url}")
        if answer.status != 200:
            raise RigelK8sError(f"{url} answered {answer.status}", hint="check twin_url")
        try:
            return answer.content.decode("utf-8")
        except UnicodeDecodeError as error:
            raise NotFound(f"{url} is not UTF-8") from error


def check_url(url: str) -> None:
    """Raise ValueError if a URL has no host, or a secret in it."""
    parts = urlsplit(url)
    if not url.startswith(SCHEMES) or not parts.hostname:
        raise ValueError(f'"{url}" is not a URL such as https://ditto.example')
    if parts.username or parts.password:
        raise ValueError("a URL must have no password in it: use user and password, or token")
