"""Each of `nodes`: a Deployment of one container, and a Service if it has ports."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence

import attrs

from rigel_k8s.app.components import load_components
from rigel_k8s.app.environment import environment, find_literal, ros_variables
from rigel_k8s.app.lifecycle import list_variables, make_transitions
from rigel_k8s.app.options import NodeOptions
from rigel_k8s.app.parameters import PARAMETERS_PATH
from rigel_k8s.app.programs import Command, full_name, put_start_before, wrap
from rigel_k8s.app.updating import Way, choose_way
from rigel_k8s.app.volumes import device_resources, mounts
from rigel_k8s.generation import Generation
from rigel_k8s.network.modes import wire_pod
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity, Wiring
from rigel_k8s.objects.marks import SINGLETON_ANNOTATION
from rigel_k8s.objects.naming import (
    HOSTNAME,
    NODE_ANNOTATION,
    ROS_ANNOTATION,
    ROS_NAME_ANNOTATION,
    object_name,
    selector,
)
from rigel_k8s.objects.overlay import merge, simplify
from rigel_k8s.objects.podoptions import Placement, PortOptions, Volume
from rigel_k8s.objects.pods import (
    DEFAULT_CONTAINER,
    Object,
    drop_empty,
    probes,
    service_account,
    stop_hook,
)
from rigel_k8s.objects.resources import Resources
from rigel_k8s.objects.scalars import Port
from rigel_k8s.objects.tolerations import tolerations
from rigel_k8s.objects.workloads import (
    ReleaseContext,
    config_map,
    deployment,
    pull_policy,
    readiness_of,
    ros_volumes,
    service,
)

NODE_CONTAINER = "ros-node"
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
    """

    key: str
    options: NodeOptions
    ros: Generation
    image: str
    files: Mapping[str, str] = attrs.field(factory=dict)
    volumes: Mapping[str, Volume] = attrs.field(factory=dict)
    container: str | None = NODE_CONTAINER
    is_application: bool = False

    @property
    def name(self) -> str:
        """The Kubernetes name."""
        return self.key if self.is_application else object_name(self.key)

    @property
    def pinned(self) -> bool:
        """Whether it is bound to certain machines."""
        return bool(self.options.placement.node_selector)

    @property
    def ros_name(self) -> str | None:
        """The full ROS name, None if it is generated at the start or there is no ROS."""
        if self.is_application or self.options.anonymous or not self.ros.nodes:
            return None
        return full_name(self.key, self.options)

    @property
    def sets_name(self) -> bool:
        """Whether its program gets its ROS name here; others may have a name of their own."""
        line = self.ros.program(self.options)
        return not self.options.launch and self.ros.takes_arguments(line)

    @property
    def identity(self) -> PodIdentity:
        """The node's identity on the network."""
        replicas = self.options.replicas
        return PodIdentity(
            self.name,
            self.image,
            None if replicas is None else int(replicas),
            on_machine=self.options.host_network,
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
class NodePod:
    """What the pod of a node is made of.

    Attributes:
        plan: the network, with the node's own domain; wired: what that adds to this pod.
        way: how the node is updated.
        command: what its container runs, with the scripts that start it and run beside it.
    """

    release: ReleaseContext
    node: RosNode
    plan: NetworkPlan
    wired: Wiring
    way: Way
    command: Command


def node_objects(release: ReleaseContext, node: RosNode, plan: NetworkPlan) -> Iterator[Object]:
    """Yield a node's objects."""
    release = attrs.evolve(release, ros=node.ros)
    plan = plan_of(node, plan)
    way = way_of(release, node, plan)
    command = node.ros.command_of(node.key, node.options, node.files)
    command = load_components(command, node.ros.components, node.key, node.options)
    command = make_transitions(command, node.key, node.options)
    if way.script:
        command = wrap(command, way.script)
    command = put_start_before(command)
    if command.files:
        yield config_map(release, parameters_config(node), command.files, part_of=node.name)
    yield node_deployment(NodePod(release, node, plan, wiring_of(node, plan), way, command))
    if node.options.ports:
        ports = [port_entry(port, service=True) for port in node.options.ports]
        yield service(release, node.name, ports)


def plan_of(node: RosNode, plan: NetworkPlan) -> NetworkPlan:
    """Return the network of a node, which may set its own domain."""
    own = find_literal(node.options.env, "ROS_DOMAIN_ID") if plan.ros.rmw else None
    return attrs.evolve(plan, domain_id=int(own)) if own and own.isdecimal() else plan


def node_deployment(pod: NodePod) -> Object:
    """Return a node's Deployment with the user's patch merged in."""
    node, options = pod.node, pod.node.options
    name = node.ros_name
    notes = {} if node.is_application else {NODE_ANNOTATION: node.key}
    notes |= {ROS_NAME_ANNOTATION: name} if name else {}
    several = pod.wired.init_containers or node.is_application
    if options.ros:
        notes[ROS_ANNOTATION] = options.ros
    made = deployment(
        pod.release,
        node.name,
        pod_spec(pod),
        strategy=pod.way.strategy,
        replicas=1 if name and options.replicas is None else node.identity.replicas,
        annotations=notes
        | ({SINGLETON_ANNOTATION: name} if name else {})
        | pod.way.annotations(pod.release),
        pod_annotations={
            **notes,
            **parameters_hash(pod.command),
            **({DEFAULT_CONTAINER: node.container} if several and node.container else {}),
            **pod.wired.annotations,
        },
        own_labels={str(key): str(value) for key, value in options.labels.items()},
    )
    merged: Object = merge(made, options.patch) if options.patch else made
    return merged


def way_of(release: ReleaseContext, node: RosNode, plan: NetworkPlan) -> Way:
    """Return how a node is updated."""
    options = node.options
    obstacle = node.ros.find_obstacle(options, node.volumes, plan.options, plan.middleware)
    if node.container is None:
        obstacle = "its containers are the user's own"
    anonymous = options.anonymous
    return choose_way(
        release, node.name, node.ros_name, options.update, obstacle, anonymous=anonymous
    )


def wiring_of(node: RosNode, plan: NetworkPlan) -> Wiring:
    """Return what the network adds to a node; a program without ROS gets no variable of ROS."""
    if node.options.ros is None:
        return wire_pod(plan, node.identity)
    if not plan.ros.dds:  # all its variables are ROS' own
        return attrs.evolve(wire_pod(plan, node.identity), env={})
    return wire_pod(attrs.evolve(plan, ros=node.ros), node.identity)


def pod_spec(pod: NodePod) -> Object:
    """Return the pod's spec; the container's mounts and the pod's volumes belong together."""
    node, options = pod.node, pod.node.options
    pairs = ros_volumes(pod.release)
    if pod.command.files:
        volume = {"name": "rigel-parameters", "configMap": {"name": parameters_config(node)}}
        mount = {"name": volume["name"], "mountPath": PARAMETERS_PATH, "readOnly": True}
        pairs.append((volume, mount))
    volumes, seen = mounts(options, node.volumes)
    volumes = [*(volume for volume, _ in pairs), *volumes]
    seen = [*(mount for _, mount in pairs), *seen, *pod.wired.mounts]
    made = {
        "initContainers": list(pod.wired.init_containers) if node.container else [],
        "containers": [container(pod, seen)] if node.container else [],
        "volumes": [*volumes, *pod.wired.volumes],
        "nodeSelector": options.placement.node_selector,
        "affinity": affinity(options.placement),
        "tolerations": tolerations(options.tolerations, pinned=node.pinned),
        "hostNetwork": options.host_network or None,
        "dnsPolicy": "ClusterFirstWithHostNet" if options.host_network else None,
        "runtimeClassName": options.runtime_class and str(options.runtime_class),
        **service_account(options.service_account and str(options.service_account)),
        "terminationGracePeriodSeconds": grace_seconds(options),
    }
    return drop_empty(made | dict(pod.wired.pod))


def container(pod: NodePod, volume_mounts: Sequence[Object]) -> Object:
    """Return the node's one container."""
    node, options, command = pod.node, pod.node.options, pod.command
    defaults = ros_variables(
        pod.release, namespace=ros_namespace(node), host_network=options.host_network
    )
    own = {**pod.wired.env, **pod.way.env, **list_variables(node.key, options)}
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
            **probes(readiness_of(pod.release, options.readiness), list_probe_words(pod)),
            "lifecycle": stop_hook(grace_seconds(options)),
            "volumeMounts": list(volume_mounts),
        }
    )


