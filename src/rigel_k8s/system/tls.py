"""TLS as kubectl checks it, in settings that threads can share."""

from __future__ import annotations

import ssl
from collections.abc import Iterable, Sequence


class SharedContext(ssl.SSLContext):
    """TLS settings that several threads connect with.

    urllib3 sets the ALPN protocols at every connection. OpenSSL frees the old ones then, while
    another thread may be copying them (python/cpython#141012): the server receives a broken
    greeting, or the process crashes. So they are set once, by `trust`.
    """

    def set_alpn_protocols(self, alpn_protocols: Iterable[str]) -> None:
        """Keep the protocols that were set first."""


def trust(authorities: str = "", *, protocols: Sequence[str] = ("http/1.1",)) -> ssl.SSLContext:
    """Return the settings of a client.

    Unlike `ssl.create_default_context` of Python 3.13, and like kubectl, they accept authorities
    without key identifiers (MicroK8s and EKS have such) and intermediate ones.

    Args:
        authorities: certificates in PEM; "" is those of this machine.
        protocols: what the connections are for, as ALPN names it.

    Raises:
        ssl.SSLError, ValueError: `authorities` has no certificates.
    """
    context = SharedContext(ssl.PROTOCOL_TLS_CLIENT)
    if protocols:
        ssl.SSLContext.set_alpn_protocols(context, protocols)
    context.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
    if authorities:
        context.load_verify_locations(cadata=authorities)
    else:
        context.load_default_certs()
    return context
