"""What images under upstream's names are made of, independent of their programs' purpose."""

from __future__ import annotations

from pathlib import Path

from rigel_lab.cluster.commands import run
from rigel_lab.cluster.components import Components


def shorten_name(name: str) -> str:
    """Return an image's name in the cluster's registry, which stands for every registry."""
    return name.partition("/")[2]


def shell(components: Components) -> dict[str, Path | str]:
    """Return the file that is the shell and all its tools."""
    return {"bin/busybox": find_program(components, "busybox")}


def tools(components: Components) -> dict[str, str]:
    """Return the links by whose names the shell and its tools are started."""
    listed = run([components.program("busybox"), "--list"]).split()
    return {f"bin/{tool}": "busybox" for tool in listed if tool != "busybox"}


def users(**numbers: int) -> dict[str, Path | str]:
    """Return /etc/passwd and /etc/group with root, and with others by name and number."""
    others = [f"{name}:x:{number}:{number}::/:/sbin/nologin\n" for name, number in numbers.items()]
    groups = [f"{name}:x:{number}:\n" for name, number in numbers.items()]
    return {
        "etc/passwd": "".join(["root:x:0:0:root:/root:/bin/sh\n", *others]),
        "etc/group": "".join(["root:x:0:\n", *groups]),
    }


def find_program(components: Components, name: str) -> Path:
    """Return a program's path."""
    return Path(components.program(name))


def text(components: Components, name: str) -> str:
    """Return a text that belongs to the programs."""
    return find_program(components, name).read_text()
