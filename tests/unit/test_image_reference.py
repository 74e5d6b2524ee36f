"""Image references, read as docker reads them."""

from __future__ import annotations

import pytest

from rigel_k8s.errors import UserError
from rigel_k8s.image_reference import Reference, parse_reference

SHA = f"sha256:{'a' * 64}"
SHA512 = f"sha512:{'b' * 128}"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("ros", Reference("docker.io", "library/ros")),
        ("ros:noetic", Reference("docker.io", "library/ros", "noetic")),
        ("osrf/ros:noetic", Reference("docker.io", "osrf/ros", "noetic")),
        ("docker.io/ros", Reference("docker.io", "library/ros")),
        ("index.docker.io/a/b", Reference("docker.io", "a/b")),
        ("localhost/app", Reference("localhost", "app")),
        ("localhost:5000/app:1", Reference("localhost:5000", "app", "1")),
        ("10.1.2.3:5000/a/b/c:v-1.0", Reference("10.1.2.3:5000", "a/b/c", "v-1.0")),
        ("[::1]:5000/app", Reference("[::1]:5000", "app")),
        ("ghcr.io/me/app@" + SHA, Reference("ghcr.io", "me/app", None, SHA)),
        (
            "app@sha512:" + "b" * 128,
            Reference("docker.io", "library/app", None, "sha512:" + "b" * 128),
        ),
        ("ghcr.io/me/app:1@" + SHA, Reference("ghcr.io", "me/app", "1", SHA)),
        ("UPPER/app", Reference("UPPER", "app")),
        ("a__b/c--d.e", Reference("docker.io", "a__b/c--d.e")),
    ],
)
def test_reads_what_docker_reads(text: str, expected: Reference) -> None:
    """Registry, repository, tag and digest are found where docker finds them."""
    assert parse_reference(text) == expected


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "not a part of an image name"),
        ("a/B", 'upper-case letters, write "b"'),
        ("App", 'upper-case letters, write "app"'),
        ("app:", "is not a tag"),
        ("app:-x", "is not a tag"),
        ("app:" + "x" * 129, "is not a tag"),
        ("app@sha256:12", "is not a digest"),
        ("app@sha256:" + "A" * 64, "is not a digest"),
        ("app@md5:" + "a" * 32, "is not a digest"),
        ("host:port/app", "is not a registry"),
        ("a//b", "not a part of an image name"),
        ("a b", "not a part of an image name"),
        ("https://host/app", "is not a registry"),
        ("a___b", "not a part of an image name"),
        ("a/" + "b" * 254, "longer than 255"),
    ],
)
def test_refuses_what_docker_refuses(text: str, why: str) -> None:
    """A reference that docker would refuse is a UserError which says what is wrong with it."""
    with pytest.raises(UserError, match=why) as caught:
        parse_reference(text)
    assert caught.value.exit_code == 2


@pytest.mark.parametrize("text", ["ros:noetic", f"localhost:5000/a@{SHA}", "x.y/z:1"])
def test_the_full_text_means_the_same(text: str) -> None:
    """str() of a reference parses to that reference."""
    reference = parse_reference(text)
    assert parse_reference(str(reference)) == reference


def test_the_version_is_the_most_exact_one() -> None:
    """A registry is asked for the digest before the tag, and for latest without either."""
    assert parse_reference("a").version == "latest"
    assert parse_reference("a:1").version == "1"
    assert parse_reference(f"a:1@{SHA}").version == SHA
