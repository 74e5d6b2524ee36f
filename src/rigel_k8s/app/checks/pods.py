"""What the workloads of a release cannot do on its network: replicas, places, images."""

from __future__ import annotations

import re
from collections.abc import Iterator

import attrs

from rigel_k8s.app.application import has_application
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.app.updating import is_rolling
from rigel_k8s.network.modes import mode_of
from rigel_k8s.network.options import Network
from rigel_k8s.network.rangechecks import pool_of
from rigel_k8s.objects.naming import object_name
from rigel_k8s.objects.raw import mapping
from rigel_k8s.problems import Path, Problem

#: The images of docker.io/library/ros and osrf/ros, which have only Fast DDS.
OFFICIAL = re.compile(r"(docker\.io/)?(library/|osrf/)?ros([:@].*)?")

STATIC = "with `ipam: static` each workload has one address"


@attrs.frozen
class Workload:
    """What a check needs to know about a node, or about the application.

    Attributes:
        path: its place in the options; replicas, update: the places of these keys.
        pods: the maximum number; node: the machine it is pinned to.
    """

    name: str
    path: Path
    pods: int
    replicas: Path
    update: Path
    rolling: bool
    image: Path
    official: bool
    node: str | None = None
    host_network: bool = False


def workloads_of(options: OrchestrationOptions) -> Iterator[Workload]:
    """Yield the nodes and the application; roscore is handled separately."""
    for key, node in options.nodes.items():
        path: Path = ("nodes", str(key))
        image = str(node.image or options.image or "")
        rolling = is_rolling(node.update) if node.update else node.anonymous
        yield Workload(
            name=object_name(str(key)),
            path=path,
            pods=1 if node.replicas is None else int(node.replicas),
            replicas=(*path, "replicas"),
            update=(*path, "update") if node.update else path,
            rolling=rolling,
            image=(*path, "image") if node.image else ("image",),
            official=bool(OFFICIAL.fullmatch(image)),
            node=str(node.placement.node) if node.placement.node else None,
            host_network=node.host_network,
        )
    if has_application(options):
        yield application_of(options)


def application_of(options: OrchestrationOptions) -> Workload:
    """Return the one application."""
    spec = mapping(options.additional_k8s_params.application.get("spec"))
    replicas = spec.get("replicas", 1)
    return Workload(
        name=str(options.deployment_name),
        path=("application_image",) if options.application_image else ("additional_k8s_params",),
        pods=replicas if isinstance(replicas, int) else 1,
        replicas=("additional_k8s_params", "application", "spec", "replicas"),
        update=("rolling_update",),
        rolling=options.rolling_update is not None and is_rolling(options.rolling_update),
        image=("application_image",),
        official=bool(OFFICIAL.fullmatch(str(options.application_image or ""))),
    )


def check_pods(
    options: OrchestrationOptions, network: Network, *, others: int
) -> Iterator[Problem]:
    """Yield what the workloads cannot do.

    Args:
        others: how many other pods there are, roscore's and the exporter's.
    """
    found = list(workloads_of(options))
    yield from check_replicas(network, found)
    yield from check_launches(options, network)
    yield from check_count(network, sum(one.pods for one in found) + others)
    yield from check_machines(network, found)
    yield from check_host_network(network, found)
    yield from check_names(options, network, found)


def check_replicas(network: Network, found: list[Workload]) -> Iterator[Problem]:
    """Yield workloads with more pods than addresses, or than can be found."""
    static, one_pod = network.ipam == "static", mode_of(network).one_pod
    for one in found:
        if one.pods > 1 and static:
            message = f"{STATIC}, but this one has {one.pods} pods"
            yield Problem(one.replicas, message, "replicas")
        elif one.pods > 1 and one_pod:
            yield Problem(one.replicas, one_pod, "replicas")
        elif static and one.rolling:
            message = f"{STATIC}, but a rolling update has two pods at once: set strategy: Recreate"
            yield Problem(one.update, message, "surge", at_key=True)


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


def check_count(network: Network, pods: int) -> Iterator[Problem]:
    """Yield that there are more pods than addresses."""
    pool = pool_of(network)
    if pool is not None and pods > len(pool):
        narrow = "range_end" if network.range_end else "subnet"
        message = f"the range has {len(pool)} addresses, but {pods} pods need one: widen the range"
        yield Problem(("network", narrow), message, "too-few-addresses")


def check_machines(network: Network, found: list[Workload]) -> Iterator[Problem]:
    """Yield a problem if host-local would give one address to two machines."""
    if network.ipam != "host-local" or sum(one.pods for one in found) < 2:
        return
    machines = {one.node for one in found}
    if None in machines or len(machines) > 1:
        message = (
            "host-local counts on each machine separately, so two machines assign one address"
            " twice: pin all nodes to one machine (placement: {node: ...}), or use whereabouts"
        )
        yield Problem(("network", "ipam"), message, "host-local")


def check_host_network(network: Network, found: list[Workload]) -> Iterator[Problem]:
    """Yield pods on the machine's own network, to which Multus attaches nothing."""
    for one in found:
        if one.host_network and mode_of(network).attached:
            message = (
                f"a pod on the machine's own network gets no second interface, so {network.mode}"
                " does not reach it: remove host_network"
            )
            yield Problem((*one.path, "host_network"), message, "conflict", at_key=True)


def check_names(
    options: OrchestrationOptions, network: Network, found: list[Workload]
) -> Iterator[Problem]:
    """Yield workloads that have the name of an object of the mode."""
    names = [one.name for one in found]
    made = set(mode_of(network).services(str(options.deployment_name), network, names))
    for one in found:
        if one.name in made:
            message = (
                f'"{one.name}" is the name of a Service of mode {network.mode}: choose another'
            )
            yield Problem(one.path, message, "name-taken", at_key=True)
