"""The agent's objects: golden files, since a changed template restarts the agents of all users."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.app.generation import GENERATIONS
from rigel_k8s.commands.rigelfiles import check
from rigel_k8s.objects.podsecurity import find_violations
from rigel_k8s.objects.workloads import ReleaseContext
from rigel_k8s.rigelfile import load, realise
from rigel_k8s.rigelfile.source import Span, YamlNode, node_of
from rigel_k8s.rigelfile.structure import structure
from rigel_k8s.settings import Settings
from rigel_muto.agent.manifests import agent_objects
from rigel_muto.agent.options import MutoAgent, check_options
from tests.support.golden import Golden

GOLDEN = Path(__file__).parent / "golden"
AROUND = ReleaseContext("robots", "muto-agent", "", GENERATIONS["none"])
RULES = [{"apiGroups": [""], "resources": ["pods"], "verbs": ["list"]}]
LEAST = {"thing": "org:robot", "broker": "mqtt://mosquitto:1883", "job": "deploy"}
CASES: dict[str, dict[str, Any]] = {
    "least": LEAST,
    "everything": {
        **LEAST,
        "broker": "mqtts://broker.example",
        "image": "registry.lab/muto-agent:1",
        "broker_secret": "broker",
        "prefix": "fleet",
        "target": "robot-7",
        "twin_url": "https://ditto.example",
        "twin_user": "robot",
        "twin_secret": "ditto",
        "stacks": ["org:*"],
        "images": ["registry.lab/*"],
        "whole_stacks": True,
        "resources": {"limits": {"memory": "1Gi"}},
    },
}


def read(raw: dict[str, Any]) -> tuple[MutoAgent | None, list[str]]:
    """Return options as a Rigelfile would give them, and what is wrong with them."""
    found = structure(node_of(raw, YamlNode({}, Span(1, 1, 1, 1))), MutoAgent)
    return found.draft, [problem.message for problem in found.problems]


def make(case: str) -> list[dict[str, Any]]:
    options, problems = read(CASES[case])
    assert options is not None, problems
    return list(agent_objects(AROUND, options, "jobs: {}\n", RULES))


FOLDER = Golden(GOLDEN, make, ("everything",), CASES)


@pytest.mark.parametrize("case", CASES)
def test_manifests_are_those_of_the_golden_file(case: str, *, update_golden: bool) -> None:
    FOLDER.compare(case, update=update_golden)


@pytest.mark.parametrize("case", CASES)
def test_the_pod_passes_the_level_restricted(case: str) -> None:
    spec = make(case)[-1]["spec"]["template"]["spec"]
    assert list(find_violations(spec)) == []
    assert spec["securityContext"]["runAsNonRoot"] is True


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"thing": "robot"}, "is not NAMESPACE:NAME"),
        ({"broker": "broker.example"}, "is not the address of a broker"),
        ({"twin_url": "ditto"}, "is not a URL"),
        ({"twin_url": "https://me:secret@ditto"}, "no password"),
        ({"twin_url": "https://ditto", "twin_user": "me"}, "twin_user needs twin_secret"),
        ({"resources": {"limits": {"memory": 64}}}, "did you mean 64Mi?"),
        ({"twin_secret": "ditto"}, "twin_secret needs twin_url"),
    ],
)
def test_options_that_the_agent_refuses_are_problems(change: dict[str, str], words: str) -> None:
    """Each at its own key."""
    options, _ = read({**LEAST, **change})
    [problem] = check_options(options)
    assert words in problem.message
    assert problem.path[0] in change


def test_what_a_template_will_be_is_not_judged() -> None:
    options, _ = read({**LEAST, "thing": "{{ data.thing }}", "broker": "{{ data.broker }}"})
    assert list(check_options(options)) == []


def test_the_documented_agent_can_be_deployed(tmp_path: Path) -> None:
    """The Rigelfile of docs/muto-agent.md passes the check, and its agent finds its job."""
    page = (Path(__file__).parents[4] / "docs" / "muto-agent.md").read_text("utf-8")
    (block,) = re.findall(r"^```yaml\n(.*?)^```", page, re.M | re.S)
    file = tmp_path / "Rigelfile"
    file.write_text(block)
    assert check(Settings(rigelfile=file)).errors == ()
    found = load(file)
    options = realise(found, found.jobs["agent"], None, {}, MutoAgent).options
    assert options.job == "deploy"
