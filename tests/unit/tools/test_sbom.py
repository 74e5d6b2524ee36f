"""SBOMs are valid CycloneDX and name what is there; the page of licences fits what is locked."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from cyclonedx.model.component import ComponentType

from rigel_k8s.system import oci
from tools.npm import DAGRE
from tools.sbom.__main__ import PAGE, ROOT
from tools.sbom.archive import read_archive
from tools.sbom.cluster import HEADER, list_builds, write_page
from tools.sbom.debian import name_licences
from tools.sbom.document import write_document
from tools.sbom.golang import escape, read_modules
from tools.sbom.licences import recognize
from tools.sbom.parts import UNKNOWN, Part
from tools.sbom.requirements import read_library, read_requirements

STATUS = """Package: libc6
Status: install ok installed
Version: 2.36-9+deb12u10

Package: gone
Status: deinstall ok config-files
Version: 1
"""
DEP5 = """Format: https://www.debian.org/doc/packaging-manuals/copyright-format/1.0/

Files: *
License: LGPL-2.1+
"""
GO = """/bin/app: go1.26.8
\tpath\texample.org/app
\tmod\texample.org/app\t(devel)\t
\tdep\tgithub.com/Old/lib\tv1.0.0\th1:aaa=
\t=>\tgithub.com/New/lib\tv1.2.0\th1:bbb=
\tdep\tgopkg.in/yaml.v3\tv3.0.1\th1:ccc=
\tbuild\t-compiler=gc
"""


def test_the_wheels_document_has_every_locked_requirement() -> None:
    """The strict validator of the library accepts it, hashes and all."""
    lock = (ROOT / "requirements/run.txt").read_text()
    text = write_document("rigel-k8s", "1", ComponentType.APPLICATION, read_requirements(lock))
    components = json.loads(text)["components"]
    locked = {line.split("==")[0] for line in lock.splitlines() if "==" in line}
    assert {one["name"] for one in components} == {name.lower() for name in locked}
    hashes = [each["content"] for one in components for each in one["hashes"]]
    assert sorted(hashes) == sorted(re.findall("sha256:([0-9a-f]{64})", lock))


def test_the_wheels_document_has_what_is_bundled() -> None:
    """The library that draws graphs, with its licence and the digests of its files."""
    text = write_document("rigel-k8s", "1", ComponentType.APPLICATION, [read_library(DAGRE)])
    [component] = json.loads(text)["components"]
    assert component["purl"] == f"pkg:npm/%40dagrejs/dagre@{DAGRE.version}"
    assert component["licenses"] == [{"license": {"id": "MIT"}}]
    assert {one["content"] for one in component["hashes"]} == {f.sha256 for f in DAGRE.files}


def test_licences_of_all_forms_are_valid() -> None:
    """Identifiers, expressions and Debian's own names pass; what is unknown is left out."""
    forms = {"a": "MIT", "b": "Apache-2.0 AND MIT", "c": "GPL-2, Expat", "d": UNKNOWN}
    parts = [Part("deb", name, "1", licence) for name, licence in forms.items()]
    text = write_document("image", "1", ComponentType.CONTAINER, parts)
    found = {one["name"]: one.get("licenses") for one in json.loads(text)["components"]}
    assert found == {
        "a": [{"license": {"id": "MIT"}}],
        "b": [{"expression": "Apache-2.0 AND MIT"}],
        "c": [{"license": {"name": "GPL-2, Expat"}}],
        "d": None,
    }


