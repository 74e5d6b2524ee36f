"""What a user gives against what `rigel` itself sets: variables, and arguments that name a node.

A user's own value wins, so one that defeats the network, the master or the names would do so
without a word. RULES and NAMING are the whole table: what a variable or an argument contradicts,
and what to write instead.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from ipaddress import ip_address
from pathlib import PurePosixPath
from typing import Any

import attrs

from rigel_k8s.app.application import APP_CONTAINER, application_options, has_application
from rigel_k8s.app.environment import entries
from rigel_k8s.app.generation import Generation
from rigel_k8s.app.nodes import NODE_CONTAINER
from rigel_k8s.app.options import NodeOptions, OrchestrationOptions
from rigel_k8s.app.programs import SHELLS, full_name
from rigel_k8s.network.checks import LAST_DOMAIN
from rigel_k8s.network.dds import NEW_VARIABLE, OLD_VARIABLE
from rigel_k8s.network.mode import Mode
from rigel_k8s.network.modes import BEFORE_IRON, mode_of, wire_pod
from rigel_k8s.network.options import MIDDLEWARE, ZENOH_PORT, Network, middleware_name
from rigel_k8s.network.plan import domain
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity
from rigel_k8s.objects.naming import object_name, ros_name
from rigel_k8s.objects.overlay import containers_of, list_mappings
from rigel_k8s.objects.scalars import RosUri
from rigel_k8s.option_text import has_template
from rigel_k8s.problems import Path, Problem, Severity
from rigel_k8s.ros import ROS_ARGS, ROS_ARGS_END

KIND = "contradiction"
DOMAIN = "ROS_DOMAIN_ID"
#: Domains as rcl reads them; it takes 010 for 8, and 0x2a for 42.
DECIMAL = re.compile(r"0|[1-9]\d{0,2}")
#: What Kubernetes, a shell or substitution args fill in.
FILLED_IN = re.compile(r"[$`]")
#: A server of Fast DDS, or zenoh's endpoints, in a variable.
ENDPOINTS = "connect/endpoints"


@attrs.frozen
class Flaw:
    """What is wrong with a value."""

    message: str
    severity: Severity = "error"


@attrs.frozen
class Given:
    """A variable that a user sets.

    Attributes:
        value: None if only the container has it: another variable, a ConfigMap, a field.
        path: its place in the options.
        at_key: the place to show is the key.
    """

    name: str
    value: str | None
    path: Path
    at_key: bool = False


@attrs.frozen
class Release:
    """What rigel sets for the nodes of a job.

    Attributes:
        pods: how many pods there are, roscore not counted.
        domains: those that nodes of ROS 2 set themselves, as written; None: they set none.
        master: the ROS_MASTER_URI of all nodes.
    """

    options: OrchestrationOptions
    distro: str
    pods: int
    domains: Sequence[str | None]
    master: str

    @property
    def network(self) -> Network | None:
        """The job's network."""
        return self.options.network

    @property
    def mode(self) -> Mode:
        return mode_of(self.network)

    @property
    def middleware(self) -> str | None:
        """The middleware that is configured, None for all of them."""
        return self.options.middleware or self.mode.middleware


@attrs.frozen
class Subject:
    """A node, or the one application, among what is set for it.

    Attributes:
        key: its key in `nodes`; None: it is the application, which has no ROS name.
        container: the name of its container, for which a patch may set variables.
        patch: the place of its patch.
    """

    key: str | None
    node: NodeOptions
    ros: Generation
    release: Release
    container: str
    path: Path
    patch: Path

    @property
    def on_machine(self) -> bool:
        """Whether it has its machine's own network."""
        return self.node.host_network or self.release.mode.in_machine_network

    @property
    def ros_name(self) -> str | None:
        """The full name by which the node is looked for; None: it may have any."""
        if self.key is None or self.node.anonymous or self.node.launch:
            return None
        return full_name(self.key, self.node)


Rule = Callable[[Subject, str | None], Flaw | None]


