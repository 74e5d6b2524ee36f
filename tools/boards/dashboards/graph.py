"""The dashboard of the ROS graph: nodes, topics, what flows, the master, diagnostics."""

from __future__ import annotations

from tools.boards.board import APPLICATION, NAMESPACE, ROS_NODE, Board, Row, choice
from tools.boards.panels import Panel, Query, curves, number, states, table
from tools.boards.selectors import APP, NODE, logs_link, to_logs

TOPIC = f'{APP}, topic=~"$topic"'
OFF = "no ROS metrics (ros_metrics is off, or the exporter is down)"
NAMED = "no topic is named under ros_metrics.topics"
ROS1 = "only available in ROS 1"
ASKED = "not enabled (ros_metrics.{})"
BY_NODE = "namespace, application, workload, ros_node"
BY_TOPIC = "namespace, application, topic"
NODE_LOGS = [logs_link("namespace", "application", "ros_node")]
APP_LOGS = [logs_link("namespace", "application")]


def board() -> Board:
    """Return the dashboard."""
    topic = choice("topic", "Topic", f"label_values(ros_topic_publishers{{{APP}}}, topic)", ".*")
    return Board(
        "rigel-ros-graph",
        "ROS graph and topics",
        "Which ROS nodes are up, their publishers and subscribers, and how much is sent.",
        [
            Row("The graph now", [(4, panel) for panel in numbers()], height=4),
            Row("Nodes", [(12, nodes_over_time()), (12, nodes())]),
            Row("Topics", [(12, topics()), (12, unpublished())]),
            Row("Topics as expected", [(24, expected())], height=6),
            Row("Traffic of named topics", [(12, panel) for panel in flow()]),
            Row("Traffic that nodes count", [(12, panel) for panel in counted()]),
            Row("The ROS 1 master", [(12, panel) for panel in master()]),
            Row("Diagnostics, clock and tf", [(8, panel) for panel in on_request()]),
            Row("The exporter", [(12, panel) for panel in exporter()], height=6),
        ],
        [NAMESPACE, APPLICATION, ROS_NODE, topic],
    )


def numbers() -> list[Panel]:
    """Return the numbers at the top."""
    up = f"max by ({BY_NODE}) (ros_node_up{{{NODE}}})"
    return [
        number(
            "Nodes up",
            "Nodes that are in the graph and answer.",
            Query(f"sum({up})", now=True),
            empty=OFF,
        ),
        number(
            "Nodes gone",
            "Nodes that are expected, or were seen before, and do not answer.",
            Query(f"sum(1 - {up})", now=True),
            empty=OFF,
            red=1,
        ),
        number(
            "Topics",
            "Topics with a publisher or a subscriber; the exporter's own are not counted.",
            Query(f"count(max by ({BY_TOPIC}) (ros_topic_publishers{{{TOPIC}}}))", now=True),
            empty=OFF,
        ),
        number(
            "Topics without a publisher",
            "Topics with a subscriber and no publisher: a node is missing, or a name is wrong.",
            Query(
                f"count(topic:ros_topic_without_publisher:subscribers{{{TOPIC}}}) or "
                f"0 * count(ros_topic_publishers{{{TOPIC}}})",
                now=True,
            ),
            empty=OFF,
            yellow=1,
        ),
        number(
            "Missing registrations",
            "Publishers and subscribers of nodes that are not registered at the master: it "
            "restarted, or another node took their names.",
            Query(f"sum(max by ({BY_NODE}) (ros_node_missing_registrations{{{NODE}}}))", now=True),
            empty=ROS1,
            red=1,
        ),
        number(
            "Master up for",
            "Time since the ROS 1 master's process was first seen.",
            Query(f"time() - max(ros_master_start_time_seconds{{{APP}}})", now=True),
            unit="dtdurations",
            empty=ROS1,
        ),
    ]


def nodes_over_time() -> Panel:
    """Return when each node was up."""
    return states(
        "Nodes over time",
        "Green: in the graph, and it answers. Red: expected or seen before, but missing.",
        [Query(f"max by ({BY_NODE}) (ros_node_up{{{NODE}}})", "{{ros_node}}")],
        names={0: ("gone", "red"), 1: ("up", "green")},
        empty=OFF,
        links=NODE_LOGS,
    )


