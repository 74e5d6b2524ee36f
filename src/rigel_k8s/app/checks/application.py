"""What is wrong with a job's options beyond the form of single values; pure.

Each check yields Problems with paths into the options. A job may describe only a part of a release:
options that its last revision may have are not required.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterator, Mapping
from datetime import date
from typing import Any

import attrs

from rigel_k8s.app.application import (
    APP_CONTAINER,
    application_options,
    has_application,
    replaces_container,
)
from rigel_k8s.app.checks.commands import check_line, check_probe
from rigel_k8s.app.checks.contradictions import check_contradictions
from rigel_k8s.app.checks.network import check_network, check_network_policy
from rigel_k8s.app.checks.nodes import check_node
from rigel_k8s.app.checks.patches import check_patch
from rigel_k8s.app.checks.pods import check_pods, group_nodes, name_obstacle, pod_names
from rigel_k8s.app.checks.security import check_security
from rigel_k8s.app.generation import Generation, generation_of
from rigel_k8s.app.layer import NOT_BUILT, choose_layer, pods_name
from rigel_k8s.app.nodes import NODE_CONTAINER
from rigel_k8s.app.options import OrchestrationOptions
from rigel_k8s.app.programs import full_name
from rigel_k8s.app.recording import VOLUME, find_faults, is_recorder
from rigel_k8s.app.updating import (
    OnRequest,
    is_rolling,
    requests_hand_over,
    share,
)
from rigel_k8s.network.modes import mode_of
from rigel_k8s.objects.naming import object_name
from rigel_k8s.objects.overlay import containers_of
from rigel_k8s.objects.podoptions import Readiness, RollingUpdate
from rigel_k8s.objects.pods import GATE_CONTAINER, MASTER_CONTAINER
from rigel_k8s.objects.resources import explain_few_bytes
from rigel_k8s.observability.checks import check as check_stack
from rigel_k8s.observability.names import EXPORTER
from rigel_k8s.option_text import has_template
from rigel_k8s.problems import Path, Problem, Severity
from rigel_k8s.ros import CURRENT, find_end, guess_distro
from rigel_rmw import libraries

#: The volumes that rigel adds to pods.
OWN_VOLUMES = re.compile(r"rigel-.*|(n\d+-)?((volume|device|files)-\d+|rigel-parameters)")
SIDECARS = (
    "a pod of ROS 2 or DDS has one container: only that one gets the network's interface, domain"
    " and peers, is probed, counted in the graph and stopped cleanly; make the other one a node of"
    " `nodes`, or set allow_sidecars: true if it does not use DDS"
)


def check(options: OrchestrationOptions, distro: str) -> Iterator[Problem]:
    """Yield what is wrong, and what works differently than it looks."""
    ros = generation_of(distro, options.ros)
    if options.ros is None:
        yield from check_distro(distro, date.today())
    yield from check_version(options, ros, distro)
    yield from ros.check(options)
    yield from check_network(options, ros, distro)
    yield from check_contradictions(options, ros, distro)
    yield from check_security(options)
    yield from check_network_policy(options)
    yield from check_shared_names(options, ros, distro)
    yield from check_volumes(options)
    yield from check_pods(options, ros)
    yield from check_hand_over(options, ros, distro)
    yield from check_own_probes(("readiness",), options.readiness)
    if isinstance(options.readiness, Readiness) and options.readiness.rates:
        message = "rates are those of a node: set `readiness: {rates: ...}` at one of `nodes`"
        yield Problem(("readiness", "rates"), message, "no-application", at_key=True)
    yield from check_update(("rolling_update",), options.rolling_update, ros, anonymous=False)
    yield from check_rollback(options, ros)
    yield from check_expectations(options, ros)
    if options.update and not (ros.rmw and options.rmw_layer):
        message = "only nodes of ROS 2 with `rmw_layer` count their goals: remove it"
        yield Problem(("update",), message, "not-measured", at_key=True)
    params = options.additional_k8s_params
    yield from check_patch(("additional_k8s_params", "ros_master"), params.ros_master)
    yield from check_patch(("additional_k8s_params", "application"), params.application)
    yield from check_application_only(options)
    yield from check_containers(options, ros)
    yield from check_observability(options, ros)
    yield from check_faults(options, ros)
    for key, node in options.nodes.items():
        path = ("nodes", str(key))
        problems = [
            *check_node(str(key), options, ros),
            *check_update(("update",), node.update, ros.of_node(node), anonymous=node.anonymous),
            *check_own_probes(("readiness",), node.readiness),
            *check_patch(("patch",), node.patch, "Job" if node.kind else "Deployment"),
        ]
        yield from (problem.under(path) for problem in problems)


def check_distro(distro: str, today: date) -> Iterator[Problem]:
    """Yield a distribution that is past its end, or probably misspelt; one's own is no error."""
    if end := find_end(distro, today):
        newer = CURRENT if generation_of(distro).dds else "noetic"
        message = (
            f"application.distro: support for {distro} ended on {end}: it gets no security updates,"
            f" and its packages disappear; move to {newer}"
        )
        yield Problem((), message, "ended-distro", severity="warning")
    if name := guess_distro(distro):
        message = (
            f'application.distro: unknown distro "{distro}", did you mean "{name}"?'
            " (treated as a ROS 1 of your own)"
        )
        yield Problem((), message, "unknown-distro", severity="warning")


