"""docs/metrics.md: what the ROS exporter measures, and what the rules record."""

from __future__ import annotations

from collections.abc import Iterator

from rigel_exporter.metrics import FAMILIES, LABELS
from tools.reference.meanings import SERIES
from tools.reference.tables import draw_table, join_page, list_code

HEAD = """# Metrics

All metrics of [the ROS exporter](ros-metrics.md), and the series that [our
rules](dashboards.md) record. This page is generated from the code."""

EXPORTER = """Prometheus adds `application`, `namespace`, `pod` and `node` of the exporter's
pod. Names of nodes and topics are full ROS names; `workload` is the Kubernetes workload of a
node of the Rigelfile, and `""` for other nodes. [How to read
them](ros-metrics.md#how-to-read-them) explains more."""

RECORDED = """`application` is the release, `node` the machine. For the CPU of one ROS node,
query `ros_node:container_cpu_usage_seconds:rate2m{ros_node="/talker"}`. For any other metric of
a pod by ROS node, query `METRIC * on (namespace, pod) group_left (application, ros_node)
pod:rigel_identity:info`."""

#: What the end of a metric's name says of its unit, the first that fits.
UNITS = (
    ("_timestamp_seconds", "s since 1970"),
    ("_start_time_seconds", "s since 1970"),
    ("_seconds", "s"),
    ("_seconds_total", "s"),
    ("_bytes", "bytes"),
    ("_bytes_total", "bytes"),
    ("_total", "count"),
    ("_up", "0 or 1"),
    ("_registered", "0 or 1"),
    ("_info", "1"),
    ("_level", "0 to 3"),
)


def write_metrics() -> str:
    """Return the page."""
    return join_page(_list_parts())


def find_unit(name: str) -> str:
    """Return the unit of a metric, by its name as Prometheus' conventions have it."""
    return next((unit for end, unit in UNITS if name.endswith(end)), "count")


def _list_parts() -> Iterator[str]:
    yield HEAD
    yield "## Of the ROS exporter"
    yield EXPORTER
    families = (
        (f"`{name}`", kind, find_unit(name), list_code(LABELS.get(name, ())), meaning)
        for name, (kind, meaning) in FAMILIES.items()
    )
    yield draw_table(("metric", "type", "unit", "labels", "meaning"), families)
    yield "## Recorded series"
    yield RECORDED
    recorded = (
        (f"`{name}`", one.unit, list_code(one.labels), one.meaning) for name, one in SERIES.items()
    )
    yield draw_table(("series", "unit", "labels", "meaning"), recorded)
