"""Which HTTP proxy a server is reached through; pure."""

from __future__ import annotations

import ipaddress
from collections.abc import Mapping
from urllib.parse import SplitResult, urlsplit

from rigel_k8s.errors import UserError


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
