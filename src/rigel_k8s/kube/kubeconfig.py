"""Which cluster to use: kubeconfig files, or the pod that we run in.

Reads what kubectl reads, except an `auth-provider`: credential programs have replaced it.
"""

from __future__ import annotations

import base64
import binascii
import os
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import yaml

from rigel_k8s.errors import UserError
from rigel_k8s.kube.credentials import file_credentials, user_credentials
from rigel_k8s.kube.target import Target

SERVICE_ACCOUNT = Path("/var/run/secrets/kubernetes.io/serviceaccount")
NO_CLUSTER = (
    "start a local cluster with `rigel cluster up` (or kind, minikube, k3s), "
    "or name a kubeconfig in the variable KUBECONFIG"
)
PATHS = ("certificate-authority", "client-certificate", "client-key", "tokenFile")


def load(
    path: Path | None = None,
    context: str | None = None,
    environ: Mapping[str, str] = os.environ,
    service_account: Path = SERVICE_ACCOUNT,
) -> Target:
    """Return the cluster to use.

    Args:
        path: one kubeconfig file; None is $KUBECONFIG, then ~/.kube/config, then the pod's own.
        context: a context of it; None is its current one.

    Raises:
        UserError: no cluster is configured, or its configuration is invalid.
    """
    files = candidates(path, environ)
    config = merge_files([file for file in files if file.exists()])
    if path is not None and not path.exists():
        raise UserError(
            f"there is no kubeconfig {path}", hint="correct the path after --kubeconfig"
        )
    if not config["contexts"] and context is None and path is None:
        if "KUBERNETES_SERVICE_HOST" in environ and (service_account / "token").exists():
            return in_cluster(environ, service_account)
        looked = ", ".join(str(file) for file in files)
        raise UserError(f"no cluster is configured (looked at {looked})", hint=NO_CLUSTER)
    return from_context(config, choose_context(config, context, files))


def candidates(path: Path | None, environ: Mapping[str, str]) -> list[Path]:
    """Return the files to read, the first of them the strongest."""
    if path is not None:
        return [path]
    if named := [part for part in environ.get("KUBECONFIG", "").split(os.pathsep) if part]:
        return [Path(part).expanduser() for part in named]
    return [Path(environ.get("HOME") or Path.home()) / ".kube" / "config"]


def merge_files(files: Sequence[Path]) -> dict[str, Any]:
    """Return all files as one: the first value wins, as with kubectl."""
    whole: dict[str, Any] = {"clusters": {}, "users": {}, "contexts": {}, "current-context": ""}
    for file in files:
        content = parse_file(file)
        whole["current-context"] = whole["current-context"] or content.get("current-context") or ""
        for section in ("clusters", "users", "contexts"):
            for name, entry in list_entries(content, section, file):
                whole[section].setdefault(name, absolute(entry, file.parent))
    return whole


def list_entries(
    content: Mapping[str, Any], section: str, file: Path
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the entries of a section with their names.

    Raises:
        UserError: the section has another form.
    """
    items = content.get(section) or []
    for item in items if isinstance(items, list) else [items]:
        entry = item.get(section[:-1]) or {} if isinstance(item, dict) else None
        if not isinstance(items, list) or not isinstance(entry, dict):
            raise UserError(
                f"kubeconfig {file}: `{section}` must be a list of"
                f" {{name: NAME, {section[:-1]}: {{...}}}}",
                hint="check that it is the right file",
            )
        yield str(item.get("name", "")), entry


def parse_file(file: Path) -> dict[str, Any]:
    """Return one file's content."""
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        if file.is_fifo():  # it may never be written to
            raise UserError(f"kubeconfig {file} is a pipe", hint="write it to a file")
        content = yaml.load(file.read_text("utf-8"), Loader=loader)
    except OSError as error:
        raise UserError(f"cannot read kubeconfig {file}: {error.strerror}") from error
    except (yaml.YAMLError, UnicodeDecodeError, ValueError, RecursionError) as error:
        raise UserError(
            f"kubeconfig {file} is not YAML", details=str(error).splitlines()
        ) from error
    if not isinstance(content or {}, dict):
        raise UserError(
            f"kubeconfig {file} is not a mapping", hint="check that it is the right file"
        )
    return content or {}


def absolute(entry: dict[str, Any], base: Path) -> dict[str, Any]:
    """Return an entry with absolute paths; they are relative to the directory of its file."""
    paths: dict[str, Any] = {key: str(base / str(entry[key])) for key in PATHS if entry.get(key)}
    plugin = entry.get("exec")
    command = plugin.get("command") if isinstance(plugin, dict) else None
    if isinstance(command, str) and os.sep in command:
        paths["exec"] = {**entry["exec"], "command": str(base / command)}
    return {**entry, **paths}


def choose_context(config: Mapping[str, Any], context: str | None, files: Sequence[Path]) -> str:
    """Return the name of the context to use."""
    name = context or str(config["current-context"])
    known = ", ".join(sorted(config["contexts"])) or "none"
    where = ", ".join(str(file) for file in files)
    if not name:
        raise UserError(
            f"no context is current in {where}", hint=f"choose one with --context: {known}"
        )
    if name not in config["contexts"]:
        raise UserError(f"there is no context {name} in {where}", hint=f"there are: {known}")
    return name


def from_context(config: Mapping[str, Any], name: str) -> Target:
    context = config["contexts"][name]
    cluster = config["clusters"].get(str(context.get("cluster")))
    user = config["users"].get(str(context.get("user")), {})
    if not cluster or not cluster.get("server"):
        raise UserError(
            f"context {name} names the cluster {context.get('cluster')!r}, which has no server",
            hint="correct the kubeconfig, or choose another context with --context",
        )
    return Target(
        server=without_user(str(cluster["server"]).rstrip("/")),
        context=name,
        namespace=str(context.get("namespace") or "default"),
        authority=inline_or_file(cluster, "certificate-authority"),
        insecure=bool(cluster.get("insecure-skip-tls-verify")),
        server_name=str(cluster.get("tls-server-name") or ""),
        proxy=str(cluster.get("proxy-url") or ""),
        credentials=partial(user_credentials, user, cluster, name, inline_or_file),
    )


def without_user(url: str) -> str:
    """Return a URL without its user and password: errors show it, and no one logs in by them."""
    scheme, separator, rest = url.partition("://")
    host, slash, path = rest.partition("/")
    return f"{scheme}{separator}{host.rpartition('@')[2]}{slash}{path}" if separator else url


def inline_or_file(entry: Mapping[str, Any], key: str) -> str:
    """Return a PEM text that is inline in the entry, or in the file that it names."""
    try:
        if data := entry.get(f"{key}-data"):
            return base64.b64decode("".join(str(data).split()), validate=True).decode()
        return Path(entry[key]).read_text() if entry.get(key) else ""
    except (OSError, ValueError, binascii.Error) as error:
        raise UserError(f"kubeconfig: cannot read the {key}: {error}") from error


def in_cluster(environ: Mapping[str, str], service_account: Path) -> Target:
    """Return the target of the pod that we run in."""
    host, port = environ["KUBERNETES_SERVICE_HOST"], environ.get("KUBERNETES_SERVICE_PORT", "443")
    namespace = service_account / "namespace"
    return Target(
        server=f"https://{f'[{host}]' if ':' in host else host}:{port}",
        namespace=namespace.read_text().strip() if namespace.exists() else "default",
        authority=(service_account / "ca.crt").read_text(),
        credentials=partial(file_credentials, service_account / "token"),
    )
