"""A machine's network interfaces, as the kernel lists them; independent of DDS. Python 3.

Why: the probe of a second network, the stand-in and the exporter all need an interface's address,
and join a multicast group on one interface of several.
"""

import fcntl
from struct import pack, unpack_from

try:
    import _socket as socket  # half of `import socket` is for classes that are not needed here
except ImportError:  # not CPython
    import socket

IP_MULTICAST_ALL = 49  # which Python does not name
SIOCGIFFLAGS, SIOCGIFADDR = 0x8913, 0x8915
UP_AND_RUNNING = 0x41


def addresses():
    """Return name -> IPv4 address of every interface but the loopback; None if it has none."""
    names = [name for _, name in socket.if_nameindex()]
    return {name: address_of(name) for name in names if name != "lo"}


def address_of(name):
    """Return an interface's IPv4 address, None if it has none or does not exist."""
    answer = _query(SIOCGIFADDR, name)
    return socket.inet_ntoa(answer[20:24]) if answer else None


def is_up(name):
    """Whether an interface is up and has a link."""
    answer = _query(SIOCGIFFLAGS, name)
    return bool(answer) and unpack_from("H", answer, 16)[0] & UP_AND_RUNNING == UP_AND_RUNNING


def membership(group, name):
    """Return a struct ip_mreqn of a multicast group on an interface."""
    return socket.inet_aton(group) + pack("=4si", b"", socket.if_nametoindex(name))


def _query(request, name):
    """Return the answer of an interface's ioctl, None if it fails."""
    asking = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        return fcntl.ioctl(asking.fileno(), request, pack("256s", name.encode()[:15]))
    except OSError:
        return None
    finally:
        asking.close()
