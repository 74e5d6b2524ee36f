"""What is wrong with a job's `network`, or cannot work with its ROS, middleware and workloads."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping

import attrs

from rigel_k8s.app.application import application_options, has_application
from rigel_k8s.app.generation import Generation
from rigel_k8s.app.layer import SHM_PATH
from rigel_k8s.app.options import NodeOptions, OrchestrationOptions
from rigel_k8s.app.updating import has_variable, is_rolling
from rigel_k8s.app.volumes import find_mounts
from rigel_k8s.network.checks import check_options, pool_of
from rigel_k8s.network.mode import ModeUse, mode_path
from rigel_k8s.network.modes import mode_of
from rigel_k8s.network.options import Network
from rigel_k8s.objects.overlay import mapping
from rigel_k8s.option_text import has_template
from rigel_k8s.problems import Path, Problem

MISSING = (
    "no `network`: on most clusters nodes on different machines will not find each other, since pod"
    " networks carry no multicast; set network: macvlan, attachment, peers,"
    " discovery-server, zenoh or host, or none if it is known to work"
)
STATIC = "with `ipam: static` each workload has one address"
#: The images of docker.io/library/ros and osrf/ros, which have only Fast DDS.
OFFICIAL = re.compile(r"(docker\.io/)?(library/|osrf/)?ros([:@].*)?")
SUPER_CLIENT = "ROS_SUPER_CLIENT"
#: Programs that look for topics which they do not know by name; also inside of `bash -c`.
TOOLS = re.compile(r"\bros2 bag record\b|\bfoxglove_bridge\b|\brosbridge_server\b")


@attrs.frozen
class Workload:
    """A node, or the one application, as the network sees it.

    Attributes:
        places: where its options `replicas`, `update` and `image` are, or what stands for them.
        pods: the maximum number.
    """

    node: NodeOptions
    path: Path
    places: Mapping[str, Path]
    image: str
    pods: int

    @property
    def rolling(self) -> bool:
        """Whether an update has two pods at once."""
        return is_rolling(self.node.update) if self.node.update else self.node.anonymous


def workloads_of(options: OrchestrationOptions) -> list[Workload]:
    """Return the nodes and the application; roscore is handled separately."""
    found: list[Workload] = []
    for key, node in options.nodes.items():
        path: Path = ("nodes", str(key))
        places = {
            "replicas": (*path, "replicas"),
            "update": (*path, "update") if node.update else path,
            "image": (*path, "image") if node.image else ("image",),
        }
        pods = 1 if node.replicas is None else int(node.replicas)
        if node.pod and any(one.node.pod == node.pod for one in found):
            pods = 0  # it is in that one's pod
        found.append(Workload(node, path, places, str(node.image or options.image or ""), pods))
    if has_application(options):
        params = ("additional_k8s_params", "application")
        image = options.application_image
        replicas = mapping(options.additional_k8s_params.application.get("spec")).get("replicas")
        found.append(
            Workload(
                application_options(options),
                ("application_image",) if image else params[:1],
                {
                    "replicas": (*params, "spec", "replicas"),
                    "update": ("rolling_update",),
                    "image": ("application_image",),
                },
                str(image or ""),
                replicas if isinstance(replicas, int) else 1,
            )
        )
    return found


def check_network(options: OrchestrationOptions, ros: Generation, distro: str) -> Iterator[Problem]:
    """Yield what is wrong, with paths from the root of the options."""
    network, middleware = options.network, options.middleware
    workloads = workloads_of(options)
    pods = sum(one.pods for one in workloads)
    if network is None:
        yield from check_missing(options, ros, pods)
        return
    yield from check_options(network, ModeUse(ros, distro, middleware))
    yield from check_fleet(options, network, ros)
    if mode_of(network).asks_servers:
        for key, node in options.nodes.items():
            if ros.of_node(node).rmw:
                yield from check_super_client(str(key), node, ros)
    yield from check_images(workloads, middleware or mode_of(network).middleware)
    yield from check_replicas(network, workloads)
    yield from check_launches(options, network)
    if network.shared_memory:
        yield from check_memory(options)
    others = len(ros.companions(options, distro)) + int(options.observability.exporter is not None)
    yield from check_count(network, pods + others)
    yield from check_machines(network, workloads, pods)


def check_missing(options: OrchestrationOptions, ros: Generation, pods: int) -> Iterator[Problem]:
    """Yield what is wrong without `network`: zenoh has no router, pods do not find each other."""
    if ros.dds and options.middleware == "zenoh":
        message = "zenoh needs a router: set `network: zenoh`, which deploys one"
        yield Problem(("middleware",), message, "wrong-mode")
    elif ros.dds and pods > 1:
        path = ("nodes",) if options.nodes else ()
        why: tuple[Path, ...] = (("network",),)
        yield Problem(
            path, MISSING, "network-missing", severity="warning", at_key=True, because=why
        )


def check_fleet(
    options: OrchestrationOptions, network: Network, ros: Generation
) -> Iterator[Problem]:
    """Yield a warning if the robots of a fleet share a wire and a DDS domain.

    A job deploys to several robots if its namespace comes from a matrix.
    """
    mode = mode_of(network)
    shared = ros.rmw and mode.connects and not mode.own_domain
    if shared and network.domain_id is None and has_template(str(options.namespace or "")):
        message = (
            f"with {mode.name} all robots of a fleet are in DDS domain 0, and robots on one wire"
            " receive each other's messages: give each its own, as in `domain_id:"
            ' "{{ vars.domains[data.robot] }}"`'
        )
        yield Problem(mode_path(network), message, "one-domain", severity="warning")


def check_super_client(key: str, node: NodeOptions, ros: Generation) -> Iterator[Problem]:
    """Yield a warning for a tool that a discovery server shows no topics."""
    line = " ".join(ros.find_program(node))
    found = TOOLS.search(line)
    if found is None or SUPER_CLIENT in line or has_variable(node, SUPER_CLIENT):
        return
    message = (
        f"{found[0]} does not see all topics, since a discovery server shows them only to super"
        f' clients: set env: {{ {SUPER_CLIENT}: "TRUE" }}'
    )
    yield Problem(("nodes", key), message, "no-super-client", severity="warning", at_key=True)


def check_images(workloads: list[Workload], middleware: str | None) -> Iterator[Problem]:
    """Yield official images without the middleware, each place once."""
    if middleware not in ("cyclonedds", "zenoh"):
        return
    official = (one.places["image"] for one in workloads if OFFICIAL.fullmatch(one.image))
    for path in dict.fromkeys(official):
        message = (
            f"official ROS images have only Fast DDS: {middleware} needs an image with"
            f" ros-DISTRO-rmw-{middleware}-cpp installed"
        )
        yield Problem(path, message, "image-lacks-rmw", severity="warning")


def check_replicas(network: Network, workloads: list[Workload]) -> Iterator[Problem]:
    """Yield workloads with more pods than addresses, or that the mode does not reach."""
    static, mode = network.ipam == "static", mode_of(network)
    for one in workloads:
        if one.pods > 1 and static:
            message = f"{STATIC}, but this one has {one.pods} pods"
            yield Problem(one.places["replicas"], message, "replicas")
        elif one.pods > 1 and mode.one_pod:
            yield Problem(one.places["replicas"], mode.one_pod, "replicas")
        elif static and one.rolling:
            message = f"{STATIC}, but a rolling update has two pods at once: set strategy: Recreate"
            yield Problem(one.places["update"], message, "surge", at_key=True)
        if one.node.host_network and mode.attached:
            message = (
                f"a pod on the machine's own network gets no second interface, so {network.mode}"
                " does not reach it: remove host_network"
            )
            yield Problem((*one.path, "host_network"), message, "conflict", at_key=True)


def check_launches(options: OrchestrationOptions, network: Network) -> Iterator[Problem]:
    """Yield launch files whose later programs may miss each other: few ports are tried."""
    launched = [str(key) for key, node in options.nodes.items() if node.launch]
    participants = mode_of(network).participants
    if participants is None or len(launched) < 2:
        return
    for key in launched:
        message = (
            f"with `{network.mode}` programs beyond the first {participants} of a pod are not found"
            " by those of another such pod: keep launch files small, or use another mode"
        )
        yield Problem(("nodes", key, "launch"), message, "many-participants", severity="warning")


def check_memory(options: OrchestrationOptions) -> Iterator[Problem]:
    """Yield nodes with a /dev/shm of their own: what others write for them would get lost."""
    for key, node in options.nodes.items():
        for index in find_mounts(node.volumes, SHM_PATH):
            message = (
                f"with `shared_memory` all nodes have the machine's {SHM_PATH}: remove this volume"
            )
            yield Problem(("nodes", str(key), "volumes", index), message, "conflict")


def check_count(network: Network, pods: int) -> Iterator[Problem]:
    """Yield that there are more pods than addresses."""
    pool = pool_of(network)
    if pool is not None and pods > len(pool):
        narrow = "range_end" if network.range_end else "subnet"
        message = f"the range has {len(pool)} addresses, but {pods} pods need one: widen the range"
        yield Problem(("network", narrow), message, "too-few-addresses")


def check_machines(network: Network, workloads: list[Workload], pods: int) -> Iterator[Problem]:
    """Yield a problem if host-local would give one address to two machines."""
    machines = {one.node.placement.machine for one in workloads}
    if network.ipam == "host-local" and pods > 1 and (None in machines or len(machines) > 1):
        message = (
            "host-local counts on each machine separately, so two machines assign one address"
            " twice: pin all nodes to one machine (placement: {node: ...}), or use whereabouts"
        )
        yield Problem(("network", "ipam"), message, "host-local")


ON_MACHINE = (
    "pods on the machine's own network are not covered by network_policy, and the other pods of the"
    " release refuse their connections: add the machines' addresses to network_policy.allow"
)
ATTACHED = (
    "network_policy covers only the pods' first interface: everything on the second network reaches"
    " all nodes there"
)
ELSEWHERE = (
    "nodes of this master that run elsewhere cannot connect to the nodes of this release: add their"
    " addresses or releases to network_policy.allow"
)


def check_network_policy(options: OrchestrationOptions) -> Iterator[Problem]:
    """Yield pods that no policy covers, or that a policy cuts off."""
    if options.network_policy is None:
        return
    mode = mode_of(options.network)
    addresses = any(source.cidr for source in options.network_policy.allow)
    if mode.attached:
        path: Path = ("network_policy",)
        yield Problem(path, ATTACHED, "not-covered", severity="warning", at_key=True)
    if options.ros_master_uri and not options.network_policy.allow:
        path = ("ros_master_uri",)
        yield Problem(path, ELSEWHERE, "not-covered", severity="warning", at_key=True)
    if addresses:
        return
    if options.network is not None and mode.in_machine_network:
        path = mode_path(options.network)
        yield Problem(path, ON_MACHINE, "not-covered", severity="warning", at_key=True)
    for key, node in options.nodes.items():
        if node.host_network:
            path = ("nodes", str(key), "host_network")
            yield Problem(path, ON_MACHINE, "not-covered", severity="warning", at_key=True)
