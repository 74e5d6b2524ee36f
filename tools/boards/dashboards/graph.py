"""The dashboard of the ROS graph: nodes, topics, what flows, the master, diagnostics."""

from __future__ import annotations

from tools.boards.board import APPLICATION, NAMESPACE, ROS_NODE, Board, Row, choice
from tools.boards.panels import Panel, Query, curves, number, states, table
from tools.boards.selectors import APP, NODE, logs_link, to_logs

TOPIC = f'{APP}, topic=~"$topic"'
OFF = "no ROS metrics (ros_metrics is off, or the exporter is down)"
NAMED = "no topic is named under ros_metrics.topics"
ROS1 = "only ROS 1 tells this"
ASKED = "not asked for (ros_metrics.{})"
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
        "Which ROS nodes are up, who publishes and hears what, and what flows.",
        [
            Row("The graph now", [(4, panel) for panel in numbers()], height=4),
            Row("Nodes", [(12, nodes_over_time()), (12, nodes())]),
            Row("Topics", [(12, topics()), (12, unpublished())]),
            Row("What flows on named topics", [(12, panel) for panel in flow()]),
            Row("What ROS 1 nodes count themselves", [(12, panel) for panel in counted()]),
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
            "Nodes that are expected, or were there once, and do not answer.",
            Query(f"sum(1 - {up})", now=True),
            empty=OFF,
            red=1,
        ),
        number(
            "Topics",
            "Topics that somebody publishes or hears; the exporter's own are not counted.",
            Query(f"count(max by ({BY_TOPIC}) (ros_topic_publishers{{{TOPIC}}}))", now=True),
            empty=OFF,
        ),
        number(
            "Heard, published by nobody",
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
            "What nodes say they publish or hear and the master does not know: it was restarted, "
            "or "
            "another node took their names.",
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
        "Green: in the graph and answering. Red: expected or seen before, and not there.",
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
        "Up: it answers. Registered: the master, or discovery, knows it. Missing: topics it says "
        "it has and "
        "the master does not know (ROS 1). No workload: a node that runs elsewhere. Click for "
        "its logs.",
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


def topics() -> Panel:
    """Return each topic with its publishers and subscribers."""
    return table(
        "Topics",
        "Who publishes and who hears, by number; the exporter's own subscriptions are not counted.",
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
    """Return the topics that somebody waits for in vain."""
    return table(
        "Heard, published by nobody",
        "A node is missing, or its topic has another name than its hearers expect (remapping, "
        "namespace).",
        [Query(f"topic:ros_topic_without_publisher:subscribers{{{TOPIC}}}", now=True)],
        columns={
            "topic": "Topic",
            "Value #A": "Subscribers that wait",
            "application": "Application",
            "namespace": "Namespace",
        },
        empty="Every topic that somebody hears has a publisher.",
    )


def flow() -> list[Panel]:
    """Return rate, bandwidth, age and delay of the topics that the exporter listens to."""
    rate = "sum by ({}) (rate(ros_topic_{}_total{{{}}}[$__rate_interval]))"
    last = f"ros_topic_last_message_timestamp_seconds{{{TOPIC}}}"
    return [
        curves(
            "Rate",
            "Messages a second that the exporter received.",
            [Query(rate.format(BY_TOPIC, "messages", TOPIC), "{{topic}}")],
            unit="suffix: msg/s",
            empty=NAMED,
            links=APP_LOGS,
        ),
        curves(
            "Bandwidth",
            "Bytes a second of one subscriber's copy of the messages.",
            [Query(rate.format(BY_TOPIC, "bytes", TOPIC), "{{topic}}")],
            unit="binBps",
            empty=NAMED,
            links=APP_LOGS,
        ),
        curves(
            "Age of the last message",
            "Time since a message came, at each scrape. Up to the topic's period it is well; above "
            "the line of "
            "30 s the alert RosTopicSilent looks whether the topic used to flow.",
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
            "From the stamp in its header to its arrival; wrong where the machines' clocks differ.",
            [Query(f"max by ({BY_TOPIC}) (ros_topic_header_age_seconds{{{TOPIC}}})", "{{topic}}")],
            unit="s",
            empty="no named topic has a header",
            least=None,
            links=APP_LOGS,
        ),
    ]


def counted() -> list[Panel]:
    """Return what ROS 1's nodes tell of their connections: no subscription is needed for it."""
    rate = "sum by ({}) (rate(ros_node_topic_{}_total{{{}, {}}}[$__rate_interval]))"
    chosen = f'{NODE}, topic=~"$topic"'
    by = "namespace, application, ros_node, topic"
    return [
        curves(
            "Messages published",
            "Messages a second by node and topic; one to several subscribers counts once.",
            [
                Query(
                    rate.format(by, "messages", chosen, 'direction="published"'),
                    "{{ros_node}} → {{topic}}",
                )
            ],
            unit="suffix: msg/s",
            empty=ROS1,
            links=NODE_LOGS,
        ),
        curves(
            "Bytes published",
            "Bytes a second by node and topic, once for each subscriber.",
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
    """Return the master's life and what it forgot."""
    restarts = f"increase(ros_master_restarts_total{{{APP}}}[15m])"
    return [
        curves(
            "Restarts in 15 minutes",
            "A master that comes back has forgotten every node, and nothing in ROS 1 tells it "
            "again.",
            [Query(f"sum by (namespace, application) ({restarts})", "{{application}}")],
            unit="none",
            empty=ROS1,
            links=APP_LOGS,
        ),
        curves(
            "Missing registrations",
            "What a node says it publishes or hears and the master does not know.",
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
    """Return what is only there where the Rigelfile asks for it."""
    levels = {
        0: ("ok", "green"),
        1: ("warn", "#EAB839"),
        2: ("error", "red"),
        3: ("stale", "purple"),
    }
    return [
        states(
            "Diagnostics",
            "The levels on /diagnostics, by what reports them.",
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
            "Time since /clock came: a simulation that stands still.",
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
            "Time since each transform came on /tf.",
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
    """Return what looking costs, and what was too much to tell."""
    return [
        curves(
            "One look at the graph takes",
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
            "Not told",
            "Nodes and topics above the exporter's limits (200 nodes, 500 topics): counted here, "
            "and in no "
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
