"""What clusters change on the machine itself, and how each change is put back.

Several clusters (and Docker) share these settings: the first cluster that needs one records its old
value, the last one that goes restores it. The record is a file, guarded by a lock.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from rigel_k8s.errors import CommandFailed, LocalClusterError
from rigel_k8s.localcluster.addresses import Addresses
from rigel_k8s.localcluster.components import run

__all__ = [
    "BOUND",
    "STATE",
    "acquire",
    "bridge_name",
    "cgroup_create",
    "cgroup_remove",
    "netns_name",
    "network_create",
    "network_remove",
    "release",
    "shared",
    "wire",
]

STATE = Path("/var/lib/rigel-k8s")

#: Settings of the whole machine that a node's kubelet changes, or that nodes need changed.
SYSCTLS = {
    "net/ipv4/ip_forward": "1",
    "fs/inotify/max_user_instances": "8192",
    "fs/inotify/max_user_watches": "524288",
    "vm/overcommit_memory": None,
    "vm/panic_on_oom": None,
    "kernel/panic": None,
    "kernel/panic_on_oops": None,
    "kernel/keys/root_maxkeys": None,
    "kernel/keys/root_maxbytes": None,
}

#: Default paths of a Kubernetes node; each node binds directories of its own over them.
BOUND = (
    "/etc/cni",
    "/opt/cni",
    "/opt/local-path-provisioner",
    "/var/lib/kubelet",
    "/var/lib/containerd",
    "/var/lib/cni",
    "/var/log/pods",
    "/var/log/containers",
)


@contextmanager
def shared() -> Iterator[dict[str, Any]]:
    """Hold the record of what clusters share; it is written back at the end."""
    STATE.mkdir(parents=True, exist_ok=True)
    with (STATE / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        path = STATE / "shared.json"
        record = json.loads(path.read_text()) if path.exists() else {}
        yield record
        path.write_text(json.dumps(record, indent=2))


def acquire(name: str) -> None:
    """Set what nodes need of the machine, and remember what it was."""
    with shared() as record:
        clusters = record.setdefault("clusters", [])
        if not clusters:
            record["sysctls"] = {key: read_sysctl(key) for key in SYSCTLS}
            record["directories"] = make_directories()
        if name not in clusters:
            clusters.append(name)
    for key, value in SYSCTLS.items():
        if value is not None:
            raise_sysctl(key, value)


def release(name: str) -> None:
    """Put the machine's settings back where no other cluster is left."""
    with shared() as record:
        clusters = record.get("clusters", [])
        if name in clusters:
            clusters.remove(name)
        if clusters:
            return
        for key, value in record.pop("sysctls", {}).items():
            if value is not None and read_sysctl(key) != value:
                (Path("/proc/sys") / key).write_text(value)
        for directory in reversed(record.pop("directories", [])):
            with suppress(OSError):
                Path(directory).rmdir()
    remove_state_root()


def remove_state_root() -> None:
    """Remove the state directory where nothing of any cluster is left in it."""
    for name in ("shared.json", "lock"):
        (STATE / name).unlink(missing_ok=True)
    for directory in (STATE / "clusters", STATE):
        with suppress(OSError):
            directory.rmdir()


def read_sysctl(key: str) -> str | None:
    """Return a setting, None where this kernel has it not."""
    with suppress(OSError):
        return (Path("/proc/sys") / key).read_text().strip()
    return None


def raise_sysctl(key: str, value: str) -> None:
    """Set a numeric setting where it is lower."""
    present = read_sysctl(key)
    if present is not None and int(present) < int(value):
        (Path("/proc/sys") / key).write_text(value)


def make_directories() -> list[str]:
    """Make the mount points that the machine lacks; return those made, parents first."""
    made = []
    for path in map(Path, BOUND):
        for directory in [*reversed(path.parents), path]:
            if not directory.exists():
                directory.mkdir()
                made.append(str(directory))
    return made


def short(name: str) -> str:
    """Return six hexadecimal digits for a cluster; interface names have 15 characters at most."""
    return hashlib.sha256(name.encode()).hexdigest()[:6]


def bridge_name(name: str) -> str:
    """Return the name of a cluster's bridge."""
    return f"rk{short(name)}br"


def netns_name(name: str, machine: str) -> str:
    """Return the network namespace of a machine."""
    return f"rigel-{name}-{machine}"


def table_name(name: str) -> str:
    """Return the name of a cluster's nft table."""
    return f"rigel_{name.replace('-', '_')}"


def network_create(name: str, addresses: Addresses) -> None:
    """Make the Ethernet segment of a cluster: a bridge with the host on it, and a way out."""
    bridge = bridge_name(name)
    if not Path("/sys/class/net", bridge).exists():
        run(["ip", "link", "add", bridge, "type", "bridge"])
        address = f"{addresses.machine(1)}/{addresses.machines.prefixlen}"
        run(["ip", "addr", "add", address, "dev", bridge])
        run(["ip", "link", "set", bridge, "up"])
    table = f"table ip {table_name(name)}"
    rules = (
        f"{table} {{}}\ndelete {table}\n{table} {{\n"
        "  chain out { type nat hook postrouting priority srcnat;\n"
        f"    ip saddr {addresses.block} ip daddr != {addresses.block} masquerade\n  }}\n}}\n"
    )
    feed_nft(rules)
    open_forwarding(name, bridge)


def feed_nft(rules: str) -> None:
    """Load rules from text."""
    path = STATE / "rules.nft"
    path.write_text(rules)
    try:
        run(["nft", "-f", str(path)])
    finally:
        path.unlink()