def check_contradictions(
    options: OrchestrationOptions, ros: Generation, distro: str
) -> Iterator[Problem]:
    """Yield variables and arguments that contradict the job, with paths from its root."""
    from rigel_k8s.app.generations.ros1.master import master_uri

    nodes = {str(key): node for key, node in options.nodes.items()}
    own = [node for node in nodes.values() if ros.of_node(node).rmw]
    domains = [dict(literals(node)).get(DOMAIN) for node in own]
    pods = len({node.pod or key for key, node in nodes.items()}) + int(has_application(options))
    pods += sum(int(node.replicas) - 1 for node in nodes.values() if node.replicas)
    release = Release(options, distro, pods, domains, "" if ros.dds else master_uri(options))
    subjects = list(subjects_of(options, ros, release))
    apart = pods > 1 and not all(subject.on_machine for subject in subjects)
    if apart and options.ros_master_uri and is_local(find_host(options.ros_master_uri)):
        message = "each pod would look for a master in itself: write the address of its machine"
        yield Problem(("ros_master_uri",), message, KIND)
    for subject in subjects:
        rules = RULES.get(subject.ros.name, {})
        for given in list_given(subject):
            flaw = rules[given.name](subject, given.value) if given.name in rules else None
            if flaw is None:
                continue
            path, message, severity = given.path, flaw.message, flaw.severity
            if given.name == DOMAIN and has_template(given.value or ""):
                # Nothing is said if this waits for data, too.
                path, message = ("network", "domain_id"), f"{subject.key}: {message}"
            yield Problem(path, message, KIND, severity=severity, at_key=given.at_key)
        yield from check_naming(subject)
        yield from check_master(subject)


def subjects_of(
    options: OrchestrationOptions, ros: Generation, release: Release
) -> Iterator[Subject]:
    """Yield the nodes and the application."""
    for key, node in options.nodes.items():
        path: Path = ("nodes", str(key))
        container = object_name(str(key)) if node.pod else NODE_CONTAINER
        own = ros.of_node(node)
        yield Subject(str(key), node, own, release, container, path, (*path, "patch"))
    if has_application(options):
        node, path = application_options(options), ("additional_k8s_params", "application")
        yield Subject(None, node, ros, release, APP_CONTAINER, path, path)


def literals(node: NodeOptions) -> Iterator[tuple[str, str]]:
    """Yield the variables of a node's `env` whose text is known."""
    for name, source in entries(node.env):
        if (value := source.get("value")) is not None:
            yield name, str(value)


def list_given(subject: Subject) -> Iterator[Given]:
    """Yield the variables that a user sets for a container: `env`, the patch, the command line."""
    node = subject.node
    for index, (name, source) in enumerate(entries(node.env)):
        where: Path = (name,) if isinstance(node.env, Mapping) else (index,)
        yield Given(name, read(source.get("value")), (*subject.path, "env", *where))
    for at, one in enumerate(containers_of(node.patch)):
        if one.get("name") != subject.container:
            continue
        for index, item in enumerate(list_mappings(one.get("env"))):
            where = (*subject.patch, "spec", "template", "spec", "containers", at, "env", index)
            value = "" if item.keys() == {"name"} else item.get("value")
            yield Given(str(item.get("name")), read(value), where)
    if subject.key is not None:
        yield from list_assigned(subject)


def list_assigned(subject: Subject) -> Iterator[Given]:
    """Yield the variables that a command line sets: of env, of a shell, of ROS 1's arguments."""
    line = subject.ros.find_program(subject.node)
    path = (*subject.path, line_key(subject.node))
    if any(PurePosixPath(word).name in (*SHELLS, "env") for word in line):  # or below another one
        text = " ".join(line)
        for name in RULES.get(subject.ros.name, {}):
            pattern = rf"""(?:^|[\s;&|("'])({name})=("[^"]*"|'[^']*'|[^\s;&|)"']*)"""
            for found in re.finditer(pattern, text):
                yield Given(name, read(found[2].strip("\"'")), path, at_key=True)
    elif not subject.ros.dds:
        for word in line:
            name, mark, value = word.partition(":=")
            if mark and name in ROS1_ARGUMENTS:
                yield Given(ROS1_ARGUMENTS[name], read(value), path, at_key=True)


def line_key(node: NodeOptions) -> str:
    """Return the option with a node's command line."""
    return "command" if node.command is not None else "args"


