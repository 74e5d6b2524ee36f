"""What is wrong with a job's `network`, or cannot work with its ROS, RMW and workloads; pure."""

from __future__ import annotations

from collections.abc import Iterator

from rigel_k8s.app.checks.pods import check_pods, workloads_of
from rigel_k8s.app.checks.superclients import check_super_client
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.generation import Generation
from rigel_k8s.network.checks import check_options
from rigel_k8s.network.mode import ModeUse, mode_path
from rigel_k8s.network.modes import mode_of
from rigel_k8s.network.options import Network
from rigel_k8s.option_text import has_template
from rigel_k8s.problems import Problem

MISSING = (
    "no `network`: on most clusters nodes on different machines will not find each other, since pod"
    " networks carry no multicast; set network: macvlan, attachment, peers,"
    " discovery-server, zenoh or host, or none if it is known to work"
)


def check_network(options: OrchestrationOptions, ros: Generation, distro: str) -> Iterator[Problem]:
    """Yield what is wrong, with paths from the root of the options."""
    network, middleware = options.network, options.middleware
    if network is None:
        yield from check_missing(options, ros)
        return
    yield from check_options(network, ModeUse(ros, distro, middleware))
    yield from check_fleet(options, network, ros)
    if network.mode == "discovery-server":
        for key, node in options.nodes.items():
            if ros.of_node(node).rmw:
                yield from check_super_client(str(key), node, ros)
    yield from check_images(options, middleware or mode_of(network).middleware)
    others = len(ros.companions(options, distro)) + int(options.observability.exporter is not None)
    yield from check_pods(options, network, others=others)


def check_missing(options: OrchestrationOptions, ros: Generation) -> Iterator[Problem]:
    """Yield what is wrong without `network`: zenoh has no router, pods do not find each other."""
    if ros.dds and options.middleware == "zenoh":
        message = "zenoh needs a router: set `network: zenoh`, which deploys one"
        yield Problem(("middleware",), message, "wrong-mode")
    elif ros.dds and sum(one.pods for one in workloads_of(options)) > 1:
        path = ("nodes",) if options.nodes else ()
        yield Problem(path, MISSING, "network-missing", severity="warning", at_key=True)


def check_fleet(
    options: OrchestrationOptions, network: Network, ros: Generation
) -> Iterator[Problem]:
    """Yield a warning if the robots of a fleet share a wire and a DDS domain.

    A job deploys to several robots if its namespace comes from a matrix.
    """
    mode = mode_of(network)
    shared = ros.rmw and mode.name != "none" and not mode.own_domain
    if shared and network.domain_id is None and has_template(str(options.namespace or "")):
        message = (
            f"with {mode.name} all robots of a fleet are in DDS domain 0, and robots on one wire"
            " receive each other's messages: give each its own `domain_id`, from the matrix too"
        )
        yield Problem(mode_path(network), message, "one-domain", severity="warning")


def check_images(options: OrchestrationOptions, middleware: str | None) -> Iterator[Problem]:
    """Yield official images without the middleware, each place once."""
    if middleware not in ("cyclonedds", "zenoh"):
        return
    for path in dict.fromkeys(one.image for one in workloads_of(options) if one.official):
        message = (
            f"official ROS images have only Fast DDS: {middleware} needs an image with"
            f" ros-DISTRO-rmw-{middleware}-cpp installed"
        )
        yield Problem(path, message, "image-lacks-rmw", severity="warning")
