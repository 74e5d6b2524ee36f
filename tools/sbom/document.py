"""Components -> a CycloneDX document, which is valid or an error."""

from __future__ import annotations

import uuid
from collections.abc import Iterable

from cyclonedx.contrib.license.factories import LicenseFactory
from cyclonedx.model import HashAlgorithm, HashType
from cyclonedx.model.bom import Bom, BomMetaData
from cyclonedx.model.component import Component, ComponentType
from cyclonedx.output import make_outputter
from cyclonedx.schema import OutputFormat, SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator
from packageurl import PackageURL

from tools.sbom.parts import UNKNOWN, Part

VERSION = SchemaVersion.V1_6


def write_document(name: str, version: str, kind: ComponentType, parts: Iterable[Part]) -> str:
    """Return the SBOM of something, as JSON.

    Args:
        name: the name of the described software.
        version: its version.
        kind: its type.
        parts: its components.

    Raises:
        ValueError: the document would not be valid CycloneDX.
    """
    parts = sorted(set(parts))
    about = Component(name=name, version=version, type=kind, bom_ref=name)
    components = [make_component(part) for part in parts]
    bom = Bom(
        metadata=BomMetaData(component=about),
        components=components,
        serial_number=uuid.uuid5(uuid.NAMESPACE_URL, f"{name} {version} {parts}"),
    )
    bom.register_dependency(about, components)
    text = make_outputter(bom, OutputFormat.JSON, VERSION).output_as_string(indent=2)
    if error := JsonStrictValidator(VERSION).validate_str(text):
        raise ValueError(f"the SBOM of {name} is not valid CycloneDX: {error}")
    return text


def make_component(part: Part) -> Component:
    """Return one component; an unknown licence is left out, as CycloneDX does."""
    group, _, name = part.name.rpartition("/")
    url = PackageURL(part.kind, "debian" if part.kind == "deb" else group, name, part.version)
    known = part.licence != UNKNOWN
    return Component(
        name=part.name,
        version=part.version,
        type=ComponentType.LIBRARY,
        bom_ref=str(url),
        purl=url,
        hashes=[HashType(alg=HashAlgorithm.SHA_256, content=digest) for digest in part.sha256],
        licenses=[LicenseFactory().make_from_string(part.licence)] if known else [],
    )
