"""The dashboard of log lines, with the metrics that explain them beside them."""

from __future__ import annotations

from grafana_foundation_sdk.builders import dashboard as build
from grafana_foundation_sdk.models.dashboard import VariableOption

from tools.boards.board import ALL, APPLICATION, NAMESPACE, ROS_NODE, Board, Row, Variable
from tools.boards.panels import Panel, Query, curves, lines, table
from tools.boards.selectors import NODE, by_ros_node, graph_link, to_graph

SILENT = "no line in the chosen time and applications"
#: The chosen lines: level "" is a line without a level.
STREAM = f'{{{NODE}, level=~"$level"}}'
SEARCHED = f'{STREAM} |~ "(?i)$search"'
GRAPH = [graph_link("namespace", "application", "ros_node")]
#: For pods without a ROS name.
WHOLE_GRAPH = [graph_link("namespace", "application")]


def board() -> Board:
    """Return the dashboard."""
    return Board(
        "rigel-logs",
        "Logs beside metrics",
        "Log lines by application, ROS node and level, with CPU, memory and topics of the same "
        "nodes.",
        [
            Row("How much is logged", [(12, by_level()), (12, loudest())]),
            Row(
                "Lines",
                [
                    (
                        24,
                        lines(
                            "Lines",
                            "The newest first; click on a line for its labels, and on a label to "
                            "narrow the "
                            "choice. Tracebacks are one entry.",
                            Query(SEARCHED, source="logs"),
                        ),
                    )
                ],
                height=16,
            ),
            Row("The same nodes' metrics", [(8, panel) for panel in metrics()]),
        ],
        [NAMESPACE, APPLICATION, ROS_NODE, level(), search()],
    )


def level() -> Variable:
    """Return the variable of levels."""
    words = ["debug", "info", "warn", "error", "fatal"]
    made = build.CustomVariable("level").label("Level").values(",".join(words))
    return made.multi(True).include_all(True).all_value(".*").current(ALL)


def search() -> Variable:
    """Return the variable with the text to search for."""
    nothing = VariableOption(text="", value="")
    made = build.TextBoxVariable("search").label("Line has (regular expression)")
    return made.default_value("").current(nothing)


def by_level() -> Panel:
    """Return lines over time by level."""
    return curves(
        "Lines a second, by level",
        "From all chosen nodes; lines without a level have no name.",
        [Query(f"sum by (level) (rate({STREAM}[$__auto]))", "{{level}}", source="logs")],
        unit="suffix: lines/s",
        empty=SILENT,
        stacked=True,
    )


def loudest() -> Panel:
    """Return which nodes log most, and which log errors."""
    by = "namespace, application, workload, ros_node, level"
    every = f"sum by ({by}) (count_over_time({STREAM}[$__range]))"
    return table(
        "Lines by node and level",
        "Lines of the shown time by ROS node and level, the most first. Click on a ROS node for "
        "its graph.",
        [Query(every, source="logs", now=True)],
        columns={
            "ros_node": "ROS node",
            "workload": "Workload",
            "level": "Level",
            "Value #A": "Lines",
            "application": "Application",
            "namespace": "Namespace",
        },
        empty=SILENT,
        special={
            "ROS node": {
                "links": [
                    to_graph(
                        namespace='${__data.fields["Namespace"]}',
                        application='${__data.fields["Application"]}',
                        ros_node='${__data.fields["ROS node"]}',
                    ).build()
                ]
            }
        },
        sort="Lines",
    )


def metrics() -> list[Panel]:
    """Return the metrics beside the lines."""
    empty = "no pod of a rigel application in this choice"
    up = f"max by (namespace, application, ros_node) (ros_node_up{{{NODE}}})"
    return [
        curves(
            "CPU",
            "Cores that each ROS node uses, mean of two minutes.",
            by_ros_node("ros_node:container_cpu_usage_seconds:rate2m"),
            unit="suffix: cores",
            empty=empty,
            links=GRAPH,
            special={"B": WHOLE_GRAPH},
        ),
        curves(
            "Memory",
            "The working set, which counts against the container's limit.",
            by_ros_node("ros_node:container_memory_working_set_bytes:sum"),
            unit="bytes",
            empty=empty,
            links=GRAPH,
            special={"B": WHOLE_GRAPH},
        ),
        curves(
            "In the ROS graph",
            "1: the node answers. 0: it does not.",
            [Query(up, "{{ros_node}}")],
            unit="none",
            most=1,
            empty="no ROS metrics (ros_metrics is off)",
            links=GRAPH,
        ),
    ]
