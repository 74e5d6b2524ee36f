"""TLS as kubectl checks it, in settings that threads can share."""

from __future__ import annotations

import ipaddress
import ssl
from collections.abc import Iterable, Mapping, Sequence
from urllib.parse import SplitResult, urlsplit

from rigel_k8s.errors import UserError


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


def proxy_for(
    configured: str, server: SplitResult, environ: Mapping[str, str]
) -> SplitResult | None:
    """Return the proxy for a server: the kubeconfig's, else the environment's.

    Raises:
        UserError: a kind of proxy that is not supported.
    """
    text = with_scheme(configured) or environment_proxy(server, environ)
    if not text:
        return None
    proxy = urlsplit(text)
    if proxy.scheme != "http" or not proxy.hostname:
        raise UserError(
            f"the proxy {proxy.scheme}://{proxy.hostname} is not supported, use an http:// proxy",
            hint="set proxy-url of the kubeconfig's cluster, or HTTPS_PROXY, to an http:// proxy",
        )
    return proxy


def environment_proxy(server: SplitResult, environ: Mapping[str, str]) -> str:
    """Return the URL that HTTPS_PROXY (HTTP_PROXY) and NO_PROXY give for a server, "" for none."""
    name = f"{server.scheme}_proxy"
    proxy = environ.get(name) or environ.get(name.upper()) or ""
    exceptions = environ.get("no_proxy") or environ.get("NO_PROXY") or ""
    host = server.hostname or ""
    if any(excepts(part.strip(), host) for part in exceptions.split(",")):
        return ""
    return "" if host == "localhost" or is_loopback(host) else with_scheme(proxy)


def with_scheme(proxy: str) -> str:
    """Return a proxy's URL; `proxy:3128` means http."""
    return proxy if "://" in proxy or not proxy else f"http://{proxy}"


def excepts(rule: str, host: str) -> bool:
    """Whether one entry of NO_PROXY covers a host: a name, a domain, an address, a network, *."""
    rule = rule.removeprefix("*.").lstrip(".") if rule != "*" else rule
    if not rule:
        return False
    try:
        return ipaddress.ip_address(host) in ipaddress.ip_network(rule, strict=False)
    except ValueError:
        return rule == "*" or host == rule or host.endswith(f".{rule}")


def is_loopback(host: str) -> bool:
    """Whether a host is an address of this machine alone."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