def nodes() -> Panel:
    """Return each node as it is now."""
    here = to_logs(
        namespace='${__data.fields["Namespace"]}',
        application='${__data.fields["Application"]}',
        ros_node='${__data.fields["ROS node"]}',
    )
    metrics = ("ros_node_up", "ros_node_registered", "ros_node_missing_registrations")
    return table(
        "Nodes",
        "Up: it answers. Registered: it is registered at the master, or discovered. Missing: its "
        "topics that are not registered at the master (ROS 1). No workload: it runs elsewhere. "
        "Click on it for its logs.",
        [Query(f"max by ({BY_NODE}) ({name}{{{NODE}}})", now=True) for name in metrics],
        columns={
            "ros_node": "ROS node",
            "workload": "Workload",
            "Value #A": "Up",
            "Value #B": "Registered",
            "Value #C": "Missing",
            "application": "Application",
            "namespace": "Namespace",
        },
        empty=OFF,
        special={"ROS node": {"links": [here.build()]}},
        sort="Missing",
    )


def expected() -> Panel:
    """Return when each topic was as expected."""
    return states(
        "Topics as expected",
        "What `expect` in the Rigelfile describes. Green: it is so. Red: it is not.",
        [
            Query(
                f"min by ({BY_TOPIC}, expectation) (ros_topic_as_expected{{{TOPIC}}})",
                "{{topic}} {{expectation}}",
            )
        ],
        names={0: ("broken", "red"), 1: ("as expected", "green")},
        empty="the Rigelfile expects nothing of topics, or ros_metrics is off",
        links=APP_LOGS,
    )


def topics() -> Panel:
    """Return each topic with its publishers and subscribers."""
    return table(
        "Topics",
        "The number of publishers and subscribers, without the exporter's own subscriptions.",
        [
            Query(f"max by ({BY_TOPIC}, type) (ros_topic_{what}{{{TOPIC}}})", now=True)
            for what in ("publishers", "subscribers")
        ],
        columns={
            "topic": "Topic",
            "type": "Type",
            "Value #A": "Publishers",
            "Value #B": "Subscribers",
            "application": "Application",
            "namespace": "Namespace",
        },
        empty=OFF,
    )


def unpublished() -> Panel:
    """Return the topics with subscribers and without publishers."""
    return table(
        "Topics without a publisher",
        "A node is missing, or its topic has another name than its subscribers use (remapping, "
        "namespace).",
        [Query(f"topic:ros_topic_without_publisher:subscribers{{{TOPIC}}}", now=True)],
        columns={
            "topic": "Topic",
            "Value #A": "Subscribers that wait",
            "application": "Application",
            "namespace": "Namespace",
        },
        empty="Every topic with subscribers has a publisher.",
    )


def flow() -> list[Panel]:
    """Return rate, bandwidth, age and delay of the topics that the exporter subscribes to."""
    rate = "sum by ({}) (rate(ros_topic_{}_total{{{}}}[$__rate_interval]))"
    last = f"ros_topic_last_message_timestamp_seconds{{{TOPIC}}}"
    return [
        curves(
            "Rate",
            "Messages per second; in ROS 2 as the nodes that publish count them.",
            [Query(rate.format(BY_TOPIC, "messages", TOPIC), "{{topic}}")],
            unit="suffix: msg/s",
            empty=NAMED,
            links=APP_LOGS,
        ),
        curves(
            "Bandwidth",
            "Bytes per second of one subscriber's copy of the messages.",
            [Query(rate.format(BY_TOPIC, "bytes", TOPIC), "{{topic}}")],
            unit="binBps",
            empty=f"{ROS1}, for topics named under ros_metrics.topics",
            links=APP_LOGS,
        ),
        curves(
            "Age of the last message",
            "Time since the last message, at each scrape. Up to the topic's period it is normal; "
            "above the line at 30 s, the alert RosTopicSilent fires if the topic had messages "
            "before.",
            [
                Query(
                    f"min by ({BY_TOPIC}) (timestamp({last}) - {last})",
                    "{{topic}}",
                )
            ],
            unit="s",
            empty=NAMED,
            red=30,
            links=APP_LOGS,
        ),
        curves(
            "Delay of the last message",
            "From the stamp in its header to its arrival; wrong if the machines' clocks differ.",
            [Query(f"max by ({BY_TOPIC}) (ros_topic_header_age_seconds{{{TOPIC}}})", "{{topic}}")],
            unit="s",
            empty="no named topic has a header",
            least=None,
            links=APP_LOGS,
        ),
    ]


