"""Runs a program in a network namespace that is a pod's; only the standard library, by itself.

`inside.py SOCKET COMMAND...` has been started in new network and mount namespaces, in which it is
root. It reads a line of JSON from SOCKET (what src/rigel_inpod/join.py prints, see there, and
`here`, a folder for files), makes interfaces with the pod's addresses, sends their descriptors,
waits for an answer, and becomes COMMAND, which has the pod's names and variables.
"""

from __future__ import annotations

import ctypes
import fcntl
import json
import os
import re
import signal
import socket
import struct
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

TUN_SET, TUN_OFFLOADS = 0x400454CA, 0x400454D0
TAP, NO_HEAD, VNET_HEAD = 0x0002, 0x1000, 0x4000
CHECKSUM, TCP4, TCP6 = 0x01, 0x02, 0x04
SET_FLAGS, SET_ADDRESS, SET_MASK = 0x8914, 0x8916, 0x891C
SET_MTU, SET_HARDWARE, ADD_ROUTE = 0x8922, 0x8924, 0x890B
UP, GATEWAY, HOST = 0x1, 0x2, 0x4
ETHERNET, PDEATHSIG = 1, 1
MS_BIND, MS_REC, MS_PRIVATE = 0x1000, 0x4000, 0x40000
#: Names are asked of the files and servers that the pod has, of no service of this computer.
NAMES = "hosts: files dns"


def pack_address(text: str) -> bytes:
    return struct.pack("HH4s8x", socket.AF_INET, 0, socket.inet_aton(text))


def configure(name: str, request: int, value: bytes) -> None:
    """Set something of an interface."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as some:
        fcntl.ioctl(some, request, struct.pack("16s24s", name.encode(), value))


def make_interface(one: dict[str, Any]) -> int:
    """Make an interface, and return the descriptor that its frames pass."""
    made = os.open("/dev/net/tun", os.O_RDWR)
    name = one["name"]
    flags = TAP | NO_HEAD | VNET_HEAD
    fcntl.ioctl(made, TUN_SET, struct.pack("16sH22x", name.encode(), flags))
    fcntl.ioctl(made, TUN_OFFLOADS, CHECKSUM | TCP4 | TCP6)
    configure(name, SET_HARDWARE, struct.pack("H6s", ETHERNET, bytes.fromhex(one["hardware"])))
    configure(name, SET_MTU, struct.pack("i", one["mtu"]))
    configure(name, SET_ADDRESS, pack_address(one["address"]))
    configure(name, SET_MASK, pack_address(one["mask"]))
    configure(name, SET_FLAGS, struct.pack("H", UP))
    return made


def add_route(name: str, target: str, gateway: str, mask: str) -> None:
    """Add a route, unless the kernel has made it itself."""
    flags = UP | (GATEWAY if gateway != "0.0.0.0" else 0)
    flags |= HOST if mask == "255.255.255.255" else 0
    device = ctypes.create_string_buffer(name.encode())
    entry = struct.pack(
        "@L16s16s16sHhLLhPLLH", 0, pack_address(target), pack_address(gateway), pack_address(mask),
        flags, 0, 0, 0, 0, ctypes.addressof(device), 0, 0, 0,
    )  # fmt: skip
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as some, suppress(FileExistsError):
        fcntl.ioctl(some, ADD_ROUTE, entry)


def cover(path: str, text: str, folder: Path) -> None:
    """Let a file have another content for this program and its children."""
    target = Path(path).resolve()
    if target.exists():
        file = folder / target.name
        file.write_text(text)
        mount(str(file), str(target), MS_BIND)


def mount(source: str, target: str, flags: int) -> None:
    """Call mount(2)."""
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mount(source.encode(), target.encode(), None, flags, None):
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), target)


def read_variables(network: dict[str, Any], folder: Path) -> dict[str, str]:
    """Return the variables for the program; files that they name are written into a folder."""
    there, here = network["folder"], str(folder)
    for name, text in network["files"].items():
        (folder / name).write_text(text.replace(there, here))
    made = {name: text.replace(there, here) for name, text in network["variables"].items()}
    if "ROS_MASTER_URI" in made:
        made["ROS_IP"] = network["interfaces"][0]["address"]
    if "ROS_DISCOVERY_SERVER" in made:  # tools want to see all topics
        made.setdefault("ROS_SUPER_CLIENT", "TRUE")
    return made


def become(command: list[str]) -> None:
    """Become the command, as the user who has joined."""
    try:
        os.execvp(command[0], command)
    except FileNotFoundError:
        sys.exit(f"error: {command[0]} does not exist on this computer")
    except OSError as error:
        sys.exit(f"error: {command[0]}: {error.strerror}")


def main(number: str, *command: str) -> None:
    """Set up the namespaces and become the command."""
    # Its network ends with the caller, and then a ROS node would wait for its master for long.
    ctypes.CDLL(None).prctl(PDEATHSIG, signal.SIGKILL)
    with socket.socket(fileno=int(number)) as caller:
        with caller.makefile() as lines:
            network = json.loads(lines.readline())
        try:
            made = set_up(network)
        except OSError as error:
            sys.exit(f"error: {error}")
        socket.send_fds(caller, [b"."], made)
        caller.recv(1)
    become(list(command))


def set_up(network: dict[str, Any]) -> list[int]:
    """Make interfaces, names and variables; return the descriptors of the interfaces."""
    configure("lo", SET_FLAGS, struct.pack("H", UP))
    made = [make_interface(one) for one in network["interfaces"]]
    # A gateway's own route comes first.
    for route in sorted(network["routes"], key=lambda one: one[2] != "0.0.0.0"):
        add_route(*route)
    mount("none", "/", MS_REC | MS_PRIVATE)
    folder = Path(network["here"])
    cover("/etc/resolv.conf", network["resolv"], folder)
    cover("/etc/hosts", network["hosts"], folder)
    services = Path("/etc/nsswitch.conf")
    if services.exists():
        cover(str(services), re.sub(r"(?m)^hosts:.*", NAMES, services.read_text()), folder)
    os.environ.pop("ROS_HOSTNAME", None)
    os.environ.update(read_variables(network, folder))
    return made


if __name__ == "__main__":
    main(*sys.argv[1:])
