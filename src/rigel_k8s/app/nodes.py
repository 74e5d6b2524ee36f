"""Each of `nodes`: a Deployment or a Job, perhaps that of its `pod`; a Service if it has ports."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence

import attrs

from rigel_k8s.app import foxglove
from rigel_k8s.app.command import Command
from rigel_k8s.app.components import load_components
from rigel_k8s.app.environment import environment, find_literal, ros_variables
from rigel_k8s.app.files import Mounted, hash_files, mount_files, split_contents
from rigel_k8s.app.generation import GENERATIONS, Generation
from rigel_k8s.app.layer import (
    choose_port,
    explain_left_out,
    layer_variables,
    notes_volume,
    pods_service,
    shared_memory,
    shared_pod_variables,
)
from rigel_k8s.app.lifecycle import list_variables, make_transitions
from rigel_k8s.app.options import NodeOptions
from rigel_k8s.app.parameters import PARAMETERS_PATH
from rigel_k8s.app.programs import full_name, put_start_before, wrap
from rigel_k8s.app.testing import TEST_ANNOTATION
from rigel_k8s.app.updating import Candidate, Way, find_exclusive
from rigel_k8s.app.volumes import device_resources, mounts
from rigel_k8s.network.modes import mode_of, ready_words, wire_pod
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity, Wiring
from rigel_k8s.objects.marks import SINGLETON_ANNOTATION
from rigel_k8s.objects.naming import (
    HOSTNAME,
    NODE_ANNOTATION,
    ROS_ANNOTATION,
    ROS_NAME_ANNOTATION,
    object_name,
    ros_name,
    selector,
)
from rigel_k8s.objects.overlay import merge, simplify
from rigel_k8s.objects.podnodes import note_nodes
from rigel_k8s.objects.podoptions import (
    OUTSIDE,
    Placement,
    PortOptions,
    Readiness,
    RollingUpdate,
    Volume,
)
from rigel_k8s.objects.pods import (
    DEFAULT_CONTAINER,
    PROBE_TIMEOUT,
    Object,
    drop_empty,
    probes,
    script,
    service_account,
    stop_hook,
    tolerations,
)
from rigel_k8s.objects.resources import Resources
from rigel_k8s.objects.scalars import Port
from rigel_k8s.objects.workloads import (
    ReleaseContext,
    config_map,
    deployment,
    pull_policy,
    readiness_of,
    ros_volumes,
    run_once,
    service,
)

NODE_CONTAINER = "ros-node"
KUBERNETES_GRACE = 30  # seconds
PARAMETERS_ANNOTATION = "rigel-k8s/parameters"


@attrs.frozen
class RosNode:
    """A node with everything needed to build its objects.

    Attributes:
        ros: its own, which is not the release's if it is a program without ROS.
        image: its image, or the job's.
        files: the texts of its parameter files, by the names in `parameter_files`.
        volumes: the release's persistent volumes, by name.
        container: the name of its container; None: it has only those of its patch.
        is_application: it is src.plugin's one application, whose programs have names of their own.
        place: which one it is of the nodes of its pod.
        mounted: its `files`.
    """

    key: str
    options: NodeOptions
    ros: Generation
    image: str
    files: Mapping[str, str] = attrs.field(factory=dict)
    volumes: Mapping[str, Volume] = attrs.field(factory=dict)
    container: str | None = NODE_CONTAINER
    is_application: bool = False
    place: int = 0
    mounted: Sequence[Mounted] = ()

    @property
    def name(self) -> str:
        return self.key if self.is_application else object_name(self.key)

    @property
    def workload(self) -> str:
        """The Kubernetes name of its Deployment, which may be that of several nodes."""
        return object_name(self.options.pod) if self.options.pod else self.name

    @property
    def is_outside(self) -> bool:
        """Whether its ports are reached from outside of the cluster."""
        return bool(self.options.ports) and self.options.service_type in OUTSIDE

    @property
    def pinned(self) -> bool:
        """Whether it is bound to one machine."""
        return self.options.placement.machine is not None

    @property
    def ros_name(self) -> str | None:
        """The full ROS name, None if it is generated at the start or there is no ROS.

        What ends may be a tool that names its node itself; a promised name would be missing.
        """
        if self.is_application or self.options.anonymous or not self.ros.nodes:
            return None
        if self.options.kind and not self.sets_name:
            return None
        return full_name(self.key, self.options)

    @property
    def sets_name(self) -> bool:
        """Whether its program gets its ROS name here; others may have a name of their own."""
        line = self.ros.program(self.options)
        return not self.options.launch and self.ros.takes_arguments(line)

    @property
    def has_layer(self) -> bool:
        """Whether the library of ROS 2 can be loaded into its program."""
        if not self.ros.rmw or not self.container:
            return False
        return explain_left_out(self.options, self.ros.find_program(self.options)) is None

    @property
    def identity(self) -> PodIdentity:
        """The identity of the node's pod on the network."""
        replicas = self.options.replicas
        return PodIdentity(
            self.workload,
            self.image,
            None if replicas is None else int(replicas),
            on_machine=self.options.host_network,
            shares_memory=self.options.pod is not None,
            like=drop_empty(
                {
                    "imagePullPolicy": pull_policy(
                        self.options.image_pull_policy, pinned=self.pinned
                    ),
                    "resources": resources(self.options.resources, {}),
                    "securityContext": simplify(self.options.security_context),
                }
            ),
        )