def list_probe_words(pod: NodePod) -> tuple[str, ...]:
    """Return what the readiness probe of a node checks: the network, then scripts next to it."""
    options = pod.node.options
    waited_for = {
        "--transitions": bool(options.lifecycle and options.lifecycle.start),
        "--components": bool(options.components),
    }
    name = full_name(pod.node.key, options)
    beside = (word for option, on in waited_for.items() if on for word in (option, name))
    return (*pod.plan.ros.probe(pod.plan), *pod.way.probe, *beside)


def grace_seconds(options: NodeOptions) -> int | None:
    """Return how long the pod may take to end, None for Kubernetes' 30 s."""
    grace = options.termination_grace_period
    return None if grace is None else max(1, round(grace.seconds))


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


def parameters_hash(command: Command) -> dict[str, str]:
    """Return the annotation that makes changed parameters start a new pod."""
    if not command.files:
        return {}
    text = json.dumps(command.files, sort_keys=True)
    return {PARAMETERS_ANNOTATION: hashlib.sha256(text.encode()).hexdigest()[:16]}


def port_entry(port: Port | PortOptions, *, service: bool) -> Object:
    """Return the container's side of a port, or the Service's; Kubernetes needs names for two."""
    port = port if isinstance(port, PortOptions) else PortOptions(port=port)
    name = str(port.name or f"{port.protocol.lower()}-{int(port.port)}")
    own = {"containerPort": int(port.port)}
    if service:
        own = {"port": int(port.service_port or port.port), "targetPort": int(port.port)}
    return {"name": name, **own, "protocol": port.protocol}
