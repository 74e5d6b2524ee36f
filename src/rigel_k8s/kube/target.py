"""Where a cluster is and our user there, as plain data; independent of file formats and HTTP."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeAlias

import attrs

Headers: TypeAlias = Sequence[tuple[str, str]]


def no_headers(*, fresh: bool) -> Headers:
    """Return no header: the client certificate is enough, or there are no credentials."""
    del fresh
    return ()


@attrs.frozen
class Credentials:
    """How we identify ourselves.

    Attributes:
        certificate: the client certificate and its chain, PEM; "" for none.
        key: its key, PEM.
        headers: returns the headers for a request; `fresh` requests new ones after a refusal.
    """

    certificate: str = ""
    key: str = attrs.field(default="", repr=False)
    headers: Callable[..., Headers] = no_headers


@attrs.frozen
class Target:
    """A cluster and a user of it.

    Attributes:
        server: the URL of the API server, without a slash at its end.
        authority: the certificates that we trust, PEM; "" is what this machine trusts.
        insecure: trust any certificate.
        server_name: the name in the server's certificate if it is not the URL's.
        proxy: the URL of an HTTP proxy; "" is the environment's.
        context: the context's name; "" inside a cluster.
    """

    server: str
    context: str = ""
    namespace: str = "default"
    authority: str = ""
    insecure: bool = False
    server_name: str = ""
    proxy: str = ""
    credentials: Callable[[], Credentials] = Credentials