@attrs.frozen
class NodePart:
    """A node's part of its pod: usually all of it.

    Attributes:
        plan: the network, with the node's own domain; wired: what that adds to this pod.
        way: how the pod is updated, with what the node needs for it.
        command: what its container runs, with the scripts that start it and run beside it.
        layered: it loads the library of ROS 2.
    """

    release: ReleaseContext
    node: RosNode
    plan: NetworkPlan
    wired: Wiring
    way: Way
    command: Command
    layered: bool

    @property
    def port(self) -> int:
        """The first of the ports at which its keepers are."""
        return keeper_port(self.release, self.node, self.plan)


def pod_objects(
    release: ReleaseContext, nodes: Sequence[RosNode], plan: NetworkPlan
) -> Iterator[Object]:
    first = nodes[0]
    release = attrs.evolve(release, ros=first.ros)
    plan = plan_of(first, plan)
    obstacle = find_obstacle(nodes, plan)
    exclusive = find_exclusive(first.options, first.volumes, plan.options)
    wired = wiring_of(first, plan)
    parts = [
        make_part(release, node, plan, wired, way_of(release, node, nodes, obstacle, exclusive))
        for node in nodes
    ]
    for part in parts:
        if part.command.files:
            name, files = parameters_config(part.node), part.command.files
            yield config_map(release, name, files, part_of=first.workload)
        if mounted := part.node.mounted:
            texts, others = split_contents(mounted)
            name = files_config(part.node)
            yield config_map(release, name, texts, part_of=first.workload, binary=others)
    yield node_workload(parts)
    if ports := [part.port for part in parts if part.layered]:
        yield pods_service(release, first.workload, ports)
    for node in nodes:
        if node.options.ports:
            ports_of = [port_entry(port, service=True) for port in node.options.ports]
            kind = node.options.service_type
            yield service(release, node.name, ports_of, first.workload, kind)


def make_part(
    release: ReleaseContext, node: RosNode, plan: NetworkPlan, wired: Wiring, way: Way
) -> NodePart:
    """Return a node's part of its pod."""
    layered = release.layer and node.has_layer
    command = node.ros.command_of(node.key, node.options, node.files)
    command = load_components(command, node.ros.components, node.key, node.options)
    command = make_transitions(command, node.key, node.options)
    if layered:
        command = wrap(command, "rmw.sh")
    command = put_start_before(command)
    if layered and node.container:
        volume, mount = notes_volume()
        wired = attrs.evolve(
            wired,
            env={**wired.env, **layer_variables(node.container, keeper_port(release, node, plan))},
            volumes=[*wired.volumes, volume],
            mounts=[*wired.mounts, mount],
        )
    if node.options.pod and not (plan.options and plan.options.shared_memory):
        volume, mount = shared_memory()
        wired = attrs.evolve(wired, volumes=[*wired.volumes, volume], mounts=[*wired.mounts, mount])
    return NodePart(release, node, plan, wired, way, command, layered)


