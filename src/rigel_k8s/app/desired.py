"""Everything that a job deploys: options in, Desired out; pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.app.application import application_deployment, application_identity, has_application
from rigel_k8s.app.binding import bind_to_master, bind_to_parameters
from rigel_k8s.app.checks.exporter import can_be_seen
from rigel_k8s.app.distros import ros_of
from rigel_k8s.app.gate import gate_objects, has_gate, remedies_of
from rigel_k8s.app.globalparameters import list_keys, setter_identity, setter_objects
from rigel_k8s.app.master import master_deployment, master_service
from rigel_k8s.app.networkpolicy.objects import policy_objects
from rigel_k8s.app.nodes import RosNode, node_objects, plan_of
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.app.partial import flat
from rigel_k8s.app.placing import remote_selector
from rigel_k8s.app.programs import program, takes_ros_arguments
from rigel_k8s.app.security.restricted import restrict
from rigel_k8s.app.storage import storage
from rigel_k8s.network.modes import network_objects, wire_pod
from rigel_k8s.network.plan import network_plan
from rigel_k8s.network.readiness import ready_words
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity
from rigel_k8s.objects.images import add_pull_secrets, images_of, pin_images
from rigel_k8s.objects.naming import Ros
from rigel_k8s.objects.pods import (
    MASTER_NAME,
    MASTER_PORT,
    MASTER_URI,
    Object,
    scripts_config,
)
from rigel_k8s.objects.refs import Manifest, ObjectRef, ref_of
from rigel_k8s.objects.steady import steady
from rigel_k8s.objects.tolerations import tolerations
from rigel_k8s.objects.workloads import ReleaseContext, config_map
from rigel_k8s.observability.exporter import WatchedGraph, exporter_identity, exporter_objects
from rigel_k8s.observability.names import EXPORTER
from rigel_k8s.observability.options import RosMetrics
from rigel_k8s.problems import Path
from rigel_k8s.release.types import Desired, ReleaseId
from rigel_k8s.settings import Application

#: The node that each roscore has.
ROSOUT = "/rosout"

#: What to do if a right is missing, by the kind of object; if the cluster refuses pods, by the
#: reason of the refusal.
REMEDIES = {
    "PersistentVolume": "`host_path` in `persistent_storage` makes a PersistentVolume, which no"
    " Role in a namespace covers: ask an administrator for a ClusterRole, or set `host_path` in the"
    " node's own `volumes` instead, which needs no right",
    "pod-security": "set `security: restricted` for pods that every namespace accepts; see their"
    " requests with `rigel render`",
    "quota": "request less (`resources`, `replicas`), or let an administrator raise the quota",
    "no-resources": "set `resources` of each node: the quota needs them",
    "limit-range": "set `resources` within the limits of the namespace: `kubectl describe limits`",
    "architecture": "build it for them too (`platforms` of a build job), or choose other machines"
    " with `placement`",
    "policy": "change what the policy names, or ask its author",
    "no-machine": "or change its `placement`",
    "taint": "or set `tolerations` of the node",
    "no-room": "request less (`resources`), or let it run elsewhere (`placement`)",
    "missing-object": "create it first, or correct its name",
    "no-image": "push it, or correct its name",
}

#: The texts of parameter files, by the names that the Rigelfile gives them.
Files = Mapping[str, str]
Traced = Iterator[tuple[Path, Object]]


def has_workloads(options: OrchestrationOptions) -> bool:
    """Return whether the job runs anything."""
    return bool(options.nodes or has_application(options) or options.deploy_ros_master)


def deploys_master(options: OrchestrationOptions, ros: Ros) -> bool:
    """Return whether the release has a roscore of its own; only ROS 1 has a master."""
    if ros != "1":
        return False
    if options.deploy_ros_master is None:
        return options.ros_master_uri is None and has_workloads(options)
    return options.deploy_ros_master


def master_uri(options: OrchestrationOptions, ros: Ros) -> str | None:
    """Return the ROS_MASTER_URI of all nodes; an image may start roscore itself."""
    if ros != "1":
        return None
    if options.ros_master_uri:
        return str(options.ros_master_uri)
    return MASTER_URI if deploys_master(options, ros) else f"http://localhost:{MASTER_PORT}"


def draft(
    options: OrchestrationOptions,
    release: ReleaseId,
    application: Application,
    scripts: Mapping[str, str],
    *,
    files: Files | None = None,
    program: Mapping[str, str] | None = None,
    previous: Sequence[Manifest] = (),
) -> Draft:
    """Return the release that the options describe.

    Args:
        scripts: the in-pod scripts, name to text.
        files: the texts of the nodes' parameter files.
        program: the gate's files, name to text.
        previous: the objects of the last revision, which have the addresses in use.
    """
    ros = ros_of(application.distro, options.ros)
    gate = deploys_master(options, ros) and has_gate(options, application.distro)
    around = ReleaseContext(
        namespace=release.namespace,
        release=release.name,
        master_uri=master_uri(options, ros),
        distro=application.distro,
        ros=ros,
        pull_secrets=tuple(map(str, options.image_pull_secrets)),
        gate=gate,
    )
    own = Parts(options, around, files or {})
    made = secure(objects(own, own.plan(previous), scripts, program or {}), own)
    return Draft(release, tuple((path, steady(item)) for path, item in made))


@attrs.frozen
class Draft:
    """A release before the digests of its images and its pull secrets are known.

    Attributes:
        traced: its objects, each with the path of the options that it comes from.
    """

    release: ReleaseId
    traced: Sequence[tuple[Path, Object]]

    @property
    def objects(self) -> tuple[Object, ...]:
        """Its objects."""
        return tuple(item for _, item in self.traced)

    @property
    def images(self) -> tuple[str, ...]:
        """The images of all its workloads, each once."""
        return images_of(self.objects)

    def finish(
        self,
        *,
        raw: Mapping[str, Any] | None = None,
        digests: Mapping[str, str] | None = None,
        pull_secrets: Sequence[str] = (),
        create_namespace: bool = False,
    ) -> Desired:
        """Return the release as it should be on the cluster.

        Args:
            raw: the options as plain data, kept in the revision.
            digests: image reference to the same with its digest, for those that are known.
            pull_secrets: further Secrets with registry credentials.
        """
        final = [
            add_pull_secrets(pin_images(item, digests or {}), pull_secrets) for item in self.objects
        ]
        return Desired(
            release=self.release,
            objects=tuple(bind_to_parameters([*bind_to_master(final)])),
            origins={ref_of(item): path for path, item in self.traced},
            options=options_to_keep(raw or {}),
            create_namespace=create_namespace,
            protected=frozenset(list_protected(self.objects)),
            remedies={**REMEDIES, **remedies_of(self.objects)},
        )


@attrs.frozen
class Parts:
    """The workloads of a release before they are manifests."""

    options: OrchestrationOptions
    around: ReleaseContext
    files: Files

    @property
    def has_master(self) -> bool:
        """Whether there is a roscore."""
        return deploys_master(self.options, self.around.ros)

    @property
    def master(self) -> PodIdentity:
        """The identity of roscore on the network."""
        image = self.options.ros_master_image or self.around.default_image
        return PodIdentity(MASTER_NAME, str(image), ROSOUT)

    def nodes(self) -> Iterator[RosNode]:
        """Yield the nodes."""
        volumes = {str(v.name): v for v in self.options.persistent_storage.volumes}
        for key, node in self.options.nodes.items():
            image = str(node.image or self.options.image)
            yield RosNode(str(key), node, image, self.files, volumes)

    @property
    def exporter(self) -> RosMetrics | None:
        """What the exporter should do; None without one, or if it could see nothing."""
        found = self.options.observability.exporter
        seen = has_workloads(self.options) and can_be_seen(self.options, self.around.ros)
        return found if seen else None

    @property
    def setter(self) -> PodIdentity | None:
        """The identity of the setter of global parameters; None without one."""
        if self.around.ros != "1" or not list_keys(self.options):
            return None
        return setter_identity(self.around, self.options)

    def identities(self) -> Iterator[PodIdentity]:
        """Yield the identities of all workloads on the network."""
        if self.has_master:
            yield self.master
        if self.setter:
            yield self.setter
        if has_application(self.options):
            yield application_identity(self.around, self.options)
        yield from (node.identity for node in self.nodes())

    def plan(self, previous: Sequence[Manifest]) -> NetworkPlan:
        """Return the network of all of them.

        The exporter connects to the others, never they to it; but it has an address of its own.
        """
        network = self.options.network
        static = network is not None and network.ipam == "static"
        watching = [exporter_identity(self.exporter)] if static and self.exporter else []
        return network_plan(
            network,
            namespace=self.around.namespace,
            release=self.around.release,
            ros=self.around.ros,
            distro=self.around.distro,
            middleware=self.options.middleware,
            pods=(*self.identities(), *watching),
            previous=previous,
            pull_secrets=self.around.pull_secrets,
        )


def objects(
    own: Parts, plan: NetworkPlan, scripts: Mapping[str, str], program: Mapping[str, str]
) -> Traced:
    """Yield every object with the path of the options that it comes from."""
    options, around = own.options, own.around
    if has_workloads(options):
        name = scripts_config(around.release)
        yield (), config_map(around, name, scripts, part_of=around.release)
        yield from network_objects(plan)
    if options.network_policy and has_workloads(options):
        watched = own.exporter is not None
        for item in policy_objects(around, options.network_policy, exporter=watched):
            yield ("network_policy",), item
    volumes = options.persistent_storage.volumes
    for index, item in storage(volumes, around.namespace, around.release):
        yield ("persistent_storage", "volumes", index), item
    if own.has_master:
        params = options.additional_k8s_params.ros_master
        wired = wire_pod(plan, own.master)
        if around.gate:
            for item in gate_objects(around, program):
                yield ("gate",), item
        selector = options.ros_master_placement.node_selector
        master = master_deployment(around, own.master.image, params, wired, selector)
        yield ("deploy_ros_master",), master_service(around, master)
        yield ("deploy_ros_master",), master
    if own.setter:
        wired = wire_pod(plan, own.setter)
        for item in setter_objects(around, options, own.files, wired, placement(options)):
            yield (list_keys(options)[0],), item
    if has_application(options):
        path = "application_image" if options.application_image else "additional_k8s_params"
        wired = wire_pod(plan, application_identity(around, options))
        yield (path,), application_deployment(around, options, wired, ready_words(plan))
    for node in own.nodes():
        for item in node_objects(around, node, plan):
            yield ("nodes", node.key), item
    if own.exporter:
        for item in exporter_objects(around, own.exporter, graph_of(own, plan), plan):
            yield ("observability",), item


def secure(made: Traced, own: Parts) -> Traced:
    """Yield the objects with what `security` adds to their pods; the exporter's has it already."""
    security = own.options.security
    for path, item in made:
        if security is None or item["metadata"]["name"] == EXPORTER:
            yield path, item
        else:
            yield path, restrict(item, security, own.around.ros)


