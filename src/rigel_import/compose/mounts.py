"""The volumes, devices and ports of a service."""

from __future__ import annotations

import os
import re
from typing import Any

from rigel_import.compose.service import Service
from rigel_import.compose.values import Value
from rigel_k8s.app.deploying.localfiles import read_folder
from rigel_k8s.errors import UserError
from rigel_k8s.objects.naming import object_name
from rigel_k8s.system.trust import Untrusted

#: Paths of a machine that are of no use in a pod, and why.
UNUSABLE = {
    r"\.X11-unix|\.?Xauthority|\.docker\.xauth|/pulse\b": "a pod has no X display or sound",
    r"docker\.sock$": "Kubernetes has no Docker socket: the program needs another way",
    r"^/dev/shm/?$": "see `shared_memory` of `network`",
}
#: Paths below /dev that are directories, which are mounted as volumes.
DIRECTORIES = re.compile(r"/dev(/(bus|bus/usb|dri|input|snd|serial|serial/by-id|v4l|pts|shm))?/?")
PRIVILEGED = "the container is privileged to open its devices; a device plugin makes it unnecessary"
EMPTY = (
    "a volume is empty at first: docker copies what the image has at its path, Kubernetes does not"
)
OUTSIDE = "ports are open inside of the cluster: for others set `service_type`, or `rigel forward`"
MACHINE = "if the cluster has several machines, set placement: {node: NAME} to the right one"


def add_volumes(service: Service) -> None:
    for item in service.content.get("volumes").elements():
        source, target, read_only = item.mount()
        kind = item.get("type").text
        below = item.get("volume", "subpath").text
        volume = {"mount_path": target, "read_only": read_only, "sub_path": below}
        volume = {key: value for key, value in volume.items() if value}
        reason = next((UNUSABLE[path] for path in UNUSABLE if re.search(path, source)), None)
        if not source:
            service.remark(item, f"{target} is a part of the pod, and empty in each new one")
        elif reason or kind not in ("", "bind", "volume"):
            reason = reason or f"copy what it needs of this {kind} into the image"
            service.remark(item, f"{source} is not mounted: {reason}")
        elif source.startswith("/"):
            service.append("volumes", {"host_path": source, **volume})
            service.remark(item, MACHINE)
        elif source.startswith((".", "~")) or kind == "bind":
            add_local(service, item, source, target, read_only=read_only)
        else:
            service.append("volumes", {"name": object_name(source), **volume})
            service.remark(item, EMPTY)


def add_local(service: Service, item: Value, source: str, target: str, *, read_only: bool) -> None:
    """Add a file or folder beside the Compose file, or of its user, if it is not too large."""
    path = item.path(source)
    try:
        read_folder(path, service.directory)
    except UserError as error:
        how = "copy it into the image, or add its whole path as a `host_path`"
        if isinstance(error, Untrusted):
            how = f"{error.hint}, and import again; or {how}"
        service.remark(item, f"{source} is not mounted at {target}: {error.message}; {how}")
        return
    name = os.path.relpath(path, service.directory)
    service.options.setdefault("files", {})[target] = name
    if path.is_dir():
        service.folders.setdefault(name, item.place)
    if not read_only:
        message = f"{target} is read-only: what the program writes needs a volume"
        service.remark(item, message)


def add_devices(service: Service) -> None:
    for item in service.content.get("devices").elements():
        words = [item.get(key).written for key in ("source", "target") if item.entries()]
        path, target, *_ = [*(words or item.written.split(":")), ""]
        if re.search(r"^$|[*?=]", path):
            service.remark(item, f'"{path}" is not a device: write its path, or {{resource: NAME}}')
            continue
        if DIRECTORIES.fullmatch(path):
            service.append("volumes", {"host_path": path, "mount_path": target or path})
        elif target in ("", path):
            service.append("devices", path)
        else:
            service.append("devices", {"path": path, "mount_path": target})
        if service.content.get("privileged").text != "true":
            service.remark(item, PRIVILEGED)
        service.remark(item, MACHINE)


def add_ports(service: Service) -> None:
    """Add the ports of a service, which become those of a Kubernetes Service."""
    content = service.content
    items = [*content.get("ports").elements(), *content.get("expose").elements()]
    for item in [*items, *service.named_ports]:
        if item.entries():
            target, protocol = item.get("target").text, item.get("protocol").text
            published = item.get("published").text or target
        else:
            text, _, protocol = item.text.partition("/")
            *before, target = text.split(":")
            published = before[-1] if before else target
        if not (target.isdigit() and published.isdigit()):
            service.remark(item, f'"{target}" is not one port: write each of them in `ports`')
            continue
        port: dict[str, Any] = {"port": int(target)}
        if protocol.lower() == "udp":
            port["protocol"] = "UDP"
        others = [dict(one) for one in service.options.get("ports", ())]
        for one in others:
            one.pop("service_port", None)
        if port not in others:
            port |= {"service_port": int(published)} if published != target else {}
            service.append("ports", port)
        elif published != target:
            service.remark(item, f"{published} is not carried over: {target} has one port already")
    if content.get("ports").elements():
        service.remark(content.get("ports"), OUTSIDE)
