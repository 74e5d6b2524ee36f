"""Each generation's names are those that ROS itself accepts."""

from __future__ import annotations

import re

import pytest

from rigel_k8s.objects.rosnames import NAMES_1, NAMES_2
from rigel_k8s.objects.scalars import RemapName
from tests.support.ros_names import NODES, RCL, ROSGRAPH

#: rosgraph.names, of ROS 1.
NAME_LEGAL_CHARS_P = re.compile(r"^[\~\/A-Za-z][\w_\/]*$", re.ASCII)


@pytest.mark.parametrize(("name", "source", "target"), RCL)
def test_remappings_of_ros2_are_those_of_rcl(
    name: str,
    source: bool,  # noqa: FBT001 - a parameter
    target: bool,  # noqa: FBT001 - a parameter
) -> None:
    assert (NAMES_2.explain(NAMES_2.source, name) is None) is source
    assert (NAMES_2.explain(NAMES_2.target, name) is None) is target


@pytest.mark.parametrize(("name", "valid"), NODES)
def test_nodes_of_ros2_are_called_as_rcl_allows(
    name: str,
    valid: bool,  # noqa: FBT001 - a parameter
) -> None:
    assert (NAMES_2.explain(NAMES_2.node, name) is None) is valid


@pytest.mark.parametrize(("name", "legal"), ROSGRAPH)
def test_remappings_of_ros1_are_those_of_rosgraph(
    name: str,
    legal: bool,  # noqa: FBT001 - a parameter
) -> None:
    assert (bool(NAME_LEGAL_CHARS_P.match(name)) and "//" not in name) is legal
    for form in (NAMES_1.source, NAMES_1.target):
        assert (NAMES_1.explain(form, name) is None) is legal


@pytest.mark.parametrize("name", [name for name, valid, *_ in (*RCL, *ROSGRAPH) if valid])
def test_a_rigelfile_may_have_all_of_them(name: str) -> None:
    """Its form is checked before its generation is known."""
    assert RemapName.parse(name) == name


def test_a_mistake_has_its_words() -> None:
    """A name of the other generation leads to the right one; what waits for data is not judged."""
    assert "a private name is written ~/NAME" in str(NAMES_2.explain(NAMES_2.source, "~input"))
    assert "set `name`" in str(NAMES_2.explain(NAMES_2.source, "__node"))
    assert "set `name`" in str(NAMES_1.explain(NAMES_1.source, "__name"))
    assert "~/NAME" not in str(NAMES_2.explain(NAMES_2.node, "~x"))
    assert 'ROS refuses "__" in it' in str(NAMES_2.explain(NAMES_2.node, "a__b"))
    assert "only ROS 2 has NODE:NAME" in str(NAMES_1.explain(NAMES_1.source, "rostopic://a"))
    assert NAMES_2.explain(NAMES_2.target, "/{{ data.robot }}/scan") is None