def read(value: Any) -> str | None:
    """Return a variable's text; None if it is known in the container only."""
    text = None if value is None else str(value)
    return None if text is not None and FILLED_IN.search(text) else text


# ROS 2


def explain_domain(subject: Subject, value: str | None) -> Flaw | None:
    """Compare a domain with the release's."""
    release, mode = subject.release, subject.release.mode
    network = release.network
    known = domain(network, subject.ros, "") if network else None
    chosen = network is not None and (network.domain_id is not None or not mode.own_domain)
    unread = value is None or has_template(value)
    if value and not unread and not (DECIMAL.fullmatch(value) and int(value) <= LAST_DOMAIN):
        return Flaw(f'"{value}" is not a DDS domain: a whole number from 0 to {LAST_DOMAIN}')
    if known is None or (chosen and value == str(known)) or (unread and not mode.own_domain):
        return None
    number = "N" if value is None else f'"{value}"' if unread else str(int(value or 0))
    where = f"is in domain {number}" if not unread else "has a domain of its own"
    instead = f"remove it, and set `network: {{mode: {mode.name}, domain_id: {number}}}`"
    ours = f"the release's domain, {known}" if chosen else "the release's own domain"
    if mode.domain_bound:
        why = f"{mode.domain_bound} {ours}"
        if unread and chosen:
            return None if value else Flaw(f"{why}, and no one knows this one", "warning")
        return Flaw(f"the node {where}, and {why}, so no node finds it: {instead}")
    if unread or len(set(release.domains)) < 2:
        return None
    message = f"the node {where}, and nodes in {ours} do not find it: {instead}"
    return Flaw(message, "warning")


def explain_middleware(subject: Subject, value: str | None) -> Flaw | None:
    """Compare a middleware with the one that the network configures."""
    release, mode = subject.release, subject.release.mode
    if value is None or has_template(value):
        return None
    given = middleware_name(value.replace("_dynamic", ""))
    if given not in MIDDLEWARE:
        given = None
    elif value.replace("_dynamic", "") != MIDDLEWARE[given]:
        message = f'"{value}" is not a name of ROS: write {MIDDLEWARE[given]}, or set `middleware:'
        return Flaw(f"{message} {given}` at the job")
    expected = release.middleware
    if not value or (expected is None and given != "zenoh") or given == expected:
        return None
    if expected is None:
        routed = {"ZENOH_CONFIG_OVERRIDE", "ZENOH_SESSION_CONFIG_URI"}
        own_router = routed & variable_names(subject.node)
        if own_router or (not mode.connects and (release.network or release.pods < 2)):
            return None
        return Flaw("zenoh needs a router: remove it, and set `network: zenoh`, which has one")
    by = "middleware" if release.options.middleware else "network"
    word = release.options.middleware or mode.name
    message = f"`{by}: {word}` configures {expected} only: remove it"
    if mode.middleware is None and given:
        message += f", or set `middleware: {given}` at the job"
    return Flaw(message, "error" if mode.connects else "warning")


def variable_names(node: NodeOptions) -> set[str]:
    """Return the names of the variables of a node's `env`."""
    return {name for name, _ in entries(node.env)}


def explain_local(subject: Subject, what: str) -> Flaw | None:
    """Judge discovery that ends at the machine, or the pod."""
    release, mode = subject.release, subject.release.mode
    if release.middleware == "zenoh" or release.pods < 2:
        return None
    if subject.on_machine:
        message = f"{what}, so the node finds only nodes of its own machine: remove it"
        return Flaw(message, "warning")
    message = f"{what}, so the node finds no node of another pod: remove it"
    return Flaw(message, "error" if mode.looks_beyond else "warning")


def explain_localhost(subject: Subject, value: str | None) -> Flaw | None:
    """Judge ROS_LOCALHOST_ONLY."""
    return explain_local(subject, "it ends discovery at localhost") if value == "1" else None


