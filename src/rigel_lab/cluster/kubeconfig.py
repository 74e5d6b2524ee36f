"""The user's kubeconfig: a context is merged in, and removed again; everything else stays."""

from __future__ import annotations

import base64
import os
import pwd
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from rigel_k8s.errors import UserError
from rigel_k8s.yaml_text import document

SECTIONS = ("clusters", "users", "contexts")


class Loader(yaml.SafeLoader):
    """Reads as kubectl does: a time stays text."""


Loader.yaml_implicit_resolvers = {
    first: [(tag, expression) for tag, expression in resolvers if not tag.endswith(":timestamp")]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}


def user_kubeconfig(environ: Mapping[str, str] = os.environ) -> Path:
    """Return the file to change: the first of $KUBECONFIG, else that of the user behind sudo."""
    files = [file for file in environ.get("KUBECONFIG", "").split(os.pathsep) if file]
    if files:
        return Path(files[0])
    if user := environ.get("SUDO_USER"):
        return Path(pwd.getpwnam(user).pw_dir) / ".kube" / "config"
    return Path.home() / ".kube" / "config"


def entries(context: str, server: str, ca: Path, certificate: Path, key: Path) -> dict[str, Any]:
    """Return a kubeconfig of one context with its certificates inside."""
    cluster = {"server": server, "certificate-authority-data": encode(ca)}
    user = {"client-certificate-data": encode(certificate), "client-key-data": encode(key)}
    return {
        "apiVersion": "v1",
        "kind": "Config",
        "clusters": [{"name": context, "cluster": cluster}],
        "users": [{"name": context, "user": user}],
        "contexts": [{"name": context, "context": {"cluster": context, "user": context}}],
        "current-context": context,
    }


def encode(path: Path) -> str:
    """Return a file's bytes in base64."""
    return base64.b64encode(path.read_bytes()).decode()


def load(path: Path) -> dict[str, Any]:
    """Return a kubeconfig file's content, empty if it does not exist.

    Raises:
        UserError: it is not a kubeconfig; changing it could destroy something.
    """
    try:
        content = yaml.load(path.read_text(), Loader) if path.exists() else {}  # a SafeLoader
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise UserError(f"{path} is not YAML: {error}", hint="correct or move it first") from error
    except OSError as error:
        raise UserError(
            f"{path}: {error.strerror}", hint="name another file with KUBECONFIG"
        ) from error
    if not isinstance(content or {}, dict) or not all(
        isinstance(items, list) and all(isinstance(item, dict) for item in items)
        for items in sections(content or {})
    ):
        raise UserError(f"{path} is not a kubeconfig", hint="correct or move it first")
    return content or {}


def sections(content: Mapping[str, Any]) -> list[Any]:
    """Return the three lists of a kubeconfig."""
    return [content.get(section) or [] for section in SECTIONS]


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
    """Remove a context; if it was current, the one before becomes current again.

    A file with no other content is removed, and ~/.kube if it is empty.
    """
    if not path.exists():
        return
    content = load(path)
    for section in SECTIONS:
        items = content.get(section) or []
        content[section] = [item for item in items if item.get("name") != context]
    if content.get("current-context") == context:
        names = [item.get("name") for item in content["contexts"]]
        content["current-context"] = previous if previous in names else ""
    if any(sections(content)):
        save(path, content)
        return
    path.unlink()
    if path.parent.name == ".kube" and not any(path.parent.iterdir()):
        path.parent.rmdir()


def save(path: Path, content: Mapping[str, Any]) -> None:
    """Write the file, all or nothing; its owner and mode stay, a new one is private."""
    path = path.resolve()
    made = [parent for parent in path.parents if not parent.exists()]
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.rigel")
    temporary.unlink(missing_ok=True)
    temporary.touch(mode=0o600)
    temporary.write_text(document(content))
    if path.exists():
        before = path.stat()
        temporary.chmod(before.st_mode)
        os.chown(temporary, before.st_uid, before.st_gid)
    elif user := os.environ.get("SUDO_USER"):
        owner = pwd.getpwnam(user)
        for each in (temporary, *made):
            os.chown(each, owner.pw_uid, owner.pw_gid)
    temporary.replace(path)
