"""Nodelets as a node's `components`, on a real roscore: loaded, not loaded, updated."""

from __future__ import annotations

from typing import Any

import attrs
import pytest

from rigel_k8s.app.desired import draft
from rigel_k8s.app.generation import Texts
from rigel_k8s.app.parameters import PARAMETERS_PATH
from rigel_k8s.release.types import ReleaseId
from rigel_k8s.settings import Application
from tests.support.options import options
from tests.support.until import until

from .conftest import WAIT, Pod, Pods
from .gated import hands_over, heard, listener, talker

#: The nodelet is compiled in an image of its own, which takes minutes to build.
pytestmark = [pytest.mark.cluster, pytest.mark.slow]

ECHO = {
    "plugin": "echo/Echo",
    "namespace": "robot",
    "remappings": {"chatter": "/chatter", "echoed": "said"},
    "parameters": {"words": {"before": "echo-"}},
}


@attrs.frozen
class Container:
    """A pod's container as a deploy writes it.

    Attributes:
        line: its command line; files: what is mounted into it; probe: the probe's words.
    """

    line: list[str]
    files: dict[str, str]
    probe: list[str]


def manager(*, substitution_args: bool = False, **components: dict[str, Any]) -> Container:
    """Return the container of a node called manager."""
    node = {"components": components, "substitution_args": substitution_args}
    asked = options({"image": "robot:1", "nodes": {"manager": node}})
    made = draft(asked, ReleaseId("robots", "robot"), Application("noetic"), Texts()).objects
    found = {(item["kind"], item["metadata"]["name"]): item for item in made}
    pod = found["Deployment", "manager"]["spec"]["template"]["spec"]
    config = found["ConfigMap", "manager-parameters"]["data"]
    return Container(
        line=pod["containers"][0]["args"],
        files={f"{PARAMETERS_PATH}/{name}": text for name, text in config.items()},
        probe=pod["containers"][0]["readinessProbe"]["exec"]["command"],
    )


def start(pods: Pods, container: Container, nodelet: dict[str, Any], **env: str) -> Pod:
    """Start a manager's pod; it is not ready yet."""
    files = {**nodelet, **container.files}
    return pods.start("manager", *container.line, files=files, env=env)


def test_a_nodelet_is_loaded_with_its_name_parameters_and_remappings(pods, nodelet):
    """The pod is ready when the manager has it; the manager alone is a node of the graph.

    What only the container knows is in its parameters by then.
    """
    pods.roscore()
    completed = {**ECHO, "parameters": {"words": {"before": "$(env SOUND)-"}}}
    container = manager(echo=completed, substitution_args=True)
    pod = start(pods, container, nodelet, SOUND="echo")
    done = pod.exec(*container.probe, *WAIT)
    line = "ready: /manager, /manager has loaded /robot/echo\n"
    assert (done.returncode, done.stdout) == (0, line), pod.log()
    ears = listener(pods, topic="/robot/said")
    words = ("rostopic", "pub", "-r", "10", "/chatter", "std_msgs/String", "hello 1")
    pods.node("source", *words)
    until(lambda: ("echo-hello", 1) in words_of(ears), "a message", last_words=ears.log)
    listed = pod.exec("/bin/sh", "/rigel-k8s/exec.sh", "rosnode", "list")
    assert "/manager" in listed.stdout.split()
    assert "/robot/echo" not in listed.stdout.split()


def words_of(pod: Pod) -> list[tuple[str, int]]:
    """Return (word, number) of what a listener has heard."""
    return [(word, number) for _, word, number in heard(pod)]


def test_a_nodelet_that_cannot_be_loaded_is_the_cause(pods, nodelet):
    """The pod is not ready, and says which nodelet it is; those before it are loaded."""
    pods.roscore()
    container = manager(echo=ECHO, wheel={"plugin": "echo/Wheel"})
    pod = start(pods, container, nodelet)

    def fails() -> bool:
        done = pod.exec(*container.probe)
        start = "/manager cannot load /wheel (echo/Wheel) (attempt "
        return done.returncode == 1 and done.stdout.startswith(start)

    until(fails, "the cause", last_words=pod.log)
    assert "/manager is loading /robot/echo" in pod.log()
    asked = pod.exec("/bin/sh", "/rigel-k8s/exec.sh", "rosservice", "call", "/manager/list")
    assert "- /robot/echo" in asked.stdout


def test_a_manager_hands_over_with_its_nodelets(pods, nodelet):
    """The new pod's nodelets are loaded into its own manager while the old one works."""
    pods.gated()
    env = hands_over(pods, "manager")
    talker(pods, "v1")
    first, second = (
        manager(
            echo={
                **ECHO,
                "remappings": {**ECHO["remappings"], "echoed": "/echoed"},
                "parameters": {"words": {"before": text}},
            }
        )
        for text in ("old-", "new-")
    )
    old = start(pods, first, nodelet, **env)
    assert old.exec(*first.probe, *WAIT).returncode == 0, old.log()
    ears = listener(pods, topic="/echoed")
    until(lambda: "old-v1" in versions_of(ears), "the old one", last_words=old.log)
    new = start(pods, second, nodelet, **env)
    done = new.exec(*second.probe, *WAIT)
    assert "/manager waits to take over, /manager has loaded /robot/echo" in done.stdout, new.log()
    assert "new-v1" not in versions_of(ears)
    old.terminate()
    until(lambda: "new-v1" in versions_of(ears), "the new one", last_words=new.log)
    numbers = [number for _, _, number in heard(ears)]
    assert numbers == sorted(set(numbers)), "none twice, none of the old one after the new one"


def versions_of(pod: Pod) -> set[str]:
    """Return the words before the numbers that a listener has heard."""
    return {word for word, _ in words_of(pod)}