def keeper_port(release: ReleaseContext, node: RosNode, plan: NetworkPlan) -> int:
    """Return the first of the ports at which a node's keepers are; nodes of a pod share them."""
    on_machine = plan.options is not None and mode_of(plan.options).in_machine_network
    shares = on_machine or node.options.host_network or node.options.pod is not None
    return choose_port(release, node.name, shares_network=shares)


def plan_of(node: RosNode, plan: NetworkPlan) -> NetworkPlan:
    """Return the network of a node, which may set its own domain."""
    own = find_literal(node.options.env, "ROS_DOMAIN_ID") if plan.ros.rmw else None
    return attrs.evolve(plan, domain_id=int(own)) if own and own.isdecimal() else plan


def node_workload(parts: Sequence[NodePart]) -> Object:
    """Return the Deployment or the Job of a pod's nodes with the user's patch merged in."""
    first = parts[0]
    node, options = first.node, first.node.options
    names = [part.node.ros_name for part in parts if part.node.ros_name]
    notes = note_nodes({str(p.node.container): notes_of(p.node) for p in parts})
    if not options.pod:
        notes = notes_of(node)
    # A launch file names its nodes: its pods may have one of this name, and need not.
    unsure = (ROS_NAME_ANNOTATION,) if options.launch else ()
    several = first.wired.init_containers or node.is_application or len(parts) > 1
    made = deployment(
        first.release,
        node.workload,
        pod_spec(parts),
        strategy=first.way.strategy,
        replicas=1 if names and options.replicas is None else node.identity.replicas,
        annotations={key: note for key, note in notes.items() if key not in unsure}
        | ({TEST_ANNOTATION: "true"} if options.kind == "test" else {})
        | ({SINGLETON_ANNOTATION: " ".join(names)} if names else {})
        | foxglove.note_image(options.package, first.release.distro)
        | ({} if options.kind else first.way.annotations(first.release)),
        pod_annotations={
            **notes,
            **parameters_hash(parts),
            **({DEFAULT_CONTAINER: node.container} if several and node.container else {}),
            **first.wired.annotations,
        },
        own_labels={str(key): str(value) for key, value in options.labels.items()},
    )
    if options.kind:
        made = run_once(made, suspend=options.kind == "test")
    merged: Object = merge(made, options.patch) if options.patch else made
    return merged


def notes_of(node: RosNode) -> dict[str, str]:
    """Return the annotations by which a node is found."""
    notes = {} if node.is_application else {NODE_ANNOTATION: node.key}
    notes |= {ROS_NAME_ANNOTATION: node.ros_name} if node.ros_name else {}
    if node.options.ros:
        notes[ROS_ANNOTATION] = node.options.ros
    return notes


def find_obstacle(nodes: Sequence[RosNode], plan: NetworkPlan) -> str | None:
    """Return why a pod cannot be handed over: the first reason of one of its nodes."""
    for node in nodes:
        found = node.ros.find_obstacle(node.options, node.volumes, plan.options, plan.middleware)
        if node.container is None:
            found = "its containers are the user's own"
        if found:
            return f"{node.key}: {found}" if len(nodes) > 1 else found
    return None


def way_of(
    release: ReleaseContext,
    node: RosNode,
    nodes: Sequence[RosNode],
    obstacle: str | None,
    exclusive: str | None,
) -> Way:
    """Return how a node's pod is updated, with what the node needs for it."""
    options = node.options
    if options.kind:
        return Way("Recreate")
    candidate = Candidate(
        release=release,
        workload=node.name,
        ros_name=node.ros_name,
        update=options.update or RollingUpdate(),
        obstacle=obstacle,
    )
    way = GENERATIONS[release.ros.name].choose_way(
        candidate, anonymous=options.anonymous, exclusive=exclusive
    )
    if way.env and options.pod:
        own = shared_pod_variables(node.workload, (str(one.container) for one in nodes))
        way = attrs.evolve(way, env={**way.env, **own})
    return way


def wiring_of(node: RosNode, plan: NetworkPlan) -> Wiring:
    """Return what the network adds to a node; a program without ROS gets no variable of ROS."""
    if node.options.ros is None:
        return wire_pod(plan, node.identity)
    if not plan.ros.dds:  # all its variables are ROS' own
        return attrs.evolve(wire_pod(plan, node.identity), env={})
    return wire_pod(attrs.evolve(plan, ros=node.ros), node.identity)


