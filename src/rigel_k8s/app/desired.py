"""Everything that a job deploys: options in, Desired out; pure."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.app.application import (
    APP_CONTAINER,
    application_options,
    has_application,
    remote_selector,
    replaces_container,
)
from rigel_k8s.app.networkpolicy import policy_objects
from rigel_k8s.app.nodes import RosNode, node_objects, plan_of
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.app.partial import flat
from rigel_k8s.app.security import restrict
from rigel_k8s.app.volumes import storage
from rigel_k8s.generation import Companion, Generation, Texts, generation_of
from rigel_k8s.network.modes import network_objects, wire_pod
from rigel_k8s.network.plan import network_plan
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity
from rigel_k8s.objects.images import add_pull_secrets, images_of, pin_images
from rigel_k8s.objects.pods import Object, scripts_config
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
        program: the files of the generation's program, name to text.
        previous: the objects of the last revision, which have the addresses in use.
    """
    ros = generation_of(application.distro, options.ros)
    context = ros.in_context(
        ReleaseContext(
            namespace=release.namespace,
            release=release.name,
            distro=application.distro,
            ros=ros,
            pull_secrets=tuple(map(str, options.image_pull_secrets)),
        ),
        options,
    )
    own = Parts(options, context, Texts(files or {}, program or {}))
    made = secure(objects(own, own.plan(previous), scripts), own)
    return Draft(release, ros, tuple((path, steady(item)) for path, item in made))


@attrs.frozen
class Draft:
    """A release before the digests of its images and its pull secrets are known.

    Attributes:
        traced: its objects, each with the path of the options that it comes from.
    """

    release: ReleaseId
    ros: Generation
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
            objects=tuple(self.ros.bind(final)),
            origins={ref_of(item): path for path, item in self.traced},
            options=options_to_keep(raw or {}),
            create_namespace=create_namespace,
            protected=frozenset(list_protected(self.objects)),
            remedies={**REMEDIES, **self.ros.remedies(self.objects)},
        )


@attrs.frozen
class Parts:
    """The workloads of a release before they are manifests."""

    options: OrchestrationOptions
    context: ReleaseContext
    texts: Texts

    @property
    def companions(self) -> Sequence[Companion]:
        """The workloads beside the nodes."""
        return self.context.ros.companions(self.options, self.context.distro)

    def nodes(self) -> Iterator[RosNode]:
        """Yield the nodes, src.plugin's one application first."""
        volumes = {str(v.name): v for v in self.options.persistent_storage.volumes}
        if has_application(self.options):
            yield RosNode(
                str(self.options.deployment_name),
                application_options(self.options),
                self.context.ros,
                str(self.options.application_image or self.context.default_image),
                volumes=volumes,
                container=None if replaces_container(self.options) else APP_CONTAINER,
                is_application=True,
            )
        for key, node in self.options.nodes.items():
            image = str(node.image or self.options.image)
            ros = self.context.ros.of_node(node)
            yield RosNode(str(key), node, ros, image, self.texts.files, volumes)

    @property
    def exporter(self) -> RosMetrics | None:
        """What the exporter should do; None without one, or if it could see nothing."""
        unseen = self.context.ros.explain_unseen(self.options)
        seen = has_workloads(self.options) and unseen is None
        return self.options.observability.exporter if seen else None

    def identities(self) -> Iterator[PodIdentity]:
        """Yield the identities of all workloads on the network."""
        yield from (companion.identity for companion in self.companions)
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
            namespace=self.context.namespace,
            release=self.context.release,
            ros=self.context.ros,
            distro=self.context.distro,
            middleware=self.options.middleware,
            pods=(*self.identities(), *watching),
            previous=previous,
            pull_secrets=self.context.pull_secrets,
        )


def objects(own: Parts, plan: NetworkPlan, scripts: Mapping[str, str]) -> Traced:
    """Yield every object with the path of the options that it comes from."""
    options, context = own.options, own.context
    if has_workloads(options):
        name = scripts_config(context.release)
        yield (), config_map(context, name, scripts, part_of=context.release)
        yield from network_objects(plan)
    if options.network_policy and has_workloads(options):
        watched = own.exporter is not None
        for item in policy_objects(context, options.network_policy, exporter=watched):
            yield ("network_policy",), item
    volumes = options.persistent_storage.volumes
    for index, item in storage(volumes, context.namespace, context.release):
        yield ("persistent_storage", "volumes", index), item
    for companion in own.companions:
        wired = wire_pod(plan, companion.identity)
        yield from companion.objects(context, own.texts, wired, placement(options))
    application = "application_image" if options.application_image else "additional_k8s_params"
    for node in own.nodes():
        path = (application,) if node.is_application else ("nodes", node.key)
        for item in node_objects(context, node, plan):
            yield path, item
    if own.exporter:
        for item in exporter_objects(context, own.exporter, graph_of(own, plan), plan):
            yield ("observability",), item


def secure(made: Traced, own: Parts) -> Traced:
    """Yield the objects with what `security` adds to their pods; the exporter's has it already."""
    security = own.options.security
    for path, item in made:
        if security is None or item["metadata"]["name"] == EXPORTER:
            yield path, item
        else:
            yield path, restrict(item, security, own.context.ros)


def graph_of(own: Parts, plan: NetworkPlan) -> WatchedGraph:
    """Return what the exporter should see: the nodes of one domain, and their Deployments."""
    nodes = list(own.nodes())
    domains = {node.key: plan_of(node, plan).domain_id for node in nodes}
    domain = next(iter(domains.values())) if len(set(domains.values())) == 1 else plan.domain_id
    near = [node for node in nodes if domains[node.key] == domain]
    named = {node.ros_name: node for node in near if node.ros_name}
    ours = {name: node.name for name, node in named.items() if sets_name(node)}
    rest = {name: node.name for name, node in named.items() if name not in ours}
    loading = own.context.ros.components
    if loading is not None and loading.are_nodes:
        ours |= {
            one.full_name(key): n.name for n in near for key, one in n.options.components.items()
        }
    ours |= {one.ros_name: one.identity.name for one in own.companions if one.ros_name}
    return WatchedGraph(ours, rest, domain or 0, placement(own.options))


def sets_name(node: RosNode) -> bool:
    """Return whether a program gets its ROS name here; others may have a name of their own."""
    return not node.options.launch and node.ros.takes_arguments(node.ros.program(node.options))


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
