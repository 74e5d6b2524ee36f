"""ROS 2 nodes that are asked to end do so at once, whoever is process 1; a deaf one is killed."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, timedelta
from typing import Any

import pytest

from rigel_k8s.objects.refs import ObjectRef

pytestmark = pytest.mark.cluster

KEPT = "rigel-k8s.test/kept"
LAUNCH = "<launch><node pkg='talker_listener' exec='talker.py' name='launched'/></launch>"
WRITE_AND_LAUNCH = f'echo "{LAUNCH}" >/tmp/a.launch.xml; exec ros2 launch /tmp/a.launch.xml'
#: Ways in which a node runs in its container.
FORMS: dict[str, dict[str, Any]] = {
    "direct": {"args": ["talker.py"]},
    "shell": {"args": ["bash", "-c", "talker.py; true"]},
    "run": {"package": "talker_listener", "executable": "talker.py"},
    "launch": {"args": ["bash", "-c", WRITE_AND_LAUNCH], "anonymous": True},
}
#: A node that ignores what it is asked for.
DEAF = """
import signal, rclpy
from rclpy.signals import SignalHandlerOptions
rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
for number in (signal.SIGINT, signal.SIGTERM):
    signal.signal(number, signal.SIG_IGN)
rclpy.spin(rclpy.create_node("deaf"))
"""
OWN_SECONDS = 10
ALL = {
    **FORMS,
    "deaf": {
        "args": ["python3", "-c", DEAF],
        "termination_grace_period": f"{OWN_SECONDS}s",
        "update": {"drain": "5m"},
    },
}


def only_forms(options: dict[str, Any]) -> None:
    """Make each form a node whose pod can be looked at after its end."""
    del options["network"]
    keep = {"spec": {"template": {"metadata": {"finalizers": [KEPT]}}}}
    image = options["nodes"]["talker_1"]["image"]
    options["nodes"] = {name: {"image": image, "patch": keep, **form} for name, form in ALL.items()}


@pytest.fixture(scope="module")
def ended(project: Callable[..., Any], ros2_image: str) -> dict[str, dict[str, Any]]:
    """The pod of each form after it was deleted."""
    made = project("ros2-talker-listener", ros2_image, only_forms)
    made("run", "job", "build-talker")
    made("run", "job", "deploy", check=False)  # without `network` the graph may be in pieces
    refs = {
        name: ObjectRef("v1", "Pod", made.space, pod["metadata"]["name"])
        for name, pod in made.pods().items()
    }
    assert set(refs) == set(ALL)
    live = made.cluster.get
    made.until(lambda: all(is_ready(live(ref)) for ref in refs.values()), "readiness of all pods")
    found = {}
    for name, ref in refs.items():
        made.cluster.delete(ObjectRef("apps/v1", "Deployment", made.space, name))
        made.until(lambda ref=ref: end_of(made.cluster.get(ref)), f"end of {name}")
        found[name] = made.cluster.get(ref)
        made.cluster.patch(ref, {"metadata": {"finalizers": None}})
    return found


def is_ready(pod: dict[str, Any]) -> bool:
    """Return whether a pod is ready."""
    return any(c["type"] == "Ready" and c["status"] == "True" for c in pod["status"]["conditions"])


def end_of(pod: dict[str, Any]) -> dict[str, Any] | None:
    """Return how the container ended, None while it runs."""
    state = pod["status"]["containerStatuses"][0]["state"]
    return state.get("terminated")


def time_of(text: str) -> datetime:
    """Return a time as Kubernetes writes it."""
    return datetime.fromisoformat(text.replace("Z", "+00:00"))


@pytest.mark.parametrize("form", FORMS)
def test_a_node_ends_at_once_and_by_itself(ended: dict[str, dict[str, Any]], form: str) -> None:
    """In less than half of the 30 s that it has, and not killed."""
    code, seconds = judge(ended[form])
    assert code != 137
    assert seconds < 15


def test_one_that_ignores_all_signals_is_killed_in_its_own_time(
    ended: dict[str, dict[str, Any]],
) -> None:
    """Not in the five minutes more that Kubernetes gives it for goals."""
    code, seconds = judge(ended["deaf"])
    assert code == 137
    assert OWN_SECONDS - 1 <= seconds < 60


def judge(pod: dict[str, Any]) -> tuple[int, float]:
    """Return the exit code of a pod's container, and how long its end took, in seconds."""
    end = end_of(pod)
    assert end is not None
    # When the containers have ended, the kubelet sets the period in the metadata to 0
    # and moves the timestamp of the deletion by the same amount.
    left = timedelta(seconds=pod["metadata"]["deletionGracePeriodSeconds"])
    deleted = time_of(pod["metadata"]["deletionTimestamp"]) - left
    return int(end["exitCode"]), (time_of(end["finishedAt"]) - deleted).total_seconds()
