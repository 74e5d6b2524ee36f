"""What each kind of finding in the DDS graph means; docs/errors.md is generated from it."""

from __future__ import annotations

from collections.abc import Mapping

from rigel_k8s.kinds import Kind

GRAPH: Mapping[str, Kind] = {
    "deaf": Kind(
        "multicast from one machine does not arrive at another, or pods of one machine do not hear"
        " each other",
        "check firewalls, Wi-Fi, and IGMP snooping without a querier; without `network`, set it",
    ),
    "deaf-pod": Kind("multicast arrives at the machine, but not in this pod", "delete the pod"),
    "no-interface": Kind(
        "the pod has no net1: Multus was not running when it was created",
        "delete the pod when Multus runs there",
    ),
    "no-address": Kind("net1 has no address", "`kubectl describe pod`; delete the pod"),
    "interface-down": Kind("net1 is down", "`kubectl describe pod`; delete the pod"),
    "other-address": Kind("net1 has another address than planned", "delete the pod"),
    "no-participant": Kind("the program has not started DDS", "read its log"),
    "wrong-domain": Kind(
        "it takes part in another domain",
        "find what sets `ROS_DOMAIN_ID`: the image or the command",
    ),
    "stopped": Kind("its process is stopped by a signal", "send SIGCONT, or delete the pod"),
    "silent": Kind(
        "its participant does not answer: its process hangs, or DDS uses another interface",
        "delete the pod",
    ),
    "undiscovered": Kind(
        "others do not discover it, although multicast passes",
        "check firewalls for UDP; with `peers` the Services",
    ),
    "no-server": Kind("the discovery server does not answer", "check its pod and its Service"),
    "no-router": Kind(
        "there is no connection to a zenoh router", "check the router's pod and its Service"
    ),
    "not-looked": Kind("the pod could not be examined", "the message has the reason"),
}