def explain_range(subject: Subject, value: str | None) -> Flaw | None:
    """Judge ROS_AUTOMATIC_DISCOVERY_RANGE; of what it does not know, rcl makes LOCALHOST."""
    old = subject.release.distro.lower() in BEFORE_IRON
    if old or value in (None, "", "SUBNET") or has_template(value or ""):
        return None
    if value == "SYSTEM_DEFAULT":
        if not subject.release.mode.lists_peers:
            return None
        message = "with SYSTEM_DEFAULT ROS may leave out the list of `peers`: remove it"
        return Flaw(message, "warning")
    if value in ("OFF", "LOCALHOST"):
        return explain_local(subject, f"{value} ends discovery at the pod")
    return explain_local(subject, f'ROS takes the unknown "{value}" for LOCALHOST')


def explain_servers(subject: Subject, value: str | None) -> Flaw | None:
    """Compare discovery servers with the release's."""
    release, mode = subject.release, subject.release.mode
    if value is None or has_template(value) or release.middleware not in (None, "fastdds"):
        return None
    if mode.asks_servers:
        from rigel_k8s.network.modes.discovery_server import DISCOVERY_PORT

        name, network = str(release.options.deployment_name), release.network or Network()
        ours = [f"{one}:{DISCOVERY_PORT}" for one in mode.services(name, network, ())]
        if any(one in value for one in ours):
            return None
        message = "the node asks other servers than the release's, and finds none of its nodes"
        return Flaw(f"{message}: remove it, or write {';'.join(ours)} before them")
    others = [one for one in release.options.nodes.values() if one is not subject.node]
    if not value or all("ROS_DISCOVERY_SERVER" in variable_names(one) for one in others):
        return None
    message = "a client of a discovery server finds only its other clients: remove it, and set"
    return Flaw(f"{message} `network: discovery-server`", "warning")


def explain_peers(subject: Subject, value: str | None) -> Flaw | None:
    """Judge a list of peers that replaces the release's."""
    if not subject.release.mode.lists_peers or subject.release.distro.lower() in BEFORE_IRON:
        return None
    message = "it replaces the list of the release's nodes: remove it, and set"
    return Flaw(f"{message} `network: {{mode: peers, peers: [...]}}`", "warning")


def explain_transports(subject: Subject, value: str | None) -> Flaw | None:
    """Judge transports by shared memory, which no other pod reads."""
    release, node = subject.release, subject.node
    shared = node.pod is not None or bool(release.network and release.network.shared_memory)
    if not value or shared or release.pods < 2 or release.middleware not in (None, "fastdds"):
        return None
    kind = value.partition("?")[0]
    if kind == "SHM":
        return Flaw("pods have no memory in common, so no node hears it: remove it")
    if kind.endswith("v6") and release.mode.looks_beyond:
        return Flaw(f"the nodes look for each other by IPv4, and {kind} has none: remove it")
    if release.mode.sets_transports and kind in ("DEFAULT", "LARGE_DATA"):
        message = f"{kind} writes into a memory that no other pod reads: remove it, or let nodes"
        return Flaw(f"{message} share a `pod`", "warning")
    return None


def explain_zenoh_config(subject: Subject, value: str | None) -> Flaw | None:
    """Judge a configuration of zenoh that replaces the one with the release's router."""
    release = subject.release
    if release.mode.middleware != "zenoh":
        return None
    name, network = str(release.options.deployment_name), release.network or Network()
    router = next(iter(release.mode.services(name, network, ())))
    ours = f'mode="client";{ENDPOINTS}=["tcp/{router}:{ZENOH_PORT}"]'
    if value is None or has_template(value) or f"{router}:" in value:
        return None
    message = "it replaces the one that connects the node to the release's router: begin it with"
    return Flaw(f"{message} {ours};", "warning" if ENDPOINTS in value else "error")


def explain_files(name: str) -> Rule:
    """Return what judges a variable that names the configuration of DDS."""

    def explain(subject: Subject, value: str | None) -> Flaw | None:
        release, node = subject.release, subject.node
        plan = NetworkPlan(
            namespace="",
            release=str(release.options.deployment_name),
            options=release.network,
            ros=subject.ros,
            distro=release.distro,
            middleware=release.middleware,
            on_machine=release.mode.in_machine_network,
        )
        pod = PodIdentity("", "", on_machine=node.host_network, shares_memory=node.pod is not None)
        ours = wire_pod(plan, pod).env.get(name, {}).get("value")
        if ours is None or release.pods < 2 or (value and ours in value):
            return None
        message = f"it replaces {ours}, by which the node finds others: remove it, or write into"
        return Flaw(f"{message} your file what that one has", "warning")

    return explain


