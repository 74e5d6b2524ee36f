"""Stacks that are Ditto things: fetched over HTTP, by their ids."""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping

from rigel_k8s.errors import RigelK8sError
from rigel_k8s.rigelfile.source import Source
from rigel_muto.ditto import Access, Ditto
from rigel_muto.formats import list_stacks
from rigel_muto.reading import read
from rigel_muto.remarks import NotFound
from rigel_muto.stack import Stack


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
