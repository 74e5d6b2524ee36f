"""The kinds that Multus and whereabouts bring: upstream's CustomResourceDefinitions, as files."""

from __future__ import annotations

from importlib.resources import files
from typing import Any

import yaml

Object = dict[str, Any]

WHEREABOUTS = ("ippools", "overlappingrangeipreservations", "nodeslicepools")


def attachment_definition() -> Object:
    """Return the kind NetworkAttachmentDefinition, as the Network Plumbing Group defines it."""
    return _definition("k8s.cni.cncf.io_network-attachment-definitions")


def whereabouts_definitions() -> tuple[Object, ...]:
    """Return the kinds in which whereabouts records which pod has which address."""
    return tuple(_definition(f"whereabouts.cni.cncf.io_{plural}") for plural in WHEREABOUTS)


def _definition(name: str) -> Object:
    file = files(__package__).joinpath("crds").joinpath(f"{name}.yaml")
    definition: Object = yaml.safe_load(file.read_text("utf-8"))
    return definition
