"""What all clusters of this machine share, and how it is restored.

The first cluster records the machine's state, the last one restores it when it ends; the others do
not. What was recorded in an earlier boot is no longer true and is forgotten.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

import attrs

from rigel_k8s.system.cache import locked
from rigel_lab.cluster import paths
from rigel_lab.cluster.commands import Report, run, succeeds
from rigel_lab.cluster.paths import boot_id

PROC_SYS = Path("/proc/sys")
NETNS = Path("/run/netns")
FORWARDING = "net/ipv4/ip_forward"
NEIGHBOURS = "net/ipv4/neigh/default"

#: Settings of the whole machine that nodes need at least that high (None: one that a kubelet
#: changes). They are restored in this order: ip_forward changes accept_redirects with it.
SYSCTLS = {
    FORWARDING: "1",
    "net/ipv4/conf/all/accept_redirects": None,
    "fs/inotify/max_user_instances": "8192",
    "fs/inotify/max_user_watches": "524288",
    # The kernel has one table for all namespaces. 50 pods of a second network that all exchange
    # packets overflowed its usual 1024 entries, and this machine could reach no new neighbour.
    f"{NEIGHBOURS}/gc_thresh1": "1024",
    f"{NEIGHBOURS}/gc_thresh2": "8192",
    f"{NEIGHBOURS}/gc_thresh3": "16384",
    "vm/overcommit_memory": None,
    "vm/panic_on_oom": None,
    "kernel/panic": None,
    "kernel/panic_on_oops": None,
    "kernel/keys/root_maxkeys": None,
    "kernel/keys/root_maxbytes": None,
}


@attrs.define
class Record:
    """What clusters share, and the machine's state before the first of them.

    Attributes:
        clusters: those that need it now.
        sysctls: settings as they were.
        bridges: the machine's own bridges as they were.
        directories: those made as mount points, parents first.
        netns_mounted: whether /run/netns was a mount (`ip netns add` makes it one).
    """

    boot: str = attrs.field(factory=lambda: boot_id())
    clusters: list[str] = attrs.field(factory=list)
    sysctls: dict[str, str] = attrs.field(factory=dict)
    bridges: list[str] = attrs.field(factory=list)
    directories: list[str] = attrs.field(factory=list)
    netns_mounted: bool = True


@contextmanager
def exclusive() -> Iterator[None]:
    """Keep every other rigel process from what clusters share."""
    with locked(paths.LOCKS / "shared.lock"):
        yield


@contextmanager
def changing() -> Iterator[Record]:
    """Hold the record; it is written back at the end, or removed if no cluster is left."""
    path = paths.STATE / "shared.json"
    with exclusive():
        record = read(path)
        yield record
        if record.clusters:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(attrs.asdict(record), indent=2))
        else:
            path.unlink(missing_ok=True)
            for directory in (paths.STATE / "clusters", paths.STATE):
                with suppress(OSError):
                    directory.rmdir()


def read(path: Path) -> Record:
    """Return the record; of one of an earlier boot only the directories are still true."""
    if not path.exists():
        return Record()
    record = Record(**json.loads(path.read_text()))
    return record if record.boot == boot_id() else Record(directories=record.directories)


def acquire(name: str, mount_points: Iterable[str]) -> None:
    """Set what nodes need of the machine, and record what it was.

    Args:
        name: the cluster that needs it.
        mount_points: paths that its nodes will have.
    """
    with changing() as record:
        remember(record)
        record.directories += make_directories(map(Path, mount_points))
        if name not in record.clusters:
            record.clusters.append(name)
    for key, value in SYSCTLS.items():
        if value is not None:
            raise_sysctl(key, value)


def remember(record: Record) -> None:
    """Note the machine's state before the first cluster, or what an older rigel left out."""
    values = {key: read_sysctl(key) for key in SYSCTLS}
    present = {key: value for key, value in values.items() if value is not None}
    record.sysctls = present | record.sysctls
    if record.clusters:
        return
    record.bridges = bridges()
    record.netns_mounted = is_mount(NETNS)


def release(name: str, report: Report, needed: Collection[str] = ()) -> None:
    """Restore the machine's settings if no other cluster is left.

    Args:
        name: the cluster that has ended.
        report: called with each line of output.
        needed: the mount points of other clusters, which stay.
    """
    with changing() as record:
        if name in record.clusters:
            record.clusters.remove(name)
        record.directories = remove_directories(record.directories, needed)
        if record.clusters:
            return
        restore_sysctls(record, report)
        if not record.netns_mounted:
            release_netns()


def restore_sysctls(record: Record, report: Report) -> None:
    """Write back what differs, but leave forwarding on if a later program may need it."""
    values = dict(record.sysctls)
    others = sorted(set(bridges()) - set(record.bridges))
    if others and values.get(FORWARDING) == "0":
        del values[FORWARDING]
        report(f"Leaving net.ipv4.ip_forward on: {', '.join(others)} came later and may need it")
    for key, value in values.items():
        if read_sysctl(key) != value:
            (PROC_SYS / key).write_text(value)


def bridges() -> list[str]:
    """Return the machine's bridges."""
    links = json.loads(run(["ip", "-j", "link", "show", "type", "bridge"]) or "[]")
    return sorted(link["ifname"] for link in links if "ifname" in link)


def read_sysctl(key: str) -> str | None:
    """Return a setting, None if this kernel does not have it."""
    with suppress(OSError):
        return (PROC_SYS / key).read_text().strip()
    return None


def raise_sysctl(key: str, value: str) -> None:
    """Set a numeric setting if it is lower."""
    present = read_sysctl(key)
    if present is not None and int(present) < int(value):
        (PROC_SYS / key).write_text(value)


def make_directories(wanted: Iterable[Path]) -> list[str]:
    """Make the missing mount points of the machine; return those made, parents first."""
    made = []
    for path in wanted:
        for directory in [*reversed(path.parents), path]:
            if not directory.exists():
                directory.mkdir()
                made.append(str(directory))
    return made


def remove_directories(made: Sequence[str], needed: Collection[str]) -> list[str]:
    """Remove the mount points that are no longer needed; return those that stay."""
    kept = [path for path in made if any(Path(n).is_relative_to(path) for n in needed)]
    for path in reversed(made):
        if path not in kept:
            with suppress(OSError):  # another program has put something there
                Path(path).rmdir()
    return kept


def is_mount(path: Path) -> bool:
    """Return whether something is mounted on a path; also if both are one file system."""
    return path.exists() and succeeds(["mountpoint", "-q", str(path)])


def release_netns() -> None:
    """Undo what `ip netns add` did to /run/netns, if no namespace is in it."""
    if NETNS.exists() and not any(NETNS.iterdir()):
        while is_mount(NETNS):
            run(["umount", str(NETNS)])
        with suppress(OSError):
            NETNS.rmdir()
