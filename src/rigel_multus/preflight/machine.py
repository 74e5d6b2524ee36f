"""One machine: the Multus daemon in which a script examines it, and what the script finds.

The script is PROBE: POSIX shell that runs inside the daemon's container, so it uses only builtins,
cat, and readlink where there is one. It changes nothing.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Iterator, Mapping
from typing import Any, TypeAlias

import attrs

from rigel_k8s.objects.facts import is_ready
from rigel_multus.installation import IMAGES, is_image

Manifest = Mapping[str, Any]
Address: TypeAlias = ipaddress.IPv4Address | ipaddress.IPv6Address
Subnet: TypeAlias = ipaddress.IPv4Network | ipaddress.IPv6Network

UP = 0x1  # IFF_UP
#: Where CNI programs are on machines of a usual kind.
USUAL = "/opt/cni/bin"

#: $1: where the machine's root directory is mounted, "" for nowhere; then CNI program directories.
PROBE = r"""
root=$1; shift
echo @links
for d in /sys/class/net/*; do
  [ -e "$d/flags" ] || continue
  w=-
  # It is deleted when its pod ends.
  { read -r f <"$d/flags" && read -r m <"$d/mtu"; } 2>/dev/null || continue
  if [ -e "$d/wireless" ] || [ -e "$d/phy80211" ]; then w=wireless; fi
  while read -r a; do if [ "$a" = DEVTYPE=wlan ]; then w=wireless; fi; done \
    2>/dev/null <"$d/uevent"
  echo "${d##*/} $f $m $w"
done
echo @routes; cat /proc/net/route
echo @addresses; cat /proc/net/fib_trie
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
echo @end
"""


@attrs.frozen
class Daemon:
    """A pod of Multus, in which a script can examine its machine.

    Attributes:
        state: why it is not ready, "" if it is.
        root: where the machine's root directory is mounted, "" if it is not.
        directories: where in the container the machine's CNI programs are.
    """

    node: str
    namespace: str
    pod: str
    container: str
    state: str = ""
    root: str = ""
    directories: tuple[str, ...] = ()


@attrs.frozen
class Interface:
    """A network interface of a machine.

    Attributes:
        up: whether it is switched on.
    """

    name: str
    up: bool = True
    mtu: int = 1500
    wireless: bool = False


@attrs.frozen
class MachineFacts:
    """The facts about one machine.

    Attributes:
        default_interface: that of the default route, which macvlan uses if none is named.
        programs: directory -> its CNI programs; empty if no directory could be read.
    """

    interfaces: Mapping[str, Interface]
    default_interface: str | None = None
    addresses: frozenset[Address] = frozenset()
    programs: Mapping[str, frozenset[str]] = attrs.field(factory=dict)


def read_daemon(pod: Manifest) -> Daemon:
    """Return the facts about a pod of Multus that are needed to examine its machine."""
    spec, meta = pod["spec"], pod["metadata"]
    running = (c for c in spec["containers"] if is_image(c.get("image", ""), IMAGES["multus"]))
    container = next(running, spec["containers"][0])
    paths = {
        volume["name"]: volume["hostPath"]["path"]
        for volume in spec.get("volumes") or []
        if "hostPath" in volume
    }
    mounts = {
        paths[m["name"]]: m["mountPath"]
        for m in container.get("volumeMounts") or []
        if m["name"] in paths and not m.get("subPath")
    }
    root = mounts.get("/", "")
    return Daemon(
        node=spec.get("nodeName", ""),
        namespace=meta["namespace"],
        pod=meta["name"],
        container=container["name"],
        state=explain_state(pod),
        root=root,
        directories=tuple(list_directories(spec, mounts, root)),
    )


def list_directories(spec: Manifest, mounts: Mapping[str, str], root: str) -> Iterator[str]:
    """Yield the directories of the machine's CNI programs: our own pods' variable, or the mounts.

    If two paths lead to one directory, that below the machine's root is used: links resolve there.
    """
    variables = [v for c in spec["containers"] for v in c.get("env") or []]
    known = [v["value"] for v in variables if v["name"] == "BIN_DIR" and v.get("value")]
    mounted = [path for path in mounts if path.rstrip("/").endswith(("/bin", "/data/cni"))]
    for path in known or mounted or [USUAL]:
        if root:
            yield root.rstrip("/") + path
        elif path in mounts:
            yield mounts[path]


def explain_state(pod: Manifest) -> str:
    """Return why a pod is not ready, "" if it is."""
    if is_ready(pod):
        return ""
    status = pod.get("status") or {}
    for key in ("initContainerStatuses", "containerStatuses"):
        for one in status.get(key) or []:
            waiting = (one.get("state") or {}).get("waiting") or {}
            if waiting.get("reason"):
                return str(waiting["reason"])
    return str(status.get("phase") or "not ready")


def parse(text: str) -> MachineFacts:
    """Return the facts in the script's output.

    Raises:
        ValueError: the text is not the script's whole output.
    """
    sections: dict[str, list[str]] = {}
    lines: list[str] = []
    for line in text.splitlines():
        if line.startswith("@"):
            lines = sections.setdefault(line[1:], [])
        elif line.strip():
            lines.append(line)
    if "end" not in sections:
        raise ValueError("the output of the script on the machine is incomplete")
    interfaces = {}
    for line in sections["links"]:
        name, flags, mtu, wireless = line.split()
        up = bool(int(flags, 16) & UP)
        interfaces[name] = Interface(name, up, int(mtu), wireless == "wireless")
    routes = [line.split() for line in sections["routes"]]  # interface, target, ..., mask
    defaults = [words[0] for words in routes if words[1] == words[7] == "00000000"]
    programs = {
        name.partition(" ")[2]: frozenset(lines)
        for name, lines in sections.items()
        if name.startswith("programs ")
    }
    return MachineFacts(
        interfaces,
        defaults[0] if defaults else None,
        frozenset(parse_addresses(sections["addresses"])),
        programs,
    )


def parse_addresses(lines: list[str]) -> Iterator[Address]:
    """Read /proc/net/fib_trie: the machine's own addresses are its /32 entries with LOCAL."""
    leaf = ""
    for line in lines:
        words = line.split()
        if words[0] == "|--":
            leaf = words[1]
        elif words == ["/32", "host", "LOCAL"] and not leaf.startswith("127."):
            yield ipaddress.IPv4Address(leaf)
