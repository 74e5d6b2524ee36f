"""`record`: a node that records bags onto a volume that outlives it; record.py does it in its pod.

The option stands for an entry of `nodes` and one of `persistent_storage.volumes`.
"""

# ruff: noqa: RUF009 - option() returns an attrs field, a new one for each use
from __future__ import annotations

import re
from collections.abc import Iterator
from decimal import Decimal
from typing import Any, Literal

import attrs

from rigel_k8s.app.addednode import show_all_topics, take_out
from rigel_k8s.objects.fields import option
from rigel_k8s.objects.podoptions import Placement, Toleration
from rigel_k8s.objects.pods import SCRIPTS_PATH
from rigel_k8s.objects.resources import format_quantity, parse_quantity
from rigel_k8s.objects.scalars import (
    Duration,
    ImageRef,
    MountPath,
    ObjectName,
    Quantity,
    RosName,
    Text,
)
from rigel_k8s.observability.names import EXPORTER, EXPORTER_PORT
from rigel_k8s.problems import Problem
from rigel_k8s.rigelfile.expansion import Expanded, Extension, Surroundings
from rigel_k8s.rigelfile.findings import place
from rigel_k8s.rigelfile.source import YamlNode, lay_over, locate, node_of

KEY, SCRIPT = "record", "record.sh"
#: The key of its node, the name of its volume, and where that is mounted.
NODE, VOLUME, FOLDER = "recorder", ObjectName("bags"), "/persistent/bags"
#: It exists while a bag is being written.
READY = "/tmp/rigel-k8s-recording"
#: To close a large bag, also on a slow disk, and to give it metadata in ROS 2.
GRACE = "60s"
#: What the bag that is being written may take of the limit, which the script guarantees.
LARGEST = Decimal("0.25")
LEAST = Decimal(16 * 2**20)
VOLUMES = ("persistent_storage", "volumes")
#: Before the topics, if only bags around faults are kept.
FAULTS = "--on="
#: What a node runs; one that has any of these is another node than the recorder.
PROGRAM = frozenset({"args", "command", "components", "executable", "launch", "package"})


class Split(Text):
    """When the next bag begins: after a duration, or at a size."""

    kind = "bad-split"
    expects = "a duration such as 5m, or a size such as 500Mi"
    size = re.compile(r"\d+(\.\d+)?([kMGT]|[KMGT]i)")

    @classmethod
    def parse(cls, raw: str) -> Split:
        """Return the value, or raise ValueError with what is expected."""
        try:
            if not cls.size.fullmatch(raw) and Duration.parse(raw).seconds < 1:
                raise ValueError
        except ValueError:
            raise ValueError(f'"{raw}" is not {cls.expects}') from None
        return cls(raw)

    @property
    def word(self) -> str:
        """What the script reads: seconds as 300s, or bytes."""
        if self.size.fullmatch(self):
            return str(int(parse_quantity(self)))
        return f"{round(Duration(self).seconds)}s"


@attrs.frozen(kw_only=True)
class Record:
    """What is recorded into bags, and where they are kept."""

    topics: list[RosName] = option("the topics (default: all)", [])
    on: list[Literal["breach", "crash"]] = option(
        "keep only the bags around faults: a topic is not as `expect` describes it any more, or a"
        " node is down; the exporter sees both. `split` is then a duration, the least that is kept"
        " before and after one (default: all bags are kept)",
        [],
    )
    split: Split | None = option(
        "when the next bag begins: after a duration, or at a size as 500Mi; in any case at a"
        " quarter of `limit` (default: 5m, with `on` 1m)"
    )
    limit: Quantity = option(
        "what all bags together may take: the oldest closed ones are deleted", Quantity("10Gi")
    )
    size: Quantity | None = option("the volume's size (default: a quarter more than `limit`)")
    storage_class: str | None = option("the volume's StorageClass (default: the cluster's default)")
    host_path: MountPath | None = option(
        "a directory of a machine; creates a static volume `bags-pv` on it"
    )
    image: ImageRef | None = option("the recorder's image (default: the job's `image`)")
    placement: Placement = attrs.field(factory=Placement, metadata={"doc": "where it runs"})
    tolerations: list[Toleration] = option("taints it tolerates", [])


def expand(node: YamlNode, _: Surroundings) -> Expanded:
    """Return a job's options with the recorder among `nodes`, and its volume."""
    taken = take_out(node, KEY, Record, check)
    if conflicts := [place(node, problem) for problem in find_conflicts(node)]:
        return Expanded(taken.rest, (*taken.findings, *conflicts))
    record = taken.value
    if record is None:
        return taken.add_node(NODE, {})
    volume = node_of(describe_volume(record), taken.written)
    taken = attrs.evolve(taken, rest=add_volume(taken.rest, volume))
    return taken.add_node(NODE, {**describe(record), **show_all_topics(node)})