def counted() -> list[Panel]:
    """Return what nodes report of what they send; this needs no subscription."""
    rate = "sum by ({}) (rate(ros_node_topic_{}_total{{{}, {}}}[$__rate_interval]))"
    chosen = f'{NODE}, topic=~"$topic"'
    by = "namespace, application, ros_node, topic"
    return [
        curves(
            "Messages published",
            "Messages per second by node and topic; one to several subscribers counts once.",
            [
                Query(
                    rate.format(by, "messages", chosen, 'direction="published"'),
                    "{{ros_node}} → {{topic}}",
                )
            ],
            unit="suffix: msg/s",
            empty=OFF,
            links=NODE_LOGS,
        ),
        curves(
            "Bytes published",
            "Bytes per second by node and topic, once for each subscriber.",
            [
                Query(
                    rate.format(by, "bytes", chosen, 'direction="published"'),
                    "{{ros_node}} → {{topic}}",
                )
            ],
            unit="binBps",
            empty=ROS1,
            links=NODE_LOGS,
        ),
    ]


def master() -> list[Panel]:
    """Return the master's restarts and the registrations that it lost."""
    restarts = f"increase(ros_master_restarts_total{{{APP}}}[15m])"
    return [
        curves(
            "Restarts in 15 minutes",
            "A restarted master has no registrations, and nothing in ROS 1 registers the nodes "
            "again.",
            [Query(f"sum by (namespace, application) ({restarts})", "{{application}}")],
            unit="none",
            empty=ROS1,
            links=APP_LOGS,
        ),
        curves(
            "Missing registrations",
            "Publishers and subscribers of a node that are not registered at the master.",
            [
                Query(
                    f"max by ({BY_NODE}) (ros_node_missing_registrations{{{NODE}}})", "{{ros_node}}"
                )
            ],
            unit="none",
            empty=ROS1,
            red=1,
            links=NODE_LOGS,
        ),
    ]


def on_request() -> list[Panel]:
    """Return what is only measured if the Rigelfile enables it."""
    levels = {
        0: ("ok", "green"),
        1: ("warn", "#EAB839"),
        2: ("error", "red"),
        3: ("stale", "purple"),
    }
    return [
        states(
            "Diagnostics",
            "The levels on /diagnostics, by their source.",
            [
                Query(
                    f"max by (namespace, application, name) (ros_diagnostics_level{{{APP}}})",
                    "{{name}}",
                )
            ],
            names=levels,
            empty=ASKED.format("diagnostics"),
            links=APP_LOGS,
        ),
        curves(
            "Age of the clock",
            "Time since the last message on /clock; it grows when a simulation stands still.",
            [
                Query(
                    f"max by (namespace, application) (ros_clock_age_seconds{{{APP}}})",
                    "{{application}}",
                )
            ],
            unit="s",
            empty=ASKED.format("clock"),
            links=APP_LOGS,
        ),
        curves(
            "Age of transforms",
            "Time since the last message of each transform on /tf.",
            [
                Query(
                    f"max by (namespace, application, parent, child) (ros_tf_age_seconds{{{APP}}})",
                    "{{parent}} → {{child}}",
                )
            ],
            unit="s",
            empty=ASKED.format("tf"),
            links=APP_LOGS,
        ),
    ]


def exporter() -> list[Panel]:
    """Return what the exporter costs, and what is above its limits."""
    return [
        curves(
            "Duration of one look at the graph",
            "Seconds that the exporter needs to ask the master and all nodes, or to read "
            "discovery.",
            [
                Query(
                    f"max by (namespace, application) (ros_exporter_collect_seconds{{{APP}}})",
                    "{{application}}",
                )
            ],
            unit="s",
            empty=OFF,
            links=APP_LOGS,
        ),
        curves(
            "Above the limits",
            "Nodes and topics above the exporter's limits (200 nodes, 500 topics); they are in no "
            "other panel.",
            [
                Query(
                    f"max by (namespace, application, what) (ros_exporter_dropped{{{APP}}})",
                    "{{application}} {{what}}",
                )
            ],
            unit="none",
            empty=OFF,
            links=APP_LOGS,
        ),
    ]
