"""Who we are to a cluster: certificates, tokens, files that are renewed, credential programs.

It knows the `users` of a kubeconfig and nothing of HTTP. Tokens are never part of an error.
"""

from __future__ import annotations

import base64
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any
from urllib.parse import quote

import attrs

from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.kube.target import Credentials, Headers

RENEW = 60.0  # seconds after which a token file is read again, as client-go does
EARLY = 30.0  # seconds before its expiry that a credential counts as expired
PLUGIN_TIMEOUT = 120.0
HEADER_LETTERS = "!#$&'*+^`|"  # what a header's name may have besides letters, digits and -._~

InlineOrFile = Callable[[Mapping[str, Any], str], str]


def user_credentials(
    user: Mapping[str, Any], cluster: Mapping[str, Any], context: str, text: InlineOrFile
) -> Credentials:
    """Return the credentials of a kubeconfig's user, with the impersonation that it asks for.

    Args:
        text: reads a value that stands inline or in a file.

    Raises:
        UserError: the user has an `auth-provider`.
        ClusterError: a credential program gives no credentials.
    """
    own = own_credentials(user, cluster, context, text)
    laid_over = impersonation(user)
    if not laid_over:
        return own
    return attrs.evolve(own, headers=lambda *, fresh: [*laid_over, *own.headers(fresh=fresh)])


def own_credentials(
    user: Mapping[str, Any], cluster: Mapping[str, Any], context: str, text: InlineOrFile
) -> Credentials:
    """Return who the user is before any impersonation."""
    if user.get("exec"):
        return plugin_credentials(user["exec"], cluster, context)
    if user.get("auth-provider"):
        raise UserError(
            f"context {context}: its user logs in with an `auth-provider`, which rigel does not "
            "support",
            hint="use a credential plugin (`exec`) in the kubeconfig, such as kubelogin for OIDC",
        )
    headers = user_headers(user)
    return Credentials(text(user, "client-certificate"), text(user, "client-key"), headers)


def user_headers(user: Mapping[str, Any]) -> Callable[..., Headers]:
    """Return what makes the headers of a user without a credential program."""
    if user.get("tokenFile"):
        return file_credentials(Path(user["tokenFile"])).headers
    fixed: Headers = ()
    if user.get("token"):
        fixed = bearer(user["token"])
    elif user.get("username"):
        pair = f"{user['username']}:{user.get('password', '')}".encode()
        fixed = [("Authorization", f"Basic {base64.b64encode(pair).decode()}")]
    return lambda *, fresh: fixed


def impersonation(user: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return the headers of `as`, `as-uid`, `as-groups` and `as-user-extra`."""
    headers = [("Impersonate-User", user.get("as")), ("Impersonate-Uid", user.get("as-uid"))]
    headers += [("Impersonate-Group", group) for group in user.get("as-groups") or []]
    for key, values in (user.get("as-user-extra") or {}).items():
        name = f"Impersonate-Extra-{quote(key, safe=HEADER_LETTERS)}"
        headers += [(name, value) for value in values]
    return [(name, str(value)) for name, value in headers if value]


def bearer(token: str) -> Headers:
    """Return the header of a token."""
    return [("Authorization", f"Bearer {token}")]


def file_credentials(path: Path) -> Credentials:
    """Return credentials from a token file, read again now and then since tokens are rotated."""
    state: dict[str, Any] = {"read": 0.0, "token": ""}

    def headers(*, fresh: bool) -> Headers:
        if fresh or not state["token"] or time.monotonic() - state["read"] > RENEW:
            state["token"], state["read"] = path.read_text().strip(), time.monotonic()
        return bearer(state["token"])

    return Credentials(headers=headers)


def plugin_credentials(
    plugin: Mapping[str, Any], cluster: Mapping[str, Any], context: str
) -> Credentials:
    """Return credentials from a program, which runs again when they expire."""
    state = run_plugin(plugin, cluster, context)

    def headers(*, fresh: bool) -> Headers:
        nonlocal state
        if fresh or is_expired(state):
            state = run_plugin(plugin, cluster, context)
        return bearer(state["token"]) if state.get("token") else ()

    certificate = state.get("clientCertificateData", "")
    return Credentials(certificate, state.get("clientKeyData", ""), headers)


def is_expired(status: Mapping[str, Any]) -> bool:
    """Whether a program's answer is at its end, or nearly."""
    stamp = status.get("expirationTimestamp")
    if not stamp:
        return False
    plain = re.sub(r"\.\d+", "", str(stamp))  # Python 3.10 reads no nanoseconds
    end = datetime.fromisoformat(plain.replace("Z", "+00:00"))
    return end.timestamp() - EARLY < time.time()


def run_plugin(
    plugin: Mapping[str, Any], cluster: Mapping[str, Any], context: str
) -> Mapping[str, Any]:
    """Run a credential program and return its answer's status."""
    command = [plugin.get("command", ""), *(plugin.get("args") or [])]
    try:
        done = subprocess.run(
            command,
            env=plugin_environment(plugin, cluster),
            capture_output=True,
            timeout=PLUGIN_TIMEOUT,
            check=False,
        )
        answer = json.loads(done.stdout) if done.returncode == 0 else {}
    except (OSError, ValueError, subprocess.TimeoutExpired) as error:
        reason = f"{type(error).__name__}: {getattr(error, 'strerror', None) or 'see below'}"
        raise plugin_failed(command[0], context, reason, plugin) from error
    status = answer.get("status") if isinstance(answer, dict) else None
    if not isinstance(status, dict) or not status:
        raise plugin_failed(command[0], context, done.stderr.decode("utf-8", "replace"), plugin)
    return status


def plugin_environment(plugin: Mapping[str, Any], cluster: Mapping[str, Any]) -> dict[str, str]:
    """Return the environment that the credential plugin interface promises."""
    info: dict[str, Any] = {
        "apiVersion": plugin.get("apiVersion", "client.authentication.k8s.io/v1"),
        "kind": "ExecCredential",
        "spec": {"interactive": sys.stdin is not None and sys.stdin.isatty()},
    }
    if plugin.get("provideClusterInfo"):
        info["spec"]["cluster"] = {
            key: cluster[key]
            for key in ("server", "tls-server-name", "certificate-authority-data", "proxy-url")
            if cluster.get(key)
        }
    own = {entry["name"]: str(entry["value"]) for entry in plugin.get("env") or []}
    return {**os.environ, **own, "KUBERNETES_EXEC_INFO": json.dumps(info)}


def plugin_failed(
    command: str, context: str, output: str, plugin: Mapping[str, Any]
) -> ClusterError:
    """Return the error for a credential program that gave no credentials."""
    return ClusterError(
        f"context {context}: the credential program {command} gave no credentials",
        hint=plugin.get("installHint") or f"run {command} yourself to see what it wants",
        details=output.strip().splitlines()[-10:],
    )
