"""Everything that Multus and whereabouts need on a cluster, as the desired state of a release."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from importlib.resources import files
from typing import Any

import attrs

from rigel_k8s.network.multus import MULTUS_IMAGE, PLUGINS_IMAGE, RELEASE, WHEREABOUTS_IMAGE
from rigel_k8s.network.multus.daemon import multus_daemon
from rigel_k8s.network.multus.definitions import attachment_definition, whereabouts_definitions
from rigel_k8s.network.multus.machines import SCRIPTS, Machines, config_map
from rigel_k8s.network.multus.recognition import Group
from rigel_k8s.network.multus.rights import multus_rights, whereabouts_rights
from rigel_k8s.network.multus.whereabouts import address_keeper, reconciler
from rigel_k8s.network.options import Install
from rigel_k8s.objects.refs import ref_of
from rigel_k8s.objects.steady import steady
from rigel_k8s.release.types import Desired

Object = dict[str, Any]


@attrs.frozen
class Installation:
    """What `rigel` installs on which machines.

    Attributes:
        groups: the cluster's machines by platform; machines that join later belong to the first.
        multus: whether Multus is installed by us; another installation is used unchanged.
        whereabouts: whether whereabouts is installed by us.
        there: names of CustomResourceDefinitions that others have made: they stay unchanged.
        retired: remove what was put onto the machines; the objects are deleted after that.
    """

    groups: Sequence[Group]
    options: Install = attrs.field(factory=Install)
    multus: bool = True
    whereabouts: bool = True
    there: frozenset[str] = frozenset()
    retired: bool = False

    @property
    def multus_image(self) -> str:
        """Multus' image."""
        return str(self.options.multus_image or MULTUS_IMAGE)

    @property
    def whereabouts_image(self) -> str:
        """whereabouts' image."""
        return str(self.options.whereabouts_image or WHEREABOUTS_IMAGE)

    def plugins_image(self, machines: Machines) -> str | None:
        """Return the image with the standard programs, None where the machines have them."""
        if self.options.plugins_image:
            return str(self.options.plugins_image)
        return PLUGINS_IMAGE if machines.platform.lacks_programs else None


def network_release(installation: Installation, script: str) -> Desired:
    """Return the desired state of the release.

    Args:
        script: the text of machine.sh.
    """
    definitions = [d for d in _definitions(installation) if _is_ours(d, installation)]
    objects = [*definitions, *_objects(installation, script)]
    return Desired(
        RELEASE,
        tuple(map(steady, objects)),
        options=attrs.asdict(installation.options, filter=lambda _, value: value is not None),
        # Deleting a definition deletes all attachments of all applications.
        protected=frozenset(ref_of(definition) for definition in definitions),
    )


def machine_script() -> str:
    """Return the text of machine.sh."""
    return (files("rigel_k8s.network.multus") / "machine.sh").read_text(encoding="utf-8")


def _is_ours(definition: Object, installation: Installation) -> bool:
    return definition["metadata"]["name"] not in installation.there


def _definitions(installation: Installation) -> Iterator[Object]:
    yield attachment_definition()
    if installation.whereabouts:
        yield from whereabouts_definitions()


def _objects(installation: Installation, text: str) -> Iterator[Object]:
    script = config_map(SCRIPTS, {"machine.sh": text})
    yield script
    if installation.multus:
        yield from multus_rights()
    if installation.whereabouts:
        yield from whereabouts_rights()
        if not installation.retired:
            yield from reconciler(installation.whereabouts_image)
    for machines in machines_of(installation):
        if installation.multus:
            plugins = installation.plugins_image(machines)
            yield from multus_daemon(machines, script, installation.multus_image, plugins)
        if installation.whereabouts:
            yield address_keeper(machines, script, installation.whereabouts_image)


def machines_of(installation: Installation) -> Iterator[Machines]:
    """Yield the machines of each platform."""
    main, *rest = installation.groups
    others = tuple(name for group in rest for name in group.nodes)
    yield Machines(main.platform, others=others, retired=installation.retired)
    for group in rest:
        yield Machines(
            group.platform, _suffix(group), only=group.nodes, retired=installation.retired
        )


def _suffix(group: Group) -> str:
    """Return the suffix for a platform's objects; it does not depend on the machines."""
    where = f"{group.platform.conf_dir} {group.platform.bin_dir}"
    return f"{group.platform.kind}-{hashlib.sha256(where.encode()).hexdigest()[:6]}"