def test_an_archives_packages_are_found(tmp_path: Path) -> None:
    """Those of dpkg, those that were only unpacked, and wheels; not those that dpkg removed."""
    wheel = "Metadata-Version: 2.1\nName: Ros-Rclpy\nVersion: 7.1.4\nLicense: Apache-2.0\n"
    unpacked = "Package: python3\nVersion: 3.11.2-1\n"
    files = {
        "var/lib/dpkg/status": STATUS,
        "var/lib/dpkg/status.d/python3": unpacked,
        "usr/share/doc/libc6/copyright": DEP5,
        "opt/ros/kilted/lib/python3.11/site-packages/ros_rclpy-7.1.4.dist-info/METADATA": wheel,
    }
    layer = tmp_path / "layer.tar"
    layer.write_bytes(oci.layer([oci.Entry(p, t.encode()) for p, t in files.items()], mtime=0))
    archive = tmp_path / "image.tar"
    oci.write_archive(archive, [layer], {}, "localhost/a:1", created=0)
    assert read_archive(archive) == [
        Part("deb", "libc6", "2.36-9+deb12u10", "LGPL-2.1+"),
        Part("deb", "python3", "3.11.2-1"),
        Part("pypi", "ros-rclpy", "7.1.4", "Apache-2.0"),
    ]


def test_a_replaced_module_counts_as_what_replaces_it() -> None:
    """`go version -m` prints both."""
    assert list(read_modules(GO)) == [
        Part("golang", "std", "1.26.8", "BSD-3-Clause"),
        Part("golang", "github.com/New/lib", "v1.2.0"),
        Part("golang", "gopkg.in/yaml.v3", "v3.0.1"),
    ]
    assert escape("github.com/New/lib") == "github.com/!new/lib"


@pytest.mark.parametrize(
    ("text", "licence"),
    [
        ((ROOT / "LICENSE").read_text(), "Apache-2.0"),
        ("Permission is hereby granted, free of\n charge, to any person obtaining a copy", "MIT"),
        ("Redistribution and use in source and binary forms", "BSD-2-Clause"),
        (
            "Redistribution and use in source and\nbinary forms ... be used to\n"
            "endorse or promote products",
            "BSD-3-Clause",
        ),
        ("All rights reserved.", UNKNOWN),
    ],
)
def test_a_licence_is_recognized_by_its_sentences(text: str, licence: str) -> None:
    """Line breaks and punctuation do not matter; what is not well known is unknown."""
    assert recognize(text) == licence


def test_old_copyright_files_name_debians_common_licences() -> None:
    """A text without any of them is unknown."""
    assert name_licences("see /usr/share/common-licenses/GPL-2.") == "GPL-2"
    assert name_licences("do as you like") == UNKNOWN


def test_the_page_of_licences_has_what_is_locked() -> None:
    """Each module on the page is in the go.sum of the programs that it names, at that version."""
    builds = list_builds()
    sums = {build.name: (build.lock / "go.sum").read_text() for build in builds}
    text = PAGE.read_text()
    cells = [line.strip("|").split("|") for line in text.splitlines() if line.startswith("|")]
    rows = [[cell.strip() for cell in row] for row in cells[2:]]
    for name, version, _, users in rows:
        for user in users.split(", "):
            known = user == "debian" or name == "std" or f"{name} {version} " in sums[user]
            assert known, f"{PAGE.name} is out of date: {name} {version} ({user})"
    listed = {
        (name, version, user) for name, version, _, users in rows for user in users.split(", ")
    }
    for build in builds:
        own = (build.module, f"v{build.module_version}", build.name)
        assert own in listed, f"{PAGE.name} is out of date: run `python -m tools.sbom licences`"


def test_a_component_of_several_programs_has_one_row() -> None:
    """All its users are in the last column."""
    part = Part("golang", "a.org/b", "v1", "MIT")
    assert write_page({"loki": [part], "coredns": [part]}).endswith(
        "|---|---|---|---|\n| a.org/b | v1 | MIT | coredns, loki |\n"
    )


def test_the_page_of_licenses_begins_as_it_is_written_now() -> None:
    """`python -m tools.sbom licences` writes it."""
    page = Path(__file__).parents[3] / "docs" / "licences.md"
    assert page.read_text("utf-8").startswith(HEADER)
