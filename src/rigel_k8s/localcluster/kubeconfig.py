"""The user's kubeconfig: a context is merged in, and taken out again; everything else stays."""

from __future__ import annotations

import base64
import os
import pwd
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from rigel_k8s.errors import UserError

__all__ = ["entries", "merge", "remove", "user_kubeconfig"]

SECTIONS = ("clusters", "users", "contexts")


def user_kubeconfig(environ: Mapping[str, str] = os.environ) -> Path:
    """Return the file to change: the first of $KUBECONFIG, else that of the user behind sudo."""
    if first := environ.get("KUBECONFIG", "").split(os.pathsep)[0]:
        return Path(first)
    if user := environ.get("SUDO_USER"):
        return Path(pwd.getpwnam(user).pw_dir) / ".kube" / "config"
    return Path.home() / ".kube" / "config"


def entries(context: str, server: str, ca: Path, certificate: Path, key: Path) -> dict[str, Any]:
    """Return a kubeconfig of one context with its certificates inside."""
    cluster = {"server": server, "certificate-authority-data": encoded(ca)}
    user = {"client-certificate-data": encoded(certificate), "client-key-data": encoded(key)}
    return {
        "apiVersion": "v1",
        "kind": "Config",
        "clusters": [{"name": context, "cluster": cluster}],
        "users": [{"name": context, "user": user}],
        "contexts": [{"name": context, "context": {"cluster": context, "user": context}}],
        "current-context": context,
    }


def encoded(path: Path) -> str:
    """Return a file's bytes in base64."""
    return base64.b64encode(path.read_bytes()).decode()


def load(path: Path) -> dict[str, Any]:
    """Return a kubeconfig file's content, empty where there is none.

    Raises:
        UserError: it is no mapping; changing it could destroy something.
    """
    try:
        content = yaml.safe_load(path.read_text()) if path.exists() else {}
    except yaml.YAMLError as error:
        raise UserError(f"{path} is not YAML: {error}", hint="mend or move it first") from error
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise UserError(f"{path} is not a kubeconfig", hint="mend or move it first")
    return content


def merge(path: Path, context: str, new: Mapping[str, Any]) -> str | None:
    """Put a context into the file and make it current; return the one that was current."""
    content = load(path) or {"apiVersion": "v1", "kind": "Config"}
    before = content.get("current-context") or None
    for section in SECTIONS:
        kept = [item for item in content.get(section) or [] if item.get("name") != context]
        content[section] = [*kept, *new[section]]
    content["current-context"] = context
    save(path, content)
    return before if before != context else None


def remove(path: Path, context: str, previous: str | None) -> None:
    """Take a context out; where it was current, the one before becomes current again."""
    if not path.exists():
        return
    content = load(path)
    for section in SECTIONS:
        items = content.get(section) or []
        content[section] = [item for item in items if item.get("name") != context]
    if content.get("current-context") == context:
        names = [item.get("name") for item in content["contexts"]]
        content["current-context"] = previous if previous in names else ""
    if any(content.get(section) for section in SECTIONS):
        save(path, content)
        return
    path.unlink()
    if path.parent.name == ".kube" and not any(path.parent.iterdir()):
        path.parent.rmdir()


def save(path: Path, content: Mapping[str, Any]) -> None:
    """Write the file at once, readable by its owner only; under sudo it belongs to the caller."""
    new_directory = not path.parent.exists()
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.rigel")
    temporary.touch(mode=0o600)
    temporary.write_text(yaml.safe_dump(dict(content), sort_keys=False))
    if user := os.environ.get("SUDO_USER"):
        owner = pwd.getpwnam(user)
        os.chown(temporary, owner.pw_uid, owner.pw_gid)
        if new_directory:
            os.chown(path.parent, owner.pw_uid, owner.pw_gid)
    temporary.replace(path)
