"""Raw parts are laid over what is generated as Kubernetes' users expect; partial jobs likewise."""

from __future__ import annotations

import json
from typing import Any

import pytest

from rigel_k8s.app.application import flat, is_partial, overlay
from rigel_k8s.objects.overlay import merge, simplify
from rigel_k8s.objects.scalars import Port, Quantity


@pytest.mark.parametrize(
    ("base", "over", "result"),
    [
        ({"a": 1, "b": {"c": 1}}, {"b": {"d": 2}}, {"a": 1, "b": {"c": 1, "d": 2}}),
        ({"a": 1, "b": 2}, {"a": None}, {"b": 2}),
        ({"args": ["a", "b"]}, {"args": ["c"]}, {"args": ["c"]}),
        ({"tolerations": [{"key": "a"}]}, {"tolerations": []}, {"tolerations": []}),
        (
            {"env": [{"name": "A", "valueFrom": {"x": 1}}, {"name": "B", "value": "b"}]},
            {"env": [{"name": "A", "value": "a"}, {"name": "C", "value": "c"}]},
            {"env": [{"name": n, "value": n.lower()} for n in "ABC"]},
        ),
        (
            {"volumes": [{"name": "v", "emptyDir": {}}]},
            {"volumes": [{"name": "v", "hostPath": {"path": "/v"}}]},
            {"volumes": [{"name": "v", "hostPath": {"path": "/v"}}]},
        ),
        (
            {"readinessProbe": {"exec": {"command": ["a"]}}, "startupProbe": {}},
            {"readinessProbe": {"httpGet": {"port": 1}}},
            {"readinessProbe": {"httpGet": {"port": 1}}},
        ),
        (
            {"strategy": {"type": "RollingUpdate", "rollingUpdate": {"maxSurge": 1}}},
            {"strategy": {"type": "Recreate"}},
            {"strategy": {"type": "Recreate"}},
        ),
    ],
)
def test_merging(base: dict[str, Any], over: dict[str, Any], result: dict[str, Any]) -> None:
    """Mappings merge, null removes, named things merge by name, unions and other lists replace."""
    before = json.dumps([base, over])
    assert merge(base, over) == result
    assert json.dumps([base, over]) == before


def test_plain_data_is_of_jsons_own_types() -> None:
    """A subclass of str would reach the YAML writer as a Python object."""
    made = simplify({Quantity("a"): (Port(1), Quantity("1Gi"), True, None, 1.5)})
    assert made == {"a": [1, "1Gi", True, None, 1.5]}
    assert [type(v) for v in made["a"]] == [int, str, bool, type(None), float]
    assert [type(k) for k in made] == [str]


@pytest.mark.parametrize(
    ("raw", "partial"),
    [
        ({"rolling_update": {}, "readiness": {}}, True),
        ({"orchestration": {"rolling_update": {}}}, True),
        ({"orchestration": {"deploy_ros_master": False}}, False),
        ({"application_image": "a"}, False),
        ({"nodes": {}}, False),
    ],
)
def test_which_jobs_describe_a_part(raw: dict[str, Any], *, partial: bool) -> None:
    """Those that name neither nodes nor an application's image nor the master."""
    assert is_partial(raw) is partial


def test_a_partial_job_is_laid_over_the_last_revision() -> None:
    """Both may be nested; nothing that it does not name is reset."""
    previous = {
        "orchestration": {
            "application_image": "a:1",
            "distributed": {"enabled": True, "default_to_remote": True},
            "rolling_update": {"max_surge": 1},
        }
    }
    part = {"rolling_update": {"strategy": "Recreate"}, "distributed": {"force_local_flag": True}}
    assert overlay(previous, part) == {
        "application_image": "a:1",
        "distributed": {"enabled": True, "default_to_remote": True, "force_local_flag": True},
        "rolling_update": {"strategy": "Recreate"},
    }


def test_flat_takes_the_nested_level_away() -> None:
    """src.plugin's users write all keys below `orchestration`."""
    assert flat({"orchestration": {"a": 1}}) == {"a": 1}
    assert flat({"a": 1}) == {"a": 1}
