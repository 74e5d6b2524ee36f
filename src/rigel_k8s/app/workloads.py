"""The workloads of a release, from the options to their objects: nodes, and what is beside them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import attrs

from rigel_k8s.app.application import (
    APP_CONTAINER,
    application_options,
    has_application,
    replaces_container,
)
from rigel_k8s.app.expectations import describe_all
from rigel_k8s.app.files import list_mounted
from rigel_k8s.app.generation import GENERATIONS, Companion, Generation, Texts
from rigel_k8s.app.layer import choose_layer, pods_name
from rigel_k8s.app.networkpolicy import policy_objects
from rigel_k8s.app.nodes import NODE_CONTAINER, RosNode, keeper_port, plan_of, pod_objects
from rigel_k8s.app.options import NodeOptions, OrchestrationOptions
from rigel_k8s.app.recording import find_faults
from rigel_k8s.app.volumes import storage
from rigel_k8s.network.modes import network_objects, wire_pod
from rigel_k8s.network.plan import network_plan
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity
from rigel_k8s.objects.naming import object_name
from rigel_k8s.objects.pods import Object, drop_empty, scripts_config, tolerations
from rigel_k8s.objects.refs import Manifest
from rigel_k8s.objects.workloads import ReleaseContext, config_map
from rigel_k8s.observability.exporter import WatchedGraph, exporter_identity, exporter_objects
from rigel_k8s.observability.options import RosMetrics
from rigel_k8s.problems import Path

Traced = Iterator[tuple[Path, Object]]


def has_workloads(options: OrchestrationOptions) -> bool:
    """Return whether the job runs anything."""
    return bool(options.nodes or has_application(options) or options.deploy_ros_master)


def keep_apart(node: NodeOptions, options: OrchestrationOptions) -> NodeOptions:
    """Return a node that keeps off the pods of other nodes, whatever these are called."""
    names = {key: other.pod or key for key, other in options.nodes.items()}
    apart = [names.get(key, key) for key in node.placement.apart_from]
    return attrs.evolve(node, placement=attrs.evolve(node.placement, apart_from=apart))


@attrs.frozen
class Workloads:
    """The workloads of a release before they are manifests."""

    options: OrchestrationOptions
    release: ReleaseContext
    texts: Texts

    @property
    def ros(self) -> Generation:
        return GENERATIONS[self.release.ros.name]

    @property
    def companions(self) -> Sequence[Companion]:
        """The workloads beside the nodes."""
        return self.ros.companions(self.options, self.release.distro)

    def nodes(self) -> Iterator[RosNode]:
        """Yield the nodes, src.plugin's one application first."""
        volumes = {str(v.name): v for v in self.options.persistent_storage.volumes}
        if has_application(self.options):
            yield RosNode(
                str(self.options.deployment_name),
                choose_layer(application_options(self.options), self.options),
                self.ros,
                str(self.options.application_image or self.release.default_image),
                volumes=volumes,
                container=None if replaces_container(self.options) else APP_CONTAINER,
                is_application=True,
            )
        for key, node in self.options.nodes.items():
            image = str(node.image or self.options.image)
            ros = self.ros.of_node(node)
            node = keep_apart(choose_layer(node, self.options), self.options)
            container = object_name(str(key)) if node.pod else NODE_CONTAINER
            mounted = tuple(list_mounted(node, self.texts.folders))
            files = self.texts.files
            yield RosNode(str(key), node, ros, image, files, volumes, container, mounted=mounted)

    def pods(self) -> list[list[RosNode]]:
        """Return the nodes by their pods."""
        found: dict[str, list[RosNode]] = {}
        for node in self.nodes():
            own = found.setdefault(node.workload, [])
            own.append(attrs.evolve(node, place=len(own)))
        return list(found.values())

    @property
    def exporter(self) -> RosMetrics | None:
        """What the exporter should do; None without one, or if it could see nothing."""
        unseen = self.ros.explain_unseen(self.options)
        seen = has_workloads(self.options) and unseen is None
        return self.options.observability.exporter if seen else None

    def identities(self) -> Iterator[PodIdentity]:
        """Yield the identities of all workloads on the network."""
        yield from (companion.identity for companion in self.companions)
        yield from (nodes[0].identity for nodes in self.pods())

    def plan(self, previous: Sequence[Manifest]) -> NetworkPlan:
        """Return the network of all of them.

        The exporter connects to the others, never they to it; but it has an address of its own.
        """
        network = self.options.network
        static = network is not None and network.ipam == "static"
        watching = [exporter_identity(self.exporter)] if static and self.exporter else []
        return network_plan(
            network,
            namespace=self.release.namespace,
            release=self.release.release,
            ros=self.release.ros,
            distro=self.release.distro,
            middleware=self.options.middleware,
            pods=(*self.identities(), *watching),
            previous=previous,
            pull_secrets=self.release.pull_secrets,
        )

    def objects(self, plan: NetworkPlan) -> Traced:
        """Yield every object with the path of the options that it comes from."""
        options, release = self.options, self.release
        if has_workloads(options):
            scripts = scripts_config(release.release)
            libraries = self.texts.libraries if any(n.has_layer for n in self.nodes()) else {}
            yield (
                (),
                config_map(
                    release,
                    scripts,
                    self.texts.scripts,
                    part_of=release.release,
                    binary=libraries,
                ),
            )
            yield from network_objects(plan)
        if options.network_policy and has_workloads(options):
            watched = self.exporter is not None
            outside = {n.name: (n.workload, n.options.ports) for n in self.nodes() if n.is_outside}
            for item in policy_objects(
                release, options.network_policy, exporter=watched, outside=outside
            ):
                yield ("network_policy",), item
        volumes = options.persistent_storage.volumes
        for index, item in storage(volumes, release.namespace, release.release):
            yield ("persistent_storage", "volumes", index), item
        for companion in self.companions:
            wired = wire_pod(plan, companion.identity)
            yield from companion.objects(release, self.texts, wired, self.place())
        application = "application_image" if options.application_image else "additional_k8s_params"
        for nodes in self.pods():
            path = (application,) if nodes[0].is_application else ("nodes", nodes[0].key)
            for item in pod_objects(release, nodes, plan):
                yield path, item
        if self.exporter:
            graph = self.watched_graph(plan)
            for item in exporter_objects(release, self.exporter, graph, plan):
                yield ("observability",), item

    def watched_graph(self, plan: NetworkPlan) -> WatchedGraph:
        """Return what the exporter should see: the nodes of one domain, and their Deployments."""
        nodes = [node for node in self.nodes() if node.options.kind != "test"]
        domains = {node.key: plan_of(node, plan).domain_id for node in nodes}
        domain = next(iter(domains.values())) if len(set(domains.values())) == 1 else plan.domain_id
        near = [node for node in nodes if domains[node.key] == domain]
        named = {node.ros_name: node for node in near if node.ros_name}
        lasting = {name for name, one in named.items() if one.sets_name and not one.options.kind}
        ours = {name: named[name].name for name in lasting}
        rest = {name: node.name for name, node in named.items() if name not in ours}
        loading = self.ros.components
        if loading is not None and loading.are_nodes:
            ours |= {
                one.full_name(key): n.name
                for n in near
                for key, one in n.options.components.items()
            }
        ours |= {one.ros_name: one.identity.name for one in self.companions if one.ros_name}
        keepers = [
            f"{pods_name(node.workload)}:{keeper_port(self.release, node, plan)}"
            for node in near
            if self.release.layer and node.has_layer
        ]
        contract = {
            topic: {what: value for what, value in one._asdict().items() if value}
            for topic, one in describe_all(self.options.expect).items()
        }
        asked = any(find_faults(node.options.args) for node in nodes)
        once = tuple(sorted(name for name, one in named.items() if one.options.kind))
        more = (domain or 0, self.place(), tuple(keepers), contract, asked)
        return WatchedGraph(ours, rest, once, *more)

    def place(self) -> Mapping[str, Any]:
        """Return where workloads beside the nodes run: with them, if all are bound to one place."""
        options = self.options
        nodes = [*options.nodes.values()]
        if has_application(options):
            nodes.append(application_options(options))
        chosen = nodes[0].placement.node_selector if nodes else {}
        if not chosen or any(one.placement.node_selector != chosen for one in nodes):
            return {}
        pinned = nodes[0].placement.machine is not None
        asked = tolerations(nodes[0].tolerations, pinned=pinned)
        return drop_empty({"nodeSelector": chosen, "tolerations": asked})