def add_volume(node: YamlNode, volume: YamlNode) -> YamlNode:
    """Return a job's options with one more volume."""
    storage = node.value.get(VOLUMES[0])
    there = locate(node, VOLUMES).value if storage is not None else None
    whole = attrs.evolve(volume, value=[*(there if isinstance(there, list) else []), volume])
    over = attrs.evolve(volume, value={VOLUMES[0]: attrs.evolve(volume, value={VOLUMES[1]: whole})})
    return lay_over(node, over)


def find_conflicts(node: YamlNode) -> Iterator[Problem]:
    """Yield names of a job that `record` needs, and that the job has no ROS."""
    if locate(node, ("ros",)).value == "none":
        message = "bags are of ROS, and this job has none: remove `record`"
        yield Problem((KEY,), message, "not-ros", at_key=True)
    path = ("nodes", NODE)
    nodes = locate(node, path[:1]).value if "nodes" in node.value else None
    own = nodes[NODE].value if isinstance(nodes, dict) and NODE in nodes else None
    if isinstance(own, dict) and PROGRAM & own.keys():
        message = f'`record` makes a node "{NODE}": choose another key, or remove `record`'
        yield Problem(path, message, "name-taken", at_key=True)
    volumes = locate(node, VOLUMES).value
    for index, volume in enumerate(volumes if isinstance(volumes, list) else []):
        if isinstance(volume.value, dict) and volume.value.get("name", volume).value == VOLUME:
            message = f'`record` makes a volume "{VOLUME}": choose another name'
            yield Problem((*VOLUMES, index, "name"), message, "name-taken")


def describe(record: Record) -> dict[str, Any]:
    """Return the recorder as a Rigelfile has it; it names its ROS node itself."""
    script = ["/bin/sh", f"{SCRIPTS_PATH}/{SCRIPT}", FOLDER, "run"]
    limit = str(int(parse_quantity(record.limit)))
    split = record.split or Split("1m" if record.on else "5m")
    faults = [f"{FAULTS}{','.join(record.on)}@{EXPORTER}:{EXPORTER_PORT}"] if record.on else []
    return {
        "args": [*script, split.word, limit, *faults, *map(str, record.topics)],
        "anonymous": True,
        "readiness": {"file": READY},
        "volumes": [{"name": str(VOLUME), "mount_path": FOLDER}],
        "termination_grace_period": GRACE,
        "update": {"strategy": "Recreate"},
    }


def describe_volume(record: Record) -> dict[str, Any]:
    """Return the volume of the bags as a Rigelfile has it."""
    whole = parse_quantity(record.limit) * (1 + LARGEST) // 2**20 * 2**20
    made = {"name": str(VOLUME), "size": str(record.size or format_quantity(whole))}
    for key in ("storage_class", "host_path"):
        if getattr(record, key):
            made[key] = str(getattr(record, key))
    return made


def check(record: Record) -> Iterator[Problem]:
    """Yield sizes that do not fit."""
    if record.on and record.split and not record.split.word.endswith("s"):
        message = "a duration is needed with `on`: so much is kept before and after a fault"
        yield Problem(("split",), message, "bad-split")
    limit = parse_quantity(record.limit)
    if limit < LEAST:
        message = f"at least {format_quantity(LEAST)} are needed for some bags"
        yield Problem(("limit",), message, "bad-size")
    if record.size and parse_quantity(record.size) < limit:
        message = f"the volume is smaller than all bags may be (`limit`: {record.limit})"
        yield Problem(("size",), message, "bad-size")


def is_recorder(args: Any) -> bool:
    """Whether a node's arguments are those of the recorder."""
    return isinstance(args, list) and f"{SCRIPTS_PATH}/{SCRIPT}" in args[:2]


def find_faults(args: Any) -> set[str]:
    """Return the faults around which a node with these arguments keeps bags, if it does."""
    found = [word for word in args if word.startswith(FAULTS)] if is_recorder(args) else []
    return set(found[0][len(FAULTS) :].partition("@")[0].split(",")) if found else set()


EXTENSION = Extension.of(
    KEY,
    bool | Record,
    "record bags: one more node, `recorder`, with a volume `bags`; true is the mapping with"
    " its defaults, all topics. An entry `recorder` in `nodes` is merged into it",
    expand,
    default=False,
)
