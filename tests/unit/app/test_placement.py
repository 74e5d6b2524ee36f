"""A pod stays on an unreachable machine only if no other machine may run it."""

from __future__ import annotations

from typing import Any

import pytest

from .shapes import find, problems, release

ONE = [
    "{node: robot-1}",
    "{labels: {kubernetes.io/hostname: robot-1}}",
    "{node: r, labels: {a: b}}",
]
SEVERAL = ["{}", "{labels: {kubernetes.io/arch: arm64}}", "{labels: {robot: arm}}"]
PLACES = [*((place, True) for place in ONE), *((place, False) for place in SEVERAL)]
STACK = "observability: {enabled: true, ros_metrics: true}"
#: Who may be bound: the name of its Deployment, and a job with the place at %s.
BOUND = {
    "n": "{image: a, nodes: {n: {args: x, placement: %s}}}",
    "ros-master": "{image: a, nodes: {n: {args: x}}, ros_master_placement: %s}",
    "rigel-k8s-application-discovery-0": "{image: a, ros: '2', nodes: {n: {args: x}},"
    " network: {mode: discovery-server, placement: %s}}",
    "rigel-k8s-application-zenoh": "{image: a, ros: '2', nodes: {n: {args: x}},"
    " network: {mode: zenoh, placement: %s}}",
    "ros-exporter": f"{{image: a, nodes: {{n: {{args: x, placement: %s}}}}, {STACK}}}",
}


def pod_of(text: str, name: str) -> dict[str, Any]:
    """Return the pod of a Deployment of a job."""
    return dict(find(release(text), "Deployment", name)["spec"]["template"]["spec"])


@pytest.mark.parametrize(("place", "stays"), PLACES)
@pytest.mark.parametrize("name", BOUND)
def test_only_one_machine_keeps_its_pods(
    name: str,
    place: str,
    stays: bool,  # noqa: FBT001 - a parameter
) -> None:
    """Of several with a label, another one takes over after 300 s."""
    made = pod_of(BOUND[name] % place, name)
    assert bool(made.get("tolerations")) is stays
    assert ("nodeSelector" in made) is (place != "{}")


def test_a_pod_of_several_machines_pulls_its_image_as_kubernetes_does() -> None:
    for place, stays in PLACES:
        container = pod_of(BOUND["n"] % place, "n")["containers"][0]
        assert container.get("imagePullPolicy") == ("IfNotPresent" if stays else None)


def test_devices_are_on_the_machine_that_has_them() -> None:
    """A pod elsewhere waits for its device for ever; one warning is enough for a node."""
    node = "{args: x, security_context: {privileged: true}, devices: [%s]%s}"
    for devices, more, expected in (
        ("/dev/null, /dev/a, /dev/b", "", [("nodes", "n", "devices", 1)]),
        ("/dev/a", ", placement: {labels: {arm: left}}", []),
        ("/dev/null, /dev/net/tun", "", []),
        ("{resource: a.b/c}", "", []),
    ):
        found = problems(f"{{image: a, nodes: {{n: {node % (devices, more)}}}}}")
        assert [one.path for one in found if one.kind == "any-machine"] == expected