def check_version(options: OrchestrationOptions, ros: Generation, distro: str) -> Iterator[Problem]:
    """Yield that src.plugin's `ros_version` contradicts the distribution."""
    if options.ros_version not in (None, f"ros{ros.name}"):
        message = (
            f"application.distro is {distro}, and this is {ros.title}: change one of them, or"
            " remove ros_version"
        )
        yield Problem(("ros_version",), message, "conflict")


def check_shared_names(
    options: OrchestrationOptions, ros: Generation, distro: str
) -> Iterator[Problem]:
    """Yield names that two things would share: Kubernetes names, and ROS names."""
    taken = {one.identity.name: one.title for one in ros.companions(options, distro)}
    if has_application(options):
        taken[str(options.deployment_name)] = "the application"
    if options.observability.exporter is not None:
        taken[EXPORTER] = "the exporter of ros_metrics"
    workloads = [object_name(node.pod or key) for key, node in options.nodes.items()]
    if options.network is not None:
        names = [*workloads, str(options.deployment_name)]
        mode = mode_of(options.network)
        services = mode.services(str(options.deployment_name), options.network, names)
        taken |= dict.fromkeys(services, f"a Service of mode {mode.name}")
    if ros.rmw:
        owners = {pods_name(name): name for name in workloads}
        taken |= {name: f'the Service of the pods of "{key}"' for name, key in owners.items()}
    pods = pod_names(options)
    for key, node in options.nodes.items():
        if node.pod and object_name(node.pod) in taken:
            owner = taken[object_name(node.pod)]
            message = f"it is the name of {owner} on Kubernetes: choose another one"
            yield Problem(("nodes", str(key), "pod"), message, "name-taken", at_key=True)
    ros_names: dict[str, list[str]] = defaultdict(list)
    for key, node in options.nodes.items():
        name, path = object_name(key), ("nodes", str(key))
        if name in pods:
            message = f'"{key}" has the name of {pods[name]} on Kubernetes: choose another one'
            yield Problem(path, message, "name-taken", at_key=True)
        if name in taken:
            message = f'"{key}" becomes "{name}" on Kubernetes, which is the name of {taken[name]};'
            yield Problem(path, f"{message} choose another key", "name-taken", at_key=True)
        taken.setdefault(name, f'"{key}"')
        if ros.of_node(node).nodes and not node.anonymous and not node.launch:
            ros_names[full_name(key, node)].append(str(key))
        for name, component in node.components.items():
            ros_names[component.full_name(name)].append(str(key))
    for name, keys in ros_names.items():
        for key in (key for key in keys if key != keys[0]):
            message = f'"{keys[0]}" already has the ROS name {name}; ROS allows one node of a name'
            yield Problem(("nodes", key), message, "name-taken", at_key=True)


