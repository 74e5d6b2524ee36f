"""All objects of Multus and whereabouts on a cluster, as the desired state of a release; pure.

They are written in files/ and, as upstream defines their kinds, in crds/. What depends on the
cluster is put in here. A change of a pod restarts the network of every machine.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator
from importlib.resources import files
from string import Template
from typing import Any

import attrs
import yaml

from rigel_k8s.objects.naming import HOSTNAME
from rigel_k8s.objects.refs import ref_of
from rigel_k8s.objects.steady import steady
from rigel_k8s.release.types import Desired
from rigel_k8s.yaml_text import Loader
from rigel_multus.installation import (
    MULTUS_IMAGE,
    PLUGINS_IMAGE,
    RELEASE,
    WHEREABOUTS_IMAGE,
    Installation,
    Part,
)
from rigel_multus.platform import Group

Object = dict[str, Any]

#: The standard programs that networks of robots use.
STANDARD = "bridge dhcp host-local ipvlan macvlan ptp static tuning vlan"
#: In which of its containers a machine's own directories are mounted, and whether read-only.
SEES_MACHINE = {"multus": {"readOnly": True}, "machine": {}}
DEFINITIONS: dict[Part, tuple[str, ...]] = {
    "multus": ("k8s.cni.cncf.io_network-attachment-definitions",),
    "whereabouts": (
        "whereabouts.cni.cncf.io_ippools",
        "whereabouts.cni.cncf.io_overlappingrangeipreservations",
        "whereabouts.cni.cncf.io_nodeslicepools",
    ),
}


def network_release(installation: Installation, script: str) -> Desired:
    """Return the desired state of the release.

    Args:
        script: the text of machine.sh.
    """
    # Attachments are ours to define even if Multus is not.
    parts: set[Part] = {"multus", *installation.installs}
    definitions = [
        one
        for one in read_definitions(parts)
        if one["metadata"]["name"] not in installation.foreign
    ]
    objects = [*definitions, *list_objects(installation, script)]
    return Desired(
        RELEASE,
        tuple(map(steady, objects)),
        options=attrs.asdict(installation.options, filter=lambda _, value: value is not None),
        # Deleting a definition deletes all attachments of all applications.
        protected=frozenset(ref_of(definition) for definition in definitions),
    )


def machine_script() -> str:
    """Return the text of machine.sh."""
    return (files(__package__) / "machine.sh").read_text("utf-8")


def read_definitions(parts: Iterable[Part]) -> list[Object]:
    """Return the kinds that Multus and whereabouts bring."""
    names = [name for part in DEFINITIONS if part in parts for name in DEFINITIONS[part]]
    return [definition for name in names for definition in read("crds", name)]


def read(folder: str, name: str, /, **values: Any) -> list[Object]:
    """Return the objects of a file, with values in place of $NAME."""
    text = (files(__package__) / folder / f"{name}.yaml").read_text("utf-8")
    given = {key: json.dumps(value) for key, value in values.items()}
    return list(yaml.load_all(Template(text).substitute(given) if values else text, Loader))


def list_objects(installation: Installation, text: str) -> Iterator[Object]:
    """Yield all objects but the definitions."""
    [script] = read("files", "scripts", script=text)
    yield script
    for part in installation.installs:
        yield from read("files", f"{part}-rights")
    if "whereabouts" in installation.installs and not installation.retired:
        yield from read("files", "reconciler", image=choose_image(installation, "whereabouts"))
    for group in installation.groups:
        for part in installation.installs:
            yield from render_daemon(installation, part, group, script)


def choose_image(installation: Installation, part: Part) -> str:
    options = installation.options
    if part == "multus":
        return str(options.multus_image or MULTUS_IMAGE)
    return str(options.whereabouts_image or WHEREABOUTS_IMAGE)


def render_daemon(
    installation: Installation, part: Part, group: Group, script: Object
) -> list[Object]:
    """Return a part's DaemonSet for the machines of one platform, behind its configuration."""
    where = group.platform
    suffix = "" if group is installation.groups[0] else group.suffix
    plugins = installation.options.plugins_image or (PLUGINS_IMAGE if where.lacks_programs else "")
    affinity = choose_machines(installation, group)
    objects = read(
        "files",
        part,
        name=f"rigel-{part}{suffix}",
        config=f"rigel-{part}-config{suffix}",
        image=choose_image(installation, part),
        plugins=str(plugins),
        affinity=affinity,
        bin_dir=where.bin_dir,
        conf_dir=where.conf_dir,
        standard=STANDARD,
        retired="1" if installation.retired else "",
    )
    *configuration, daemon = objects
    template = daemon["spec"]["template"]
    pod = template["spec"]
    if affinity is None:
        del pod["affinity"]
    if not plugins and "initContainers" in pod:
        pod["initContainers"] = []
    mount_roots(pod, where.roots)
    # It rolls when its configuration changes.
    text = json.dumps([*configuration, script], sort_keys=True)
    digest = hashlib.sha256(text.encode()).hexdigest()[:20]
    template["metadata"]["annotations"] = {"rigel-k8s/configuration": digest}
    if installation.retired:  # it may stop on all machines at once
        daemon["spec"]["updateStrategy"]["rollingUpdate"] = {"maxUnavailable": "100%"}
    return objects


def choose_machines(installation: Installation, group: Group) -> Object | None:
    """Return on which machines a group's pods run: its own; the first's: all but the others'."""
    main, *rest = installation.groups
    operator, names = "In", list(group.nodes)
    if group is main:
        operator, names = "NotIn", [name for other in rest for name in other.nodes]
    if not names:
        return None
    rule = {"key": HOSTNAME, "operator": operator, "values": sorted(names)}
    required = {"nodeSelectorTerms": [{"matchExpressions": [rule]}]}
    return {"nodeAffinity": {"requiredDuringSchedulingIgnoredDuringExecution": required}}


def mount_roots(pod: Object, roots: Iterable[str]) -> None:
    """Mount the machine's directories of CNI at the same paths: the daemon and links need that."""
    paths = {f"root-{number}": path for number, path in enumerate(roots)}
    pod["volumes"][:0] = [
        {"name": name, "hostPath": {"path": path, "type": "Directory"}}
        for name, path in paths.items()
    ]
    for container in pod["containers"]:
        if container["name"] in SEES_MACHINE:
            how = {**SEES_MACHINE[container["name"]], "mountPropagation": "HostToContainer"}
            container["volumeMounts"][:0] = [
                {"name": name, "mountPath": path, **how} for name, path in paths.items()
            ]
