"""ROS names become Kubernetes names that are valid, stable and told apart."""

from __future__ import annotations

import re

import pytest

from rigel_k8s.objects.naming import labels, object_name, ros_name

VALID = re.compile(r"[a-z]([-a-z0-9]{0,61}[a-z0-9])?")


@pytest.mark.parametrize(
    ("ros", "kubernetes"),
    [
        ("talker", "talker"),
        ("/robot1/cmd_vel_mux", "robot1-cmd-vel-mux"),
        ("Camera_Left", "camera-left"),
        ("a__b", "a-b"),
        ("9lives", "n9lives"),
        ("_", "node"),
    ],
)
def test_underscores_and_slashes_become_hyphens(ros: str, kubernetes: str) -> None:
    """Kubernetes has neither `_` nor `/` nor capitals in names."""
    assert object_name(ros) == kubernetes
    assert VALID.fullmatch(object_name(ros))


def test_long_names_stay_valid_and_different() -> None:
    """63 characters are all there is, and the end of a name matters."""
    one, two = (object_name("very_" * 20 + end) for end in ("left", "right"))
    assert VALID.fullmatch(one)
    assert len(one) == 63
    assert one != two
    assert object_name("a" * 63) == "a" * 63


def test_labels_of_the_longest_names_are_valid() -> None:
    """A label's value has 63 characters at most."""
    assert max(map(len, labels("a" * 63, "b" * 63).values())) == 63


@pytest.mark.parametrize(
    ("name", "namespace", "full"),
    [
        ("talker", None, "/talker"),
        ("talker", "robot1", "/robot1/talker"),
        ("talker", "/robot1/arm/", "/robot1/arm/talker"),
        ("arm/talker", "robot1", "/robot1/arm/talker"),
        ("/talker", "robot1", "/talker"),
        ("talker", "/", "/talker"),
    ],
)
def test_full_ros_names(name: str, namespace: str | None, full: str) -> None:
    """A name that begins with / is full already."""
    assert ros_name(name, namespace) == full