def check_volumes(options: OrchestrationOptions) -> Iterator[Problem]:
    names: set[str] = set()
    for index, volume in enumerate(options.persistent_storage.volumes):
        path = ("persistent_storage", "volumes", index, "name")
        if OWN_VOLUMES.fullmatch(volume.name):
            message = f'rigel itself has a volume "{volume.name}" in each pod: choose another name'
            yield Problem(path, message, "name-taken")
        if volume.name in names:
            yield Problem(path, f'the volume "{volume.name}" already exists', "name-taken")
        names.add(volume.name)
        if problem := explain_few_bytes(volume.size):
            yield Problem((*path[:-1], "size"), problem, "bad-quantity")
        in_fleet = has_template(str(options.namespace or ""))
        if volume.host_path and in_fleet and not has_template(volume.name):
            instead = f'write "{volume.name}-{{{{ data.robot }}}}"'
            if volume.name == VOLUME and any(
                is_recorder(one.args) for one in options.nodes.values()
            ):
                instead = "leave `host_path` of `record` out"
            message = (
                f"{volume.name}-pv belongs to the whole cluster, so one robot of a fleet gets it"
            )
            yield Problem(path, f"{message}: {instead}", "name-taken", severity="warning")


def check_update(
    path: Path, update: RollingUpdate | None, ros: Generation, *, anonymous: bool
) -> Iterator[Problem]:
    """Yield numbers that Kubernetes refuses, and what surge does to nodes of one name."""
    if update is None:
        return
    numbers = {"max_surge": update.max_surge, "max_unavailable": update.max_unavailable}
    if not is_rolling(update) and any(value is not None for value in numbers.values()):
        given = next(key for key, value in numbers.items() if value is not None)
        kept = update.strategy or "Recreate"
        message = f"{kept} has no {given}: remove it, or set strategy: Rolling"
        yield Problem((*path, given), message, "bad-update", at_key=True)
    elif is_rolling(update):
        surge, missing = share(update.max_surge, 1), share(update.max_unavailable, 0)
        if {surge, missing} <= {0, "0%"}:
            message = "max_surge and max_unavailable are both 0: no pod could be replaced"
            yield Problem(path, message, "bad-update")
        elif not anonymous and ros.surge:
            yield Problem(path, ros.surge, "surge", severity="warning", at_key=True)
    for key in ("drain", "warm"):
        if getattr(update, key) and not ros.rmw:
            message = f"only nodes of ROS 2 have `{key}`: remove it"
            yield Problem((*path, key), message, "bad-update", at_key=True)
        elif getattr(update, key) and (update.strategy or "handover").lower() != "handover":
            message = f"{update.strategy} has no {key}: remove it, or set strategy: HandOver"
            yield Problem((*path, key), message, "bad-update", at_key=True)


