"""Our credentials at a cluster: certificates, tokens, renewed files, credential programs.

It reads the `users` of a kubeconfig; HTTP is elsewhere. Tokens are never part of an error.
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
from datetime import datetime, timezone
from pathlib import Path
from typing import Any
from urllib.parse import quote

import attrs

from rigel_k8s.errors import ClusterError, UserError
from rigel_k8s.kube.answers import describe, parse, read_mapping
from rigel_k8s.kube.target import Credentials, Headers

RENEW = 60.0  # seconds after which a token file is read again, as client-go does
EARLY = 30.0  # seconds before its expiry at which a credential counts as expired
PLUGIN_TIMEOUT = 120.0
HEADER_LETTERS = "!#$&'*+^`|"  # allowed in a header's name, with letters, digits and -._~

#: The output of a credential program, by the interface of Kubernetes.
EXPECTED = (
    'an ExecCredential as JSON: {"status": {"token": TEXT, "expirationTimestamp": RFC 3339 time}}, '
    "or clientCertificateData and clientKeyData in place of the token"
)

InlineOrFile = Callable[[Mapping[str, Any], str], str]


def user_credentials(
    user: Mapping[str, Any], cluster: Mapping[str, Any], context: str, text: InlineOrFile
) -> Credentials:
    """Return the credentials of a kubeconfig's user, with the impersonation that it requests.

    Args:
        text: reads a value that is inline or in a file.

    Raises:
        UserError: the user has an `auth-provider`, or a value of another type.
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
    """Return the user's credentials before any impersonation."""
    if user.get("exec"):
        if not isinstance(user["exec"], dict):
            raise bad_plugin_error(context)
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
    """Return the function that makes the headers of a user without a credential program."""
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
    groups, extra = user.get("as-groups") or [], user.get("as-user-extra") or {}
    if not isinstance(groups, list) or not isinstance(extra, dict):
        raise UserError(
            "kubeconfig: `as-groups` must be a list, and `as-user-extra` a mapping of lists"
        )
    headers = [("Impersonate-User", user.get("as")), ("Impersonate-Uid", user.get("as-uid"))]
    headers += [("Impersonate-Group", group) for group in groups]
    for key, values in extra.items():
        if not isinstance(values, list):
            raise UserError(f"kubeconfig: `as-user-extra`: {key} must be a list")
        name = f"Impersonate-Extra-{quote(str(key), safe=HEADER_LETTERS)}"
        headers += [(name, value) for value in values]
    return [(name, str(value)) for name, value in headers if value]


def bearer(token: str) -> Headers:
    return [("Authorization", f"Bearer {token}")]


def file_credentials(path: Path) -> Credentials:
    """Return credentials from a token file, read again regularly since tokens are rotated."""
    state: dict[str, Any] = {"read": 0.0, "token": ""}

    def headers(*, fresh: bool) -> Headers:
        if fresh or not state["token"] or time.monotonic() - state["read"] > RENEW:
            state["token"], state["read"] = read_token(path), time.monotonic()
        return bearer(state["token"])

    return Credentials(headers=headers)


def read_token(path: Path) -> str:
    """Return a file's token; raises UserError."""
    try:
        return path.read_text().strip()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "it is not text"
        raise UserError(
            f"cannot read the token file {path}: {reason}",
            hint="correct `tokenFile` in the kubeconfig",
        ) from None


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

    certificate, key = state.get("clientCertificateData"), state.get("clientKeyData")
    return Credentials(certificate or "", key or "", headers)


def is_expired(status: Mapping[str, Any]) -> bool:
    """Whether a program's answer has expired, or nearly."""
    stamp = status.get("expirationTimestamp")
    return bool(stamp) and read_time(str(stamp)).timestamp() - EARLY < time.time()


def read_time(stamp: str) -> datetime:
    """Return an RFC 3339 time, in UTC if it has no zone; raises ValueError."""
    plain = re.sub(r"\.\d+", "", stamp)  # Python 3.10 reads no nanoseconds
    found = datetime.fromisoformat(plain.replace("Z", "+00:00"))
    return found if found.tzinfo else found.replace(tzinfo=timezone.utc)


def run_plugin(
    plugin: Mapping[str, Any], cluster: Mapping[str, Any], context: str
) -> Mapping[str, Any]:
    """Run a credential program and return its answer's status.

    Raises:
        UserError: the kubeconfig does not describe how to run it.
        ClusterError: it gave no credentials.
    """
    command = command_of(plugin, context)
    try:
        done = subprocess.run(
            command,
            env=plugin_environment(plugin, cluster),
            capture_output=True,
            timeout=PLUGIN_TIMEOUT,
            check=False,
        )
    except (OSError, ValueError, subprocess.TimeoutExpired) as error:
        reason = f"{type(error).__name__}: {getattr(error, 'strerror', None) or 'see below'}"
        raise plugin_failed(command[0], context, reason, plugin) from error
    output = done.stderr.decode("utf-8", "replace")
    if done.returncode != 0:
        raise plugin_failed(command[0], context, output, plugin)
    try:
        return read_status(parse(done.stdout))
    except ValueError as error:
        wrong = f"{error}; it must print {EXPECTED}"
        # Not chained: what it printed is the token, and a traceback may show it.
        raise plugin_failed(command[0], context, f"{output}\n{wrong}", plugin) from None


def command_of(plugin: Mapping[str, Any], context: str) -> list[str]:
    """Return a program's command line from the kubeconfig."""
    command, words, env = plugin.get("command"), plugin.get("args"), plugin.get("env")
    right = isinstance(words or [], list) and isinstance(env or [], list)
    if not isinstance(command, str) or not command or not right:
        raise bad_plugin_error(context)
    if not all(isinstance(one, dict) and {"name", "value"} <= one.keys() for one in env or []):
        raise bad_plugin_error(context)
    return [command, *map(str, words or [])]


def bad_plugin_error(context: str) -> UserError:
    """Return the error for a credential program that the kubeconfig describes wrongly."""
    return UserError(
        f"context {context}: the kubeconfig does not define the credential program of its user",
        hint="`exec` needs `command` (text), and can have `args` (a list) and `env` (a list of "
        "`name` and `value`)",
    )


def read_status(answer: Any) -> Mapping[str, Any]:
    """Return the status of a program's answer, after checking its parts.

    Raises:
        ValueError: the reason, without any of its values.
    """
    status = read_mapping(answer).get("status")
    if not isinstance(status, dict):
        raise ValueError(f"its status is {describe(status)}")
    for key in ("token", "clientCertificateData", "clientKeyData", "expirationTimestamp"):
        if not isinstance(status.get(key) or "", str):
            raise ValueError(f"its status.{key} is {describe(status[key])}")
    if bool(status.get("clientCertificateData")) != bool(status.get("clientKeyData")):
        raise ValueError("its status has a certificate or a key without the other")
    token = status.get("token") or ""
    if not token and not status.get("clientCertificateData"):
        raise ValueError("its status has neither a token nor a certificate")
    if not (token.isascii() and token.isprintable()):
        raise ValueError("its status.token has letters that a header cannot carry")
    try:
        read_time(status.get("expirationTimestamp") or "2999-01-01T00:00:00Z").timestamp()
    except (ValueError, OverflowError):
        raise ValueError("its status.expirationTimestamp is not an RFC 3339 time") from None
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
        hint=plugin.get("installHint") or f"run {command} yourself to see its error",
        details=output.strip().splitlines()[-10:],
    )