# ROS 1


def is_alone(release: Release) -> bool:
    """Return whether all of ROS is in one pod, with a roscore that its image starts."""
    return release.pods < 2 and find_host(release.master) == "localhost"


def is_local(host: str) -> bool:
    """Return whether a name or address leads nowhere but to the same machine or pod."""
    try:
        address = ip_address(host.strip("[]"))
    except ValueError:
        return host.lower() == "localhost" or host.lower().startswith("localhost.")
    return address.is_loopback or address.is_unspecified


def find_host(uri: str) -> str:
    """Return the host of a master's URI."""
    return uri.partition("://")[2].rstrip("/").rpartition(":")[0]


def explain_address(subject: Subject, value: str | None, what: str) -> Flaw | None:
    """Judge the address that a node advertises."""
    if value is None or has_template(value) or is_alone(subject.release):
        return None
    advice = "remove it, and the node has its pod's address"
    if not value or is_local(value):
        where = value or "an empty address"
        message = f"other pods cannot connect to {where}, so they hear nothing of it: {advice}"
        return Flaw(message, "warning" if subject.on_machine else "error")
    if "/" in value or re.fullmatch(r"[^:]*:\d+", value):
        return Flaw(f'"{value}" has a protocol or a port, so no node connects to it: {advice}')
    if subject.on_machine or subject.release.mode.attached:
        return None
    return Flaw(f"{what}: {advice}", "warning")


def explain_ip(subject: Subject, value: str | None) -> Flaw | None:
    """Judge ROS_IP."""
    return explain_address(subject, value, "a pod that starts again has another address")


def explain_hostname(subject: Subject, value: str | None) -> Flaw | None:
    """Judge ROS_HOSTNAME."""
    return explain_address(subject, value, "the name of a pod does not resolve in other pods")


def explain_master(subject: Subject, value: str | None) -> Flaw | None:
    """Compare a master with the release's."""
    release = subject.release
    if value is None or has_template(value) or is_alone(release):
        return None
    if not RosUri.pattern.fullmatch(value):
        return Flaw(f'"{value}" is not {RosUri.expects}: remove it')
    host = find_host(value)
    if value.rstrip("/") == release.master.rstrip("/"):
        return None
    line = subject.ros.find_program(subject.node)
    starts = any(re.search(r"\b(roscore|roslaunch|rosmaster)\b", word) for word in line)
    if is_local(host) and not subject.on_machine and not starts:
        message = f"there is no master in the node's pod: remove it, and it uses {release.master}"
        return Flaw(message)
    other = "another master than the release's other nodes, which it does not find"
    message = f"the node registers at {other}: remove it, or set `ros_master_uri` of the job"
    return Flaw(message, "warning")


def explain_namespace(subject: Subject, value: str | None) -> Flaw | None:
    """Compare ROS_NAMESPACE with the name by which the node is looked for."""
    expected = subject.ros_name
    if value is None or has_template(value) or expected is None:
        return None
    actual = ros_name(expected.rpartition("/")[2], value)
    return None if actual == expected else Flaw(explain_name(actual, expected))