def pod_spec(parts: Sequence[NodePart]) -> Object:
    """Return the pod's spec; the containers' mounts and the pod's volumes belong together."""
    first = parts[0]
    node, options = first.node, first.node.options
    volumes: dict[str, Object] = {}
    made_containers = []
    for part in parts:
        own, seen = list_volumes(part)
        volumes |= {volume["name"]: volume for volume in own}
        if part.node.container:
            made_containers.append(container(part, seen))
    made = {
        "initContainers": list(first.wired.init_containers) if node.container else [],
        "containers": made_containers,
        "volumes": list(volumes.values()),
        "nodeSelector": options.placement.node_selector,
        "affinity": affinity(options.placement),
        "tolerations": tolerations(options.tolerations, pinned=node.pinned),
        "hostNetwork": options.host_network or None,
        "dnsPolicy": "ClusterFirstWithHostNet" if options.host_network else None,
        "runtimeClassName": options.runtime_class and str(options.runtime_class),
        **service_account(options.service_account and str(options.service_account)),
        "terminationGracePeriodSeconds": grace_seconds(options, max(p.way.drain for p in parts)),
    }
    return drop_empty(made | dict(first.wired.pod))


def list_volumes(part: NodePart) -> tuple[list[Object], list[Object]]:
    """Return (volumes, mounts) of a node; names that another node of the pod has, too, differ."""
    node = part.node
    prefix = f"n{node.place}-" if node.options.pod else ""
    pairs = ros_volumes(part.release)
    if part.command.files:
        name = f"{prefix}rigel-parameters"
        volume = {"name": name, "configMap": {"name": parameters_config(node)}}
        pairs.append((volume, {"name": name, "mountPath": PARAMETERS_PATH, "readOnly": True}))
    pairs += mount_files(node.mounted, files_config(node), prefix)
    volumes, seen = mounts(node.options.volumes, node.options.devices, node.volumes, prefix)
    return (
        [*(volume for volume, _ in pairs), *volumes, *part.wired.volumes],
        [*(mount for _, mount in pairs), *seen, *part.wired.mounts],
    )


def container(pod: NodePart, volume_mounts: Sequence[Object]) -> Object:
    """Return the node's container."""
    node, options, command = pod.node, pod.node.options, pod.command
    defaults = ros_variables(
        pod.release, namespace=ros_namespace(node), host_network=options.host_network
    )
    variables = {**list_variables(node.key, options), **list_rates(options)}
    own = {**pod.wired.env, **pod.way.env, **variables}
    readiness = "none" if options.kind else readiness_of(pod.release, options.readiness)
    return drop_empty(
        {
            "name": node.container,
            "image": node.image,
            "imagePullPolicy": pull_policy(options.image_pull_policy, pinned=node.pinned),
            "command": command.command and list(command.command),
            "args": command.args and list(command.args),
            "env": environment(defaults, own, options.env),
            "ports": [port_entry(port, service=False) for port in options.ports],
            "resources": resources(options.resources, device_resources(options.devices)),
            "securityContext": simplify(options.security_context),
            **probes(readiness, list_probe_words(pod)),
            "livenessProbe": liveness(pod),
            "lifecycle": stop_hook(grace_seconds(options)),
            "volumeMounts": list(volume_mounts),
        }
    )


def list_rates(options: NodeOptions) -> Mapping[str, Object]:
    """Return the variable with the rates that the node must reach (rigel_inpod/rates.py)."""
    wanted = options.readiness.rates if isinstance(options.readiness, Readiness) else {}
    limits = {ros_name(topic): one.around for topic, one in wanted.items()}
    words = [f"{topic}={low:g}:{high:g}" for topic, (low, high) in limits.items()]
    return {"RIGEL_K8S_RATES": {"value": " ".join(words)}} if words else {}