def check_hand_over(
    options: OrchestrationOptions, ros: Generation, distro: str
) -> Iterator[Problem]:
    """Yield updates that should hand over but cannot."""
    if ros.rmw and options.rmw_layer and not libraries():
        message = f"{NOT_BUILT}: its nodes stop for their updates; install rigel-k8s from PyPI"
        yield Problem((), message, "no-layer", severity="warning")
    volumes = {str(volume.name): volume for volume in options.persistent_storage.volumes}
    nodes = {str(key): choose_layer(node, options) for key, node in options.nodes.items()}
    obstacles = {
        key: ros.of_node(node).find_obstacle(node, volumes, options.network, options.middleware)
        for key, node in nodes.items()
    }
    asks = (key for key, node in nodes.items() if not (node.anonymous or node.update or node.kind))
    if key := next((key for key in asks if isinstance(obstacles[key], OnRequest)), None):
        message = (
            f"its update stops it, since {obstacles[key]}: set `update: {{strategy: HandOver}}` to"
            " have it all the same, or {strategy: Recreate}"
        )
        yield Problem(("nodes", key), message, "hand-over", severity="warning", at_key=True)
    groups = group_nodes(options)
    for key, node in nodes.items():
        own = ros.of_node(node)
        refusal = own.refuse_hand_over(options, distro)
        together = groups[str(node.pod)] if node.pod else [key]
        obstacle = name_obstacle({one: obstacles[one] for one in together}, key)
        if node.anonymous:
            obstacle = "its ROS name differs in each pod"
        for problem in check_way(node.update, own, refusal or obstacle):
            yield problem.under(("nodes", key, "update"))
    refusal = ros.refuse_hand_over(options, distro)
    application = choose_layer(application_options(options), options)
    obstacle = ros.find_obstacle(application, volumes, options.network, options.middleware)
    if not ros.hands_over:
        obstacle = f"in {ros.title} it needs another command line: make it one of `nodes`"
    for problem in check_way(options.rolling_update, ros, refusal or obstacle):
        yield problem.under(("rolling_update",))


def check_way(
    update: RollingUpdate | None, ros: Generation, obstacle: str | None
) -> Iterator[Problem]:
    """Yield why an update cannot hand over; paths are its own."""
    if update is not None and requests_hand_over(update) and obstacle:
        message = f"HandOver is not possible: {obstacle}"
        yield Problem(("strategy",), message, "hand-over", at_key=True)
    elif update is not None and update.strategy is None and obstacle and ros.rmw:
        for key in ("drain", "warm"):
            if getattr(update, key):
                message = f"`{key}` has no effect, since HandOver is not possible: {obstacle}"
                yield Problem((key,), message, "hand-over", at_key=True)


def check_rollback(options: OrchestrationOptions, ros: Generation) -> Iterator[Problem]:
    """Yield a rollback that never happens."""
    rollback = options.rollback_on
    if rollback is None:
        return
    strict = any(one.otherwise == "rollback" for one in options.expect.values())
    if rollback.within is not None and not rollback.graph_worse and not strict:
        message = "`within` has no effect without graph_worse: add graph_worse: true"
        yield Problem(("rollback_on", "within"), message, "incomplete", at_key=True)
    if rollback.graph_worse and ros.dds and ros.explain_unseen(options):
        message = "without `rmw_layer` the graph of zenoh cannot be read: remove graph_worse"
        yield Problem(("rollback_on", "graph_worse"), message, "no-graph", at_key=True)


def check_expectations(options: OrchestrationOptions, ros: Generation) -> Iterator[Problem]:
    """Yield what is expected and never measured, and a rollback that never happens."""
    unseen = ros.explain_unseen(options) if ros.dds else None
    for topic, one in options.expect.items():
        for key in ("gap", "age"):
            if getattr(one, key) is not None and not ros.rmw:
                message = f"`{key}` is measured in ROS 2 only: remove it"
                yield Problem(("expect", str(topic), key), message, "not-measured", at_key=True)
        if one.otherwise == "rollback" and unseen:
            message = "without `rmw_layer` the graph of zenoh cannot be read: remove `else`"
            yield Problem(("expect", str(topic), "else"), message, "no-graph", at_key=True)


def check_own_probes(path: Path, readiness: Readiness | str | None) -> Iterator[Problem]:
    """Yield checks that contradict each other or cannot be read."""
    if not isinstance(readiness, Readiness):
        return
    given = [*readiness.own_checks, *(["rates"] if readiness.rates else [])]
    if len(given) > 1:
        message = f"a {given[0]} and a {given[-1]}: remove one"
        yield Problem((*path, given[-1]), message, "conflict", at_key=True)
    if readiness.command is not None:
        yield from check_line((*path, "command"), readiness.command)
        yield from check_probe((*path, "command"), readiness.command)


