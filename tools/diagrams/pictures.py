"""What the diagrams of the documentation show."""

from __future__ import annotations

from tools.diagrams.scene import Arrow, Box, Frame, Scene
from tools.diagrams.sequence import Message, Note, Sequence

ROS1 = Scene(
    "ROS 1 on Kubernetes: each node is a pod; a gate is in front of roscore",
    860,
    330,
    (
        Frame(10, 10, 400, 200, "machine 1"),
        Frame(450, 10, 400, 200, "machine 2"),
        Box(30, 60, 160, 70, "talker", ("pod", "ROS node /talker")),
        Box(670, 60, 160, 70, "listener", ("pod", "ROS node /listener")),
        Frame(215, 45, 180, 150, "pod ros-master"),
        Box(230, 75, 150, 46, "gate", ("port 11311",)),
        Box(230, 138, 150, 46, "roscore", ("loopback only",)),
        Arrow((305, 121), (305, 138)),
        Arrow((190, 90), (230, 95)),
        Arrow((670, 82), (380, 92), "registers", (525, 78)),
        Arrow((110, 130), (110, 262), "", (0, 0)),
        Arrow((750, 262), (750, 130)),
        Box(30, 262, 800, 52, "messages", ("from pod to pod, without roscore or gate",), "good"),
    ),
)

CLUSTER = Scene(
    "What rigel puts on a cluster, and what it does not",
    860,
    350,
    (
        Box(10, 20, 150, 64, "Rigelfile", ("on your computer",)),
        Box(10, 130, 150, 64, "rigel", ("runs, and ends",)),
        Arrow((85, 84), (85, 130)),
        Frame(230, 10, 620, 265, "one namespace of your cluster"),
        Arrow((160, 162), (230, 162), "API", (195, 152)),
        Box(250, 50, 180, 64, "your nodes", ("a Deployment each,", "from your images")),
        Box(450, 50, 180, 64, "ros-master", ("ROS 1: roscore and", "a gate before it")),
        Box(650, 50, 180, 64, "Services, servers", ("ROS 2, where the network", "mode needs them")),
        Box(250, 150, 180, 64, "ConfigMaps", ("scripts and", "parameters of nodes")),
        Box(450, 150, 180, 64, "Secrets", ("one for each revision,", "to roll back to")),
        Box(650, 150, 180, 64, "claims", ("only if the Rigelfile", "has volumes")),
        Arrow((340, 150), (340, 114)),
        Box(250, 230, 580, 34, "no server part, no database, no custom resource", (), "good"),
        Box(10, 295, 410, 40, "rigel down deletes it; volumes stay", (), "note"),
        Box(440, 295, 410, 40, "rigel down --volumes deletes data, too", (), "note"),
    ),
)

NETWORKS = Scene(
    "How discovery reaches another machine, by network mode",
    860,
    420,
    (
        Box(10, 20, 150, 80, "none", ("the pod network", "carries no multicast")),
        Frame(190, 10, 310, 100, "machine 1"),
        Frame(540, 10, 310, 100, "machine 2"),
        Box(280, 38, 130, 46, "talker", ()),
        Box(630, 38, 130, 46, "listener", ()),
        Arrow((410, 61), (498, 61), "multicast ends here", (430, 102), "bad"),
        Box(10, 150, 150, 80, "peers", ("a Service each", "any cluster")),
        Frame(190, 140, 310, 100, "machine 1"),
        Frame(540, 140, 310, 100, "machine 2"),
        Box(280, 168, 130, 46, "talker", ()),
        Box(630, 168, 130, 46, "listener", ()),
        Arrow((410, 191), (630, 191), "to addresses, by unicast", (520, 182)),
        Box(10, 290, 150, 80, "macvlan", ("a second interface", "on the Ethernet")),
        Frame(190, 270, 310, 100, "machine 1"),
        Frame(540, 270, 310, 100, "machine 2"),
        Box(280, 295, 130, 46, "talker", ("net1",)),
        Box(630, 295, 130, 46, "listener", ("net1",)),
        Box(190, 385, 660, 28, "the machines' Ethernet carries multicast", (), "good"),
        Arrow((345, 341), (345, 385)),
        Arrow((695, 385), (695, 341)),
    ),
)