def list_probe_words(pod: NodePart) -> tuple[str, ...]:
    """Return what the readiness probe of a node checks: the network, then scripts next to it."""
    options = pod.node.options
    waited_for = {
        "--transitions": bool(options.lifecycle and options.lifecycle.start),
        "--components": bool(options.components),
    }
    name = full_name(pod.node.key, options)
    beside = (word for option, on in waited_for.items() if on for word in (option, name))
    node = ("--node", name) if pod.layered and pod.node.ros_name and pod.node.sets_name else ()
    return (*ready_words(pod.plan), *node, *beside)


def liveness(pod: NodePart) -> Object:
    """Return the probe that restarts a container that stands still, or has gone silent.

    What hangs does not finish the goals that it has: it gets the time without `drain`. Kubernetes
    before 1.25 does not know that field.
    """
    options = pod.node.options
    if options.liveness is None or not pod.layered:
        return {}
    stuck, silent = options.liveness.stuck, options.liveness.silent
    limits = {ros_name(topic): duration.seconds for topic, duration in silent.items()}
    words = [f"{stuck.seconds:g}" if stuck else "0", *(f"{t}={s:g}" for t, s in limits.items())]
    shortest = min([*limits.values(), *([stuck.seconds] if stuck else [])])
    return {
        **script("ready.sh", "stuck", *words),
        "periodSeconds": max(1, min(10, round(shortest / 2))),
        "timeoutSeconds": PROBE_TIMEOUT,
        # A machine that is too busy for one probe is no reason; silence is measured, not missed.
        "failureThreshold": 2 if stuck else 1,
        "terminationGracePeriodSeconds": grace_seconds(options) or KUBERNETES_GRACE,
    }


def grace_seconds(options: NodeOptions, drain: int = 0) -> int | None:
    """Return how long the pod may take to end, None for Kubernetes' 30 s.

    Args:
        drain: seconds that what it has begun may take before that.
    """
    grace = options.termination_grace_period
    if grace is None:
        return KUBERNETES_GRACE + drain if drain else None
    return max(1, round(grace.seconds)) + drain


def affinity(placement: Placement) -> Object:
    """Return what keeps a pod off the machines of other pods."""
    terms = [
        {"labelSelector": {"matchLabels": selector(object_name(key))}, "topologyKey": HOSTNAME}
        for key in placement.apart_from
    ]
    if not terms:
        return {}
    return {"podAntiAffinity": {"requiredDuringSchedulingIgnoredDuringExecution": terms}}


def ros_namespace(node: RosNode) -> str | None:
    """Return the node's ROS namespace, from its name if that is a path; None at the root."""
    if node.options.launch or node.options.anonymous:
        return str(node.options.namespace) if node.options.namespace else None
    return full_name(node.key, node.options).rpartition("/")[0] or None


def resources(asked: Resources, devices: Mapping[str, str]) -> Object:
    """Return a container's resources; a device plugin's are limits."""
    limits = {str(name): str(value) for name, value in asked.limits.items()}
    requests = {str(name): str(value) for name, value in asked.requests.items()}
    return drop_empty({"requests": requests, "limits": limits | dict(devices)})


def parameters_config(node: RosNode) -> str:
    """Return the name of the ConfigMap with the node's parameters."""
    return f"{node.name}-parameters"


def files_config(node: RosNode) -> str:
    """Return the name of the ConfigMap with the node's files: pods keep those they started with."""
    return f"{node.name}-files-{hash_files(node.mounted)}"


def parameters_hash(parts: Sequence[NodePart]) -> dict[str, str]:
    """Return the annotation that makes changed parameters start a new pod."""
    found = {part.node.key: part.command.files for part in parts if part.command.files}
    if not found:
        return {}
    text = json.dumps(found if len(parts) > 1 else parts[0].command.files, sort_keys=True)
    return {PARAMETERS_ANNOTATION: hashlib.sha256(text.encode()).hexdigest()[:16]}


def port_entry(port: Port | PortOptions, *, service: bool) -> Object:
    """Return the container's side of a port, or the Service's; Kubernetes needs names for two."""
    port = port if isinstance(port, PortOptions) else PortOptions(port=port)
    name = str(port.name or f"{port.protocol.lower()}-{int(port.port)}")
    own = {"containerPort": int(port.port)}
    if service:
        own = {"port": int(port.service_port or port.port), "targetPort": int(port.port)}
    return {"name": name, **own, "protocol": port.protocol}
