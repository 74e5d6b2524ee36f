"""The stack that a user names: a file, an id, a thing of a Ditto, or the stack itself."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, MutableMapping
from pathlib import Path
from types import MappingProxyType
from urllib.parse import urlsplit

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.rigelfile.source import Source, YamlNode
from rigel_muto.ditto import Access, Ditto
from rigel_muto.formats import list_stacks
from rigel_muto.library import SUFFIXES, Ambiguous, Library
from rigel_muto.reading import read
from rigel_muto.remarks import NotFound, Unreadable, error
from rigel_muto.stack import Stack

SCHEMES = ("http://", "https://")
#: Returns the stack of an id, or raises NotFound or Unreadable.
Find = Callable[[str], Stack]


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