def forward_rules() -> list[dict[str, Any]]:
    """Return the rules of the machine's own FORWARD chain, empty where it drops nothing."""
    try:
        listing = json.loads(run(["nft", "-j", "list", "chain", "ip", "filter", "FORWARD"]))
    except CommandFailed:
        return []
    chains = [item["chain"] for item in listing["nftables"] if "chain" in item]
    if not any(chain.get("policy") == "drop" for chain in chains):
        return []
    return [item["rule"] for item in listing["nftables"] if "rule" in item] or [{}]


def open_forwarding(name: str, bridge: str) -> None:
    """Let the segment's traffic through where the machine (Docker's policy) drops forwarding."""
    rules = forward_rules()
    comment = table_name(name)
    if rules and not any(rule.get("comment") == comment for rule in rules):
        for side in ("iifname", "oifname"):
            feed_nft(f'insert rule ip filter FORWARD {side} "{bridge}" accept comment "{comment}"')


def network_remove(name: str) -> None:
    """Remove a cluster's namespaces, bridge, table and rules; what is not there is no error."""
    for path in sorted(Path("/run/netns").glob(f"{netns_name(name, '')}*")):
        run(["ip", "netns", "del", path.name])
    bridge = bridge_name(name)
    if Path("/sys/class/net", bridge).exists():
        wait_for_links_to_go(name)
        run(["ip", "link", "del", bridge])
    with suppress(CommandFailed):
        run(["nft", "delete", "table", "ip", table_name(name)])
    for rule in forward_rules():
        if rule.get("comment") == table_name(name):
            run(["nft", "delete", "rule", "ip", "filter", "FORWARD", "handle", str(rule["handle"])])


def wait_for_links_to_go(name: str, seconds: float = 10) -> None:
    """Wait until the kernel has removed the host's ends of a deleted namespace's links."""
    deadline = time.monotonic() + seconds
    while links := list(Path("/sys/class/net").glob(f"rk{short(name)}m*")):
        if time.monotonic() > deadline:
            for link in links:
                with suppress(CommandFailed):
                    run(["ip", "link", "del", link.name])
            return
        time.sleep(0.05)


def wire(name: str, machine: str, index: int, addresses: Addresses) -> None:
    """Make a machine's network namespace and plug its eth0 into the segment."""
    namespace = netns_name(name, machine)
    if Path("/run/netns", namespace).exists():
        return
    run(["ip", "netns", "add", namespace])
    link = f"rk{short(name)}m{index}"
    run(["ip", "link", "add", link, "type", "veth", "peer", "name", "eth0", "netns", namespace])
    run(["ip", "link", "set", link, "master", bridge_name(name), "up"])
    inside = ["ip", "-n", namespace]
    address = f"{addresses.machine(index)}/{addresses.machines.prefixlen}"
    run([*inside, "link", "set", "lo", "up"])
    run([*inside, "addr", "add", address, "dev", "eth0"])
    run([*inside, "link", "set", "eth0", "up"])
    run([*inside, "route", "add", "default", "via", addresses.machine(1)])


def cgroup_roots() -> list[Path]:
    """Return where a cgroup of every controller is made: many on v1, one on v2."""
    top = Path("/sys/fs/cgroup")
    if (top / "cgroup.controllers").exists():
        return [top]
    return [p for p in top.iterdir() if p.is_dir() and not p.is_symlink() and p.name != "unified"]


def cgroup_create(name: str, machine: str) -> str:
    """Make a node's cgroup in every controller and return its path from the root.

    Raises:
        LocalClusterError: cgroups are read-only here (an unprivileged container).
    """
    for root in cgroup_roots():
        for path in (root / f"rigel-{name}", root / f"rigel-{name}" / machine):
            try:
                path.mkdir(exist_ok=True)
            except OSError as error:
                raise LocalClusterError(
                    f"cannot make the cgroup {path}: {error.strerror}",
                    hint="it needs writable cgroups; in a container run it privileged",
                ) from error
            prepare_cgroup(root, path)
    return f"/rigel-{name}/{machine}"


def prepare_cgroup(root: Path, path: Path) -> None:
    """Let a new cgroup use what its parent has: cpuset on v1, every controller on v2."""
    if root.name == "cpuset":
        for key in ("cpuset.cpus", "cpuset.mems"):
            (path / key).write_text((path.parent / key).read_text())
    if (path.parent / "cgroup.subtree_control").exists():
        for controller in (path.parent / "cgroup.controllers").read_text().split():
            with suppress(OSError):
                (path.parent / "cgroup.subtree_control").write_text(f"+{controller}")


def cgroup_remove(name: str, seconds: float = 15) -> None:
    """Remove a cluster's cgroups, whose processes have ended."""
    deadline = time.monotonic() + seconds
    roots = [*cgroup_roots(), Path("/sys/fs/cgroup/unified")]
    tops = [root / f"rigel-{name}" for root in roots]
    while left := [top for top in tops if top.exists()]:
        for top in left:
            for path in sorted([p for p in top.rglob("*") if p.is_dir()], reverse=True) + [top]:
                with suppress(OSError):
                    path.rmdir()
        if time.monotonic() > deadline:
            raise LocalClusterError(f"cannot remove cgroup {left[0]}: it has processes still")
        time.sleep(0.05)


def remove_tree(path: Path) -> None:
    """Remove a directory of a cluster; never across a mount."""
    mounts = [line.split()[4] for line in Path("/proc/self/mountinfo").read_text().splitlines()]
    inside = [mount for mount in mounts if Path(mount).is_relative_to(path)]
    if inside:
        raise LocalClusterError(f"{inside[0]} is mounted still", hint=f"umount {inside[0]}")
    shutil.rmtree(path, ignore_errors=True)
