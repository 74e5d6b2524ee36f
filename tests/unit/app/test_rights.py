"""The declared rights are enough for what applications are made of, and no more."""

from __future__ import annotations

import copy
import re
from collections import defaultdict
from pathlib import Path
from typing import Any

import yaml

from rigel_k8s.app.rights import PURPOSES, read_rights
from rigel_k8s.objects.rights import find_missing, make_rules
from rigel_k8s.release.refusals.missing import find_resource, need_for

from .shapes import release
from .test_golden import CASES, FOLDER

DEPLOYER = read_rights(PURPOSES["deployer"], "n")


def read_shapes() -> list[Any]:
    """Return what applications are made of; no golden file has a task."""
    task = release("{image: a, nodes: {n: {kind: task, args: [a]}}}").objects
    golden = (item for case in CASES for item in FOLDER.make(case))
    return [copy.deepcopy(item) for item in (*golden, *task)]


def test_a_deployer_may_do_all_that_any_application_needs() -> None:
    """Of every shape in the golden files; volumes of machines belong to the whole cluster."""
    shapes = read_shapes()
    assert len({item["kind"] for item in shapes}) > 6
    for item in shapes:
        assert find_resource(item["apiVersion"], item["kind"]), item["kind"]
        item["metadata"]["namespace"] = "n"
    own = [item for item in shapes if item["kind"] != "PersistentVolume"]
    needed = need_for(own, own, own, "n")
    assert find_missing(needed, make_rules(DEPLOYER)) == []


def test_who_looks_sees_no_secret_and_changes_nothing() -> None:
    """And runs no command in a pod."""
    rights = read_rights(PURPOSES["viewer"], "n")
    assert {right.verb for right in rights} == {"get", "list", "watch"}
    assert not {"secrets", "pods/exec"} & {right.resource for right in rights}
    assert rights < DEPLOYER


def test_the_documentation_says_what_each_right_is_needed_for() -> None:
    """docs/rights.md has each resource of the Role with its verbs, and no other."""
    page = (Path(__file__).parents[3] / "docs" / "rights.md").read_text()
    text = page.partition("| right | verbs |")[2]
    documented: dict[str, set[str]] = {}
    for names, verbs in re.findall(r"^\| (`.*?) \| ([a-z][^|(]*?)(?: \(.*?\))? \|", text, re.M):
        for name in re.findall(r"`(.*?)`", names):
            documented[name] = set(re.split(r"[,;] ", verbs))
    granted: dict[str, set[str]] = defaultdict(set)
    for right in DEPLOYER:
        name = f"{right.resource}.{right.group}" if "metrics" in right.group else right.resource
        granted[name].add(right.verb)
    assert documented == granted


def test_the_documented_role_for_volumes_is_what_a_deployer_needs_in_addition() -> None:
    """To deploy a `host_path` of `persistent_storage`, to change it, and to remove it."""
    page = (Path(__file__).parents[3] / "docs" / "rights.md").read_text()
    (block,) = re.findall(r"^```yaml\n(.*?)^```$", page, re.M | re.S)
    role = yaml.safe_load(block)
    volumes = [item for item in read_shapes() if item["kind"] == "PersistentVolume"]
    assert volumes
    needed = {r for r in need_for(volumes, volumes, volumes, "n") if not r.namespace}
    assert role["rules"] == make_rules(needed)
    assert find_missing(needed, make_rules(DEPLOYER)) == sorted(needed)


def test_no_right_is_for_all_verbs_or_kinds() -> None:
    """A Role without a star says what it grants; all of it is in the namespace."""
    for right in DEPLOYER:
        assert "*" not in (right.group, right.resource, right.verb)
        assert right.namespace == "n"