def graph_of(own: Parts, plan: NetworkPlan) -> WatchedGraph:
    """Return what the exporter should see: the nodes of one domain, and their Deployments."""
    nodes = list(own.nodes())
    domains = {node.key: plan_of(node, plan).domain_id for node in nodes}
    domain = next(iter(domains.values())) if len(set(domains.values())) == 1 else plan.domain_id
    near = [node for node in nodes if domains[node.key] == domain]
    named = {node.ros_name: node for node in near if node.ros_name and own.around.ros != "none"}
    ours = {name: node.name for name, node in named.items() if sets_name(own.around.ros, node)}
    rest = {name: node.name for name, node in named.items() if name not in ours}
    if own.around.ros == "2":  # a nodelet is not a separate node in the graph of ROS 1
        ours |= {
            one.full_name(key): n.name for n in near for key, one in n.options.components.items()
        }
    if own.has_master:
        ours[ROSOUT] = MASTER_NAME
    return WatchedGraph(ours, rest, domain or 0, placement(own.options))


def sets_name(ros: Ros, node: RosNode) -> bool:
    """Return whether a program gets its ROS name here; others may have a name of their own."""
    line = program(ros, node.options)
    return not node.options.launch and takes_ros_arguments(ros, line)


def placement(options: OrchestrationOptions) -> Mapping[str, Any]:
    """Return where the exporter runs: with the nodes, if all are bound to the same machines."""
    chosen = [node.placement.node_selector for node in options.nodes.values()]
    if has_application(options):
        chosen.append(remote_selector(options.distributed))
    if not chosen or not chosen[0] or any(one != chosen[0] for one in chosen):
        return {}
    asked = next(iter(options.nodes.values())).tolerations if options.nodes else []
    return {"nodeSelector": chosen[0], "tolerations": tolerations(asked, pinned=True)}


def list_protected(items: Iterable[Object]) -> Iterator[ObjectRef]:
    """Yield what outlives `down`: claims and volumes."""
    kinds = ("PersistentVolumeClaim", "PersistentVolume")
    return (ref_of(item) for item in items if item["kind"] in kinds)


def options_to_keep(raw: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that a revision keeps: all but a password."""
    result = flat(raw)
    grafana = (result.get("observability") or {}).get("grafana") or {}
    grafana.pop("admin_password", None)
    return result