DEPLOY = Scene(
    "The steps of a deploy",
    860,
    190,
    (
        Box(10, 20, 120, 64, "look", ("what exists,", "dry runs")),
        Box(155, 20, 120, 64, "refuse", ("all reasons", "at once")),
        Box(300, 20, 120, 64, "apply", ("roscore first,", "then nodes")),
        Box(445, 20, 120, 64, "wait", ("until nodes", "answer")),
        Box(590, 20, 120, 64, "compare", ("the ROS graph", "before and after")),
        Box(735, 20, 115, 64, "good", ("a revision to", "return to"), "good"),
        *(Arrow((x, 52), (x + 25, 52)) for x in (130, 275, 420, 565, 710)),
        Frame(10, 100, 265, 78, "rigel diff ends here"),
        Box(24, 128, 237, 40, "nothing is written", (), "note"),
        Frame(300, 100, 550, 78, "a pending revision records what each write may leave"),
        Box(314, 128, 522, 40, "interrupted at any moment: run it again", (), "note"),
    ),
)

EXPECTATIONS = Scene(
    "Who acts when a topic is not as you expect it",
    860,
    200,
    (
        Box(10, 20, 190, 64, "a new version", ("waits, and is measured",)),
        Arrow((200, 52), (230, 52)),
        Box(230, 20, 190, 64, "takes over", ("once it is fast enough",)),
        Arrow((420, 52), (450, 52)),
        Box(450, 20, 190, 64, "the first minute", ("is compared with before",)),
        Arrow((640, 52), (670, 52)),
        Box(670, 20, 180, 64, "works", ("and is compared on",), "good"),
        Arrow((105, 84), (105, 124), "", (0, 0), "bad"),
        Box(10, 124, 190, 64, "too slow", ("the old one works on",), "note"),
        Arrow((545, 84), (545, 124), "", (0, 0), "bad"),
        Box(450, 124, 190, 64, "worse", ("rolled back, or reported",), "note"),
        Arrow((760, 84), (760, 124), "", (0, 0), "bad"),
        Box(670, 124, 180, 64, "silent, broken", ("restarted, an alert",), "note"),
    ),
)

HAND_OVER_ROS1 = Sequence(
    "Hand-over of a ROS 1 node's name",
    ("listener", "old talker", "gate", "roscore", "new talker"),
    (
        Message("old talker", "listener", "messages"),
        Note("new talker", "starts: imports, models, parameters"),
        Message("new talker", "gate", "registerPublisher /chatter"),
        Message("gate", "new talker", "registered (kept, not passed on)", dashed=True),
        Note("new talker", 'ready: "/talker waits to take over"'),
        Message("old talker", "listener", "messages"),
        Note("old talker", "Kubernetes ends the pod: preStop"),
        Message("old talker", "gate", "hand over"),
        Message("gate", "old talker", "shutdown"),
        Message("old talker", "gate", "no publishers left", dashed=True),
        Message("gate", "roscore", "registers the new talker"),
        Message("roscore", "listener", "publisherUpdate: the new talker"),
        Message("new talker", "listener", "messages"),
    ),
)

HAND_OVER_ROS2 = Sequence(
    "Hand-over of a ROS 2 node",
    ("others", "old node", "its keeper", "new one's keeper", "new node"),
    (
        Message("old node", "others", "messages"),
        Message("new one's keeper", "its keeper", "who works? it waits"),
        Note("new node", "runs, is discovered, says and hears nothing yet"),
        Message("new one's keeper", "its keeper", "it is fit: its partners are there"),
        Message("its keeper", "old node", "finish your goals"),
        Message("new one's keeper", "new node", "hold: leave all in the queues"),
        Message("its keeper", "old node", "take nothing more, finish, stop"),
        Message("its keeper", "new one's keeper", "what it has taken", dashed=True),
        Message("new one's keeper", "new node", "leave that out, and work"),
        Message("new node", "others", "messages"),
        Note("old node", "Kubernetes ends its pod: SIGINT"),
    ),
)

#: By the name of the file in docs/pictures/.
PICTURES: dict[str, Scene | Sequence] = {
    "cluster": CLUSTER,
    "deploy": DEPLOY,
    "expectations": EXPECTATIONS,
    "hand-over-ros1": HAND_OVER_ROS1,
    "hand-over-ros2": HAND_OVER_ROS2,
    "networks": NETWORKS,
    "ros1": ROS1,
}
