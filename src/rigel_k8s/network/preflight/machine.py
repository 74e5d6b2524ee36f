"""One machine's interfaces, addresses and CNI programs, as a script found them.

The script is PROBE: POSIX shell that runs inside the Multus daemon's container, so it uses only
builtins, cat, and readlink, zcat and grep where there are any. It changes nothing.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Iterator, Mapping
from typing import TypeAlias

import attrs

Address: TypeAlias = ipaddress.IPv4Address | ipaddress.IPv6Address
Subnet: TypeAlias = ipaddress.IPv4Network | ipaddress.IPv6Network

ETHERNET = 1  # ARPHRD_ETHER
UP = 0x1  # IFF_UP
GATEWAY = 0x2  # RTF_GATEWAY

#: $1: where the machine's root directory is mounted, "" for nowhere; then CNI program directories.
PROBE = r"""
root=$1; shift
echo @links
for d in /sys/class/net/*; do
  [ -e "$d/flags" ] || continue
  w=- k=- u=
  { read -r f <"$d/flags" && read -r t <"$d/type" && read -r o <"$d/operstate" &&
    read -r m <"$d/mtu"; } 2>/dev/null || continue # deleted when its pod ends
  if [ -e "$d/wireless" ] || [ -e "$d/phy80211" ]; then w=wireless; fi
  while IFS='=' read -r a b; do if [ "$a" = DEVTYPE ]; then k=$b; fi; done \
    2>/dev/null <"$d/uevent"
  for p in "$d"/upper_*; do if [ -e "$p" ]; then u=$u,${p##*/upper_}; fi; done
  echo "${d##*/} $t $f $o $m $w $k ${u:--}"
done
echo @routes; cat /proc/net/route
echo @addresses; cat /proc/net/fib_trie
echo @addresses6; if [ -e /proc/net/if_inet6 ]; then cat /proc/net/if_inet6; fi
there() {
  q=$1 i=0
  while [ -L "$q" ] && [ ! -e "$q" ] && [ $i -lt 5 ]; do
    t=$(readlink "$q") || return 0
    case $t in
      /*) if [ -z "$root" ]; then return 0; fi; q=$root$t ;;
      *) q=${q%/*}/$t ;;
    esac
    i=$((i + 1))
  done
  [ -x "$q" ]
}
for b in "$@"; do
  if [ -d "$b" ]; then
    echo "@programs ${b#"$root"}"
    for p in "$b"/*; do if there "$p"; then echo "${p##*/}"; fi; done
  fi
done
if c=$(zcat /proc/config.gz 2>/dev/null | grep -E 'CONFIG_(MACVLAN|IPVLAN)[= ]'); then
  echo @kernel; echo "$c"
fi
echo @end
"""


@attrs.frozen
class Interface:
    """A network interface of a machine.

    Attributes:
        ethernet: whether it carries Ethernet frames (a tunnel does not).
        up: whether it is switched on; state: the kernel's word for its state then.
        kind: its type: wlan, bridge, vlan, macvlan ...; "" if the kernel does not list it.
        uppers: interfaces on top of it that are in the machine's own network.
    """

    name: str
    ethernet: bool = True
    up: bool = True
    state: str = "up"
    mtu: int = 1500
    wireless: bool = False
    kind: str = ""
    uppers: tuple[str, ...] = ()


@attrs.frozen
class Route:
    """A range of addresses that a machine reaches through an interface."""

    interface: str
    subnet: Subnet
    direct: bool = True


@attrs.frozen
class MachineFacts:
    """The facts about one machine.

    Attributes:
        programs: directory -> its CNI programs; empty if no directory could be read.
        kernel: macvlan, ipvlan -> whether this kernel has it; left out if unknown.
    """

    interfaces: Mapping[str, Interface]
    routes: tuple[Route, ...] = ()
    addresses: frozenset[Address] = frozenset()
    programs: Mapping[str, frozenset[str]] = attrs.field(factory=dict)
    kernel: Mapping[str, bool] = attrs.field(factory=dict)

    @property
    def default_interface(self) -> str | None:
        """The interface of the default route, which macvlan uses if none is named."""
        return next((r.interface for r in self.routes if r.subnet.prefixlen == 0), None)


def parse(text: str) -> MachineFacts:
    """Return the facts in the script's output.

    Raises:
        ValueError: the text is not the script's whole output.
    """
    sections = _sections(text)
    if "end" not in sections:
        raise ValueError("the output of the script on the machine is incomplete")
    interfaces = {one.name: one for one in map(_interface, sections["links"])}
    directories = {
        name.partition(" ")[2]: frozenset(lines)
        for name, lines in sections.items()
        if name.startswith("programs ")
    }
    return MachineFacts(
        interfaces=interfaces,
        routes=tuple(_routes(sections["routes"][1:])),
        addresses=frozenset(
            [*_addresses(sections["addresses"]), *_addresses6(sections["addresses6"])]
        ),
        programs=directories,
        kernel=dict(_kernel(sections.get("kernel", []))),
    )


def _sections(text: str) -> dict[str, list[str]]:
    """Return the lines below each line that starts with @."""
    sections: dict[str, list[str]] = {}
    lines: list[str] = []
    for line in text.splitlines():
        if line.startswith("@"):
            lines = sections.setdefault(line[1:], [])
        elif line.strip():
            lines.append(line)
    return sections


def _interface(line: str) -> Interface:
    name, kind, flags, state, mtu, wireless, devtype, uppers = line.split()
    return Interface(
        name,
        ethernet=int(kind) == ETHERNET,
        up=bool(int(flags, 16) & UP),
        state=state,
        mtu=int(mtu),
        wireless=wireless == "wireless" or devtype == "wlan",
        kind="" if devtype == "-" else devtype,
        uppers=tuple(uppers.strip(",-").split(",")) if uppers != "-" else (),
    )


def _routes(lines: list[str]) -> Iterator[Route]:
    """Read /proc/net/route: numbers are hexadecimal in the machine's byte order."""
    for line in lines:
        interface, target, _, flags, _, _, _, mask = line.split()[:8]
        prefix = int(mask, 16).bit_count()
        address = ipaddress.IPv4Address(int.from_bytes(bytes.fromhex(target), "little"))
        subnet = ipaddress.ip_network((address, prefix), strict=False)
        yield Route(interface, subnet, direct=not int(flags, 16) & GATEWAY)


def _addresses(lines: list[str]) -> Iterator[Address]:
    """Read /proc/net/fib_trie: the machine's own addresses are its /32 entries with LOCAL."""
    leaf = ""
    for line in lines:
        words = line.split()
        if words[0] == "|--":
            leaf = words[1]
        elif words == ["/32", "host", "LOCAL"] and not leaf.startswith("127."):
            yield ipaddress.IPv4Address(leaf)


def _addresses6(lines: list[str]) -> Iterator[Address]:
    for line in lines:
        address = ipaddress.IPv6Address(bytes.fromhex(line.split()[0]))
        if not address.is_loopback and not address.is_link_local:
            yield address


def _kernel(lines: list[str]) -> Iterator[tuple[str, bool]]:
    """Read the kernel's configuration: `CONFIG_X=m`, or `# CONFIG_X is not set`."""
    for line in lines:
        name, _, value = line.lstrip("# ").removeprefix("CONFIG_").partition("=")
        if value or name.endswith(" is not set"):
            yield name.split()[0].lower(), value in ("y", "m")
