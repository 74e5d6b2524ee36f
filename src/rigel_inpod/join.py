"""Carries the frames of a pod's interfaces over a command's input and output (`rigel join`).

Why: a program on another computer gets this pod's addresses, and so is an ordinary participant:
multicast, peers, discovery servers and a ROS master reach it as any node.
Contract: `join.py hold` is the pod's own process. It ends when the other one has ended, or when
that has not come within 60 s. `join.py` prints a line of JSON with the interfaces, the routes, the
variables and files of the network, and the texts of resolv.conf and hosts; then it takes the
addresses from this kernel. From then on, each frame is a head of 5 bytes (number of the interface,
length) and a virtio_net_hdr before the frame itself, in both directions. A head of length 0 is a
sign of life; without one for 30 s it ends. Needs CAP_NET_ADMIN and CAP_NET_RAW. No IPv6.
"""

import fcntl
import json
import os
import select
import socket
import struct
import sys
import threading
import time

import interfaces

HEAD = struct.Struct(">BI")
LARGEST = 10 + 65550
MARK = "/tmp/rigel-join"
NETWORK = "/rigel-k8s-network"
#: By these the network of the release's nodes is described.
VARIABLES = ("ROS_MASTER_URI", "ROS_DOMAIN_ID", "ROS_AUTOMATIC", "ROS_STATIC", "ROS_LOCALHOST")
VARIABLES += (
    "ROS_DISCOVERY",
    "ROS_SUPER",
    "RMW_",
    "FASTDDS_",
    "FASTRTPS_",
    "CYCLONEDDS_",
    "ZENOH_",
)
PATIENCE = 30
SOL_PACKET, ADD_MEMBERSHIP, VNET_HDR, PROMISCUOUS, OUTGOING = 263, 1, 15, 1, 4
SET_ADDRESS, GET_MASK = 0x8916, 0x891B
GET_MTU, GET_HARDWARE = 0x8921, 0x8927
IPV6 = b"\x86\xdd"


def ask(name, request, value=b""):
    """Return the 24 bytes of an interface that an ioctl reads or sets."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as some:
        packed = struct.pack("16s24s", name.encode(), value)
        return fcntl.ioctl(some, request, packed)[16:]


def list_interfaces():
    """Return the interfaces with an IPv4 address, without the loopback one."""
    return [
        {
            "name": name,
            "address": address,
            "mask": socket.inet_ntoa(ask(name, GET_MASK)[4:8]),
            "mtu": struct.unpack("i", ask(name, GET_MTU)[:4])[0],
            "hardware": ask(name, GET_HARDWARE)[2:8].hex(),
        }
        for name, address in interfaces.addresses().items()
        if address
    ]


def list_routes():
    """Return the IPv4 routes; those of the kernel's own making are among them."""
    found = []
    with open("/proc/net/route") as file:
        for line in list(file)[1:]:
            name, target, gateway, _, _, _, _, mask = line.split()[:8]
            words = (
                socket.inet_ntoa(struct.pack("=I", int(w, 16))) for w in (target, gateway, mask)
            )
            found.append([name, *words])
    return found


def read(path):
    """Return a text file's content."""
    with open(path, encoding="utf-8") as file:
        return file.read()


def describe():
    """Return what the other side must know."""
    paths = (
        [os.path.join(NETWORK, name) for name in os.listdir(NETWORK)]
        if os.path.isdir(NETWORK)
        else []
    )
    return {
        "interfaces": list_interfaces(),
        "routes": list_routes(),
        "variables": {k: v for k, v in os.environ.items() if k.startswith(VARIABLES)},
        "folder": NETWORK,
        "files": {os.path.basename(path): read(path) for path in paths if os.path.isfile(path)},
        "resolv": read("/etc/resolv.conf"),
        "hosts": read("/etc/hosts"),
    }


def open_interface(name):
    """Return a socket for an interface's frames, and take the address from the kernel."""
    opened = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(3))
    opened.setsockopt(SOL_PACKET, VNET_HDR, 1)
    opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8 << 20)
    opened.bind((name, 0))
    member = struct.pack("iHH8s", socket.if_nametoindex(name), PROMISCUOUS, 0, b"")
    opened.setsockopt(SOL_PACKET, ADD_MEMBERSHIP, member)
    ask(name, SET_ADDRESS, struct.pack("HH4s", socket.AF_INET, 0, b"\0\0\0\0"))
    return opened


def receive(number, opened, lock):
    """Write the frames that come to an interface to the standard output."""
    while True:
        data, source = opened.recvfrom(LARGEST)
        if source[2] != OUTGOING and data[22:24] != IPV6:
            with lock:
                write(HEAD.pack(number, len(data)) + data)


def write(data):
    """Write all of it to the standard output, or end this process."""
    try:
        while data:
            data = data[os.write(1, data) :]
    except OSError:
        os._exit(1)


def take(size, rest):
    """Read until there are so many bytes; end this process if they do not come."""
    while len(rest) < size:
        if not select.select([0], [], [], PATIENCE)[0]:
            os._exit(1)
        more = os.read(0, 1 << 18)
        if not more:
            os._exit(0)
        rest += more


def relay():
    """Carry frames until the other side has gone."""
    with open(MARK, "w") as mark:
        fcntl.flock(mark, fcntl.LOCK_EX)
        write(json.dumps(describe()).encode() + b"\n")
        lock = threading.Lock()
        opened = [open_interface(one["name"]) for one in list_interfaces()]
        for number, one in enumerate(opened):
            threading.Thread(target=receive, args=(number, one, lock), daemon=True).start()
        rest = bytearray()
        while True:
            take(HEAD.size, rest)
            number, size = HEAD.unpack_from(rest)
            take(HEAD.size + size, rest)
            if size:
                try:
                    opened[number].send(rest[HEAD.size : HEAD.size + size])
                except OSError:  # as a network that has lost it
                    pass
            del rest[: HEAD.size + size]


def hold():
    """Wait for the other process, and for its end."""
    begun = time.monotonic()
    while time.monotonic() < begun + 60 or os.path.exists(MARK):
        time.sleep(0.5)
        try:
            with open(MARK) as mark:
                fcntl.flock(mark, fcntl.LOCK_EX | fcntl.LOCK_NB)
                return
        except OSError:  # it is not there, or locked
            pass


hold() if sys.argv[1:] == ["hold"] else relay()