def check_application_only(options: OrchestrationOptions) -> Iterator[Problem]:
    """Yield options about the application's Deployment in a job that has only nodes."""
    if not options.nodes or options.application_image:
        return
    params = options.additional_k8s_params.application
    if params and not any(one.get("image") for one in containers_of(params)):
        message = (
            "this makes one more Deployment, of the distribution's image: change a node with its"
            " `patch`, or set application_image"
        )
        path = ("additional_k8s_params", "application")
        yield Problem(path, message, "no-application", severity="warning", at_key=True)
    if has_application(options):
        return
    if options.results:
        message = "results are copied out of the application, but this job has only `nodes`"
        yield Problem(("results",), message, "no-application", at_key=True)
    readiness = options.readiness
    limits = isinstance(readiness, Readiness) and readiness.timeout_seconds is not None
    unused = {
        "readiness": "readiness" if readiness is not None and not limits else None,
        "rolling_update": "update" if options.rolling_update is not None else None,
        "distributed": "placement" if options.distributed.enabled else None,
    }
    for key, own in unused.items():
        if own:
            message = f"`{key}` has no effect on `nodes`: set `{own}` at each node"
            yield Problem((key,), message, "no-application", severity="warning", at_key=True)


def check_containers(options: OrchestrationOptions, ros: Generation) -> Iterator[Problem]:
    """Yield containers that a patch adds: those without an image, and any beside DDS."""
    params = options.additional_k8s_params
    groups = {pod: [*map(object_name, keys)] for pod, keys in group_nodes(options).items()}
    own = [] if replaces_container(options) else [APP_CONTAINER]
    master = [MASTER_CONTAINER, GATE_CONTAINER]
    written: list[tuple[Path, Mapping[str, Any], list[str], bool]] = [
        (("additional_k8s_params", "ros_master"), params.ros_master, master, False),
        (("additional_k8s_params", "application"), params.application, own, ros.dds),
        *(
            (
                ("nodes", str(key), "patch"),
                node.patch,
                groups[str(node.pod)] if node.pod else [NODE_CONTAINER],
                ros.dds and node.ros is None,
            )
            for key, node in options.nodes.items()
        ),
    ]
    for path, patch, first, dds in written:
        found = {str(one["name"]): one for one in containers_of(patch) if "name" in one}
        extra = [name for name in found if name not in first][0 if first else 1 :]
        place = (*path, "spec", "template", "spec", "containers")
        if bare := [name for name in extra if first and not found[name].get("image")]:
            message = (
                f"{', '.join(bare)}: a container needs an `image`; {first[0]} is there already"
            )
            yield Problem(place, message, "missing-image", at_key=True)
        elif extra and dds and not options.allow_sidecars:
            message = f"{', '.join(extra)}: {SIDECARS}"
            yield Problem(place, message, "sidecar", at_key=True)


def check_faults(options: OrchestrationOptions, ros: Generation) -> Iterator[Problem]:
    """Yield faults around which bags are to be kept, and that no exporter sees."""
    for key, node in options.nodes.items():
        faults, path = find_faults(node.args), ("nodes", str(key))
        if faults and (not options.observability.exporter or ros.explain_unseen(options)):
            message = "the exporter sees the faults of `on`: set `observability: {enabled: true}`"
            yield Problem(path, message, "no-ros-metrics")
        if "breach" in faults and not options.expect:
            message = "`on: [breach]` needs topics in `expect`, which `rigel expect learn` proposes"
            yield Problem(path, message, "no-expect")


def check_observability(options: OrchestrationOptions, ros: Generation) -> Iterator[Problem]:
    """Yield what is wrong with the stack and the exporter that the job requests."""
    stack = options.observability
    if options.observability_only:
        stack = attrs.evolve(stack, enabled=True)
    yield from (problem.under(("observability",)) for problem in check_stack(stack))
    if options.observability.exporter and (why := ros.explain_unseen(options)):
        chosen = bool(options.observability.ros_metrics)
        path: Path = ("observability", "ros_metrics") if chosen else ("observability",)
        severity: Severity = "error" if chosen else "warning"
        yield Problem(path, why, "no-ros-metrics", severity=severity, at_key=True)
