"""A Docker Compose file as a draft: each service is a node, and the job has what they share."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import attrs

from rigel_import.compose.options import add_build, translate
from rigel_import.compose.service import ALL_DISTROS, Service, read_services
from rigel_import.compose.values import USED_VAR, Value, Variables, read_env_file
from rigel_import.draft import Draft, Place, Remark
from rigel_import.text import read_text
from rigel_k8s.objects.text import join_words
from rigel_k8s.rigelfile.findings import problems_error
from rigel_k8s.rigelfile.parse import parse
from rigel_k8s.rigelfile.source import Source
from rigel_k8s.ros import CURRENT

#: Values of RMW_IMPLEMENTATION that the job has an option for.
MIDDLEWARE = "rmw_(fastrtps|cyclonedds|zenoh)_cpp"
#: Top-level keys that are read elsewhere, or say nothing about the services.
READ = ("services", "name", "version", "volumes")
MERGED = "import the output of `docker compose config`, which has all services"
#: Further ones, and what takes their place.
OTHERS = {
    "include": MERGED,
    "networks": "nodes share the job's `network`",
}
#: Keys whose value may be a list of NAME=value.
NAMED = ("environment", "args")
#: Lists that replace those of the service that is extended; others are joined.
REPLACED = ("command", "entrypoint")


def read(file: Path, directory: Path) -> Draft:
    """Return the draft of a Compose file. Raises UserError if it is not one.

    Args:
        directory: that of the Rigelfile, where the paths in it begin.
    """
    project = Project(file)
    services = read_services(project.services, project.variables, directory)
    distro = choose_distro(services)
    ros = ALL_DISTROS[distro]
    kept = [one for one in services if one.ros in (None, ros) and not one.replaced]
    options = share_ros([one for one in kept if one.ros], ros)
    jobs: dict[str, dict[str, Any]] = {}
    tasks = list_awaited(services)
    for service in kept:
        if service.name in tasks:
            service.options["kind"] = "task"
        translate(service, options.get("network", {}))
        add_build(service, jobs)
    options |= list_volumes(kept)
    nodes = {one.key: one.options for one in kept}
    used = set(USED_VAR.findall(json.dumps([nodes, options, jobs], ensure_ascii=False)))
    values = {"registry": "registry.example/me", **project.variables.values}
    remarks = [*explain_services(services, distro), *explain_others(project.content)]
    override = file.with_name(f"{file.stem}.override{file.suffix}")
    if override.is_file():
        remarks.append(Remark(Place(str(override), 1), f"this file is not read: {MERGED}"))
    remarks += explain_folders(kept)
    remarks += [*project.variables.remarks, *(remark for one in kept for remark in one.remarks)]
    name = project.variables.given.get("COMPOSE_PROJECT_NAME") or project.content.get("name").text
    return Draft(
        name=name or file.resolve().parent.name,
        distro=distro,
        nodes=nodes,
        options=options,
        vars={name: value for name, value in values.items() if name in used},
        jobs=jobs,
        remarks=combine(remarks),
    )


class Project:
    """A Compose file with the files that it needs, each of which is read once.

    Its creation raises UserError if one of them cannot be read, or is not a Compose file.

    Attributes:
        content: the file itself.
        services: by name, with what they extend.
    """

    def __init__(self, file: Path) -> None:
        beside = file.parent / ".env"
        self.variables = Variables()
        for name, value in read_env_file(beside, self.variables) if beside.is_file() else ():
            self.variables.given[name] = value.text
        self._loaded: dict[Path, Value] = {}
        self.content = self.load(file)
        names = self.content.get("services").entries()
        self.services = {name: self.complete(name, file) for name in names}
        if not self.services:
            hint = "pass a Docker Compose file; each entry of its `services` becomes a node"
            hint = MERGED if self.content.get("include").content else hint
            raise self.content.error("no `services` in this file", hint)
        for name, service in self.services.items():
            if not service.get("image").text and service.get("build").content is None:
                message = f'the service "{name}" has neither an `image` nor a `build`'
                merge = "`docker compose -f BASE -f THIS config > ALL`"
                raise service.error(message, f"add one; if it overrides another file, {merge}")

    def load(self, file: Path) -> Value:
        """Return the mapping in a file, with anchors and merges resolved."""
        if file not in self._loaded:
            source = Source(str(file), read_text(file))
            root, findings = parse(source)
            if findings:
                raise problems_error(source, findings)
            if root is None or not isinstance(root.value, dict):
                error = Value(Place(str(file), 1)).error
                raise error("this is not a mapping", "pass a Docker Compose file")
            self._loaded[file] = self.variables.read(root, file)
        return self._loaded[file]

    def complete(self, name: str, file: Path, above: tuple[tuple[str, Path], ...] = ()) -> Value:
        """Return a service of a file with what it extends; those in `above` extend it."""
        service = self.load(file).get("services", name)
        if not isinstance(service.content, dict):
            raise service.error(f'the service "{name}" is not a mapping', "write its keys below it")
        extends = service.get("extends")
        if extends.content is None:
            return service
        other = extends.get("file").path() if extends.get("file").text else file
        base = (extends.get("service").text or name) if extends.entries() else extends.text
        if (base, other) in (*above, (name, file)):
            raise extends.error(f'"{base}" extends itself', "remove this `extends`")
        if base not in self.load(other).get("services").entries():
            raise extends.error(f'no service "{base}" in {other}', "check `extends`")
        own = {key: value for key, value in service.content.items() if key != "extends"}
        below = self.complete(base, other, (*above, (name, file)))
        return merge(below, attrs.evolve(service, content=own))


def merge(base: Value, own: Value, key: str = "") -> Value:
    """Return a value of a service over that of the service that it extends."""
    if key in NAMED:
        return attrs.evolve(own, content={**base.pairs(), **own.pairs()})
    if isinstance(base.content, dict) and isinstance(own.content, dict):
        both = {
            name: merge(base.content[name], value, name) if name in base.content else value
            for name, value in own.content.items()
        }
        return attrs.evolve(own, content={**base.content, **both})
    if isinstance(base.content, list) and isinstance(own.content, list) and key not in REPLACED:
        return attrs.evolve(own, content=[*base.content, *own.content])
    return own


def list_awaited(services: Sequence[Service]) -> set[str]:
    """Return the services whose success others wait for, so they run once."""
    return {
        name
        for one in services
        for name, how in one.content.get("depends_on").entries().items()
        if how.get("condition").text == "service_completed_successfully"
    }


def choose_distro(services: Sequence[Service]) -> str:
    """Return the distribution that most services name, or a usual one if none does."""
    counted = Counter(one.distro for one in services if one.distro).most_common(1)
    has_ros1 = any(one.ros == "1" for one in services)
    return counted[0][0] if counted else "noetic" if has_ros1 else CURRENT


def share_ros(services: Sequence[Service], ros: str) -> dict[str, Any]:
    """Return the options of the job that its ROS services have in common.

    Variables that become options are removed from the services.
    """
    is_on_host = bool(services) and all(one.is_on_host for one in services)
    if ros == "1":
        return {"network": {"mode": "host"}} if is_on_host else {}
    network: dict[str, Any] = {"mode": "host" if is_on_host else "peers" if services else "none"}
    options: dict[str, Any] = {"network": network}
    middleware = take_variable(services, "RMW_IMPLEMENTATION", MIDDLEWARE)
    if middleware:
        options["rmw"] = middleware
    shares_memory = all(one.content.get("ipc").text == "host" for one in services)
    if is_on_host and shares_memory and middleware in ("", "rmw_fastrtps_cpp"):
        network["shared_memory"] = True
    network |= {"mode": "zenoh"} if middleware == "rmw_zenoh_cpp" else {}
    if domain := take_variable(services, "ROS_DOMAIN_ID", r"\d+"):
        network["domain_id"] = int(domain)
    for service in services if network["mode"] != "host" else ():
        if value := service.environment.pop("ROS_DOMAIN_ID", None):
            message = f"ROS_DOMAIN_ID={value.text} is left out: not all services have it, and the"
            service.remark(
                value, f"{message} nodes of a release are in one `domain_id` of `network`"
            )
    return options


def take_variable(services: Sequence[Service], name: str, pattern: str) -> str:
    """Return the value of a variable that all services share, and remove it from them, or ""."""
    values = {one.environment[name].text if name in one.environment else "" for one in services}
    if len(values) != 1 or not re.fullmatch(pattern, value := values.pop()):
        return ""
    for service in services:
        del service.environment[name]
    return value


def list_volumes(services: Sequence[Service]) -> dict[str, Any]:
    """Return the persistent volumes that nodes mount, as an option of the job."""
    mounts = (mount for one in services for mount in one.options.get("volumes", ()))
    names = dict.fromkeys(mount["name"] for mount in mounts if "name" in mount)
    return {"persistent_storage": {"volumes": [{"name": name} for name in names]}} if names else {}


def explain_services(services: Sequence[Service], distro: str) -> Iterator[Remark]:
    """Yield that the distribution is a guess, and which services become no node."""
    if not any(one.distro for one in services):
        message = f"nothing names a ROS distribution: set application.distro if not {distro}"
        yield Remark(services[0].content.place, message)
    for service in services:
        if service.ros not in (None, ALL_DISTROS[distro]):
            reason = f"it is ROS {service.ros}: give it a Rigelfile of its own"
        elif service.replaced:
            reason = f"the release has {service.replaced}"
        else:
            if service.distro not in (None, distro):
                reason = f"give it a Rigelfile of its own if it does not fit a release of {distro}"
                service.remark(service.content, f"it is of {service.distro}: {reason}")
            continue
        yield Remark(service.content.place, f"the service {service.name} is left out: {reason}")


def explain_folders(services: Sequence[Service]) -> Iterator[Remark]:
    """Yield the folders that several nodes mount, at the first of them."""
    for path in dict.fromkeys(path for one in services for path in one.folders):
        mounting = [one for one in services if path in one.folders]
        if len(mounting) > 1:
            names = join_words(one.key for one in mounting)
            message = f"{names} mount {path}, so all of them restart when one of its files changes:"
            place = mounting[0].folders[path]
            yield Remark(place, f"{message} mount single files to restart one node only")


def explain_others(content: Value) -> Iterator[Remark]:
    """Yield what a file has beside its services and a Rigelfile does not."""
    for key, value in content.entries().items():
        if key not in READ and not key.startswith("x-"):
            advice = OTHERS.get(key, "create what takes its place with kubectl")
            yield Remark(value.place, f"`{key}` is not carried over: {advice}")
    for name, volume in content.get("volumes").entries().items():
        if volume.content:
            message = f"the settings of the volume {name} are left out: set `storage_class`,"
            yield Remark(volume.place, f"{message} `size` or `host_path` in persistent_storage")


def combine(remarks: Sequence[Remark]) -> tuple[Remark, ...]:
    """Return each remark once, at its first place, with the names of all nodes it is about."""
    by_message: dict[str, list[Remark]] = {}
    for one in sorted(remarks, key=lambda one: one.place):
        by_message.setdefault(one.message, []).append(one)
    combined = []
    for first, *others in by_message.values():
        nodes = dict.fromkeys(one.node for one in (first, *others) if one.node)
        if len(nodes) > 1:
            first = Remark(first.place, f"{join_words(nodes)}: {first.message}")
        combined.append(first)
    return tuple(combined)