FILES = {name: explain_files(name) for name in ("CYCLONEDDS_URI", OLD_VARIABLE, NEW_VARIABLE)}
#: By the generation: the variable, and what compares a user's value with what is ours.
RULES: Mapping[str, Mapping[str, Rule]] = {
    "2": {
        DOMAIN: explain_domain,
        "RMW_IMPLEMENTATION": explain_middleware,
        "ROS_LOCALHOST_ONLY": explain_localhost,
        "ROS_AUTOMATIC_DISCOVERY_RANGE": explain_range,
        "ROS_DISCOVERY_SERVER": explain_servers,
        "ROS_STATIC_PEERS": explain_peers,
        "FASTDDS_BUILTIN_TRANSPORTS": explain_transports,
        "ZENOH_CONFIG_OVERRIDE": explain_zenoh_config,
        **FILES,
    },
    "none": FILES,
    "1": {
        "ROS_HOSTNAME": explain_hostname,
        "ROS_IP": explain_ip,
        "ROS_MASTER_URI": explain_master,
        "ROS_NAMESPACE": explain_namespace,
    },
}
#: Arguments of ROS 1 that are variables, too.
ROS1_ARGUMENTS = {
    "__hostname": "ROS_HOSTNAME",
    "__ip": "ROS_IP",
    "__master": "ROS_MASTER_URI",
    "__ns": "ROS_NAMESPACE",
}
#: By the generation: what an argument sets of a node's name.
NAMING = {
    "2": {"__node": "name", "__name": "name", "__ns": "namespace"},
    "1": {"__name": "name"},
}


def explain_name(actual: str, expected: str) -> str:
    """Return that a node gets another name than the one by which it is looked for."""
    namespace, _, name = actual.rpartition("/")
    options = f"name: {name}" + (f", namespace: {namespace}" if namespace else "")
    wrong = f"the node would be {actual}, and `rigel` looks for {expected}"
    return f"{wrong}: remove it, and set `{options}`"


def check_naming(subject: Subject) -> Iterator[Problem]:
    """Yield arguments that give a node another name than its key or its options."""
    words, key = NAMING.get(subject.ros.name, {}), line_key(subject.node)
    if subject.key is None or subject.node.launch:
        return
    line = subject.ros.find_program(subject.node)
    rules = {
        rule: value for rule, value in list_rules(subject.ros, line) if own_part(rule) in words
    }
    found = {words[own_part(rule)]: value for rule, value in rules.items()}
    if not found or any(has_template(value) or FILLED_IN.search(value) for value in found.values()):
        return
    path, expected = (*subject.path, key), subject.ros_name
    if expected is None:
        if "name" in found:
            message = f"all its pods would be {found['name']}: remove it, or `anonymous`"
            yield Problem(path, message, KIND, severity="warning", at_key=True)
        return
    namespace, _, name = expected.rpartition("/")
    actual = ros_name(found.get("name", name).strip("/"), found.get("namespace", namespace) or None)
    if actual != expected:
        sure = subject.ros.takes_arguments(line) and not any(":" in rule for rule in rules)
        severity: Severity = "error" if sure else "warning"
        message = explain_name(actual, expected)
        yield Problem(path, message, KIND, severity=severity, at_key=True)


def own_part(rule: str) -> str:
    """Return what a rule is about; one for a node of some name may be for this one."""
    return rule.rpartition(":")[2]


def check_master(subject: Subject) -> Iterator[Problem]:
    """Yield a node that is a roscore of its own, beside the release's."""
    release, line = subject.release, subject.ros.find_program(subject.node)
    if subject.ros.name != "1" or subject.key is None or is_alone(release):
        return
    name = PurePosixPath(line[0]).name if line else ""
    sure = name in ("roscore", "rosmaster")
    inside = name in SHELLS and re.search(r"\broscore\b(?!:)", " ".join(line))
    if find_host(release.master) != "localhost" and (sure or inside):
        message = (
            f"the nodes register at {release.master}, and none at this roscore: remove it (for"
            " another master set `ros_master_uri`)"
        )
        severity: Severity = "error" if sure else "warning"
        path = (*subject.path, line_key(subject.node))
        yield Problem(path, message, "two-masters", severity=severity, at_key=True)


def list_rules(ros: Generation, line: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Yield the assignments FROM:=TO of a line; those of a shell, if each is there once."""
    if line and PurePosixPath(line[0]).name in SHELLS:
        text = " ".join(line)
        found = re.findall(r"(?:^|\s)(__\w+):=([^\s;&|\"']+)", text)
        yield from (one for one in found if [name for name, _ in found].count(one[0]) == 1)
        return
    flagged, before = False, ""
    for word in line:
        if ros.rmw and word in (ROS_ARGS, ROS_ARGS_END):
            flagged = word == ROS_ARGS
        name, mark, value = word.partition(":=")
        if mark and (not flagged or before in ("-r", "--remap")):
            yield name, value
        before = word
