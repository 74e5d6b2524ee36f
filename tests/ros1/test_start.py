"""Containers that their image completes, against a real roscore: parameters, packages, commands."""

from __future__ import annotations

import json

import pytest
import yaml

from rigel_k8s.app.generations.ros1.globalparameters import READY, STATE

pytestmark = pytest.mark.cluster

START = ("/bin/sh", "/rigel-k8s/start.sh", "ros1")
VALUES = "/rigel-k8s-parameters/99-parameters.json"
MARK = "/rigel_k8s/app/global_parameters"
#: A package of the image with files of its own.
NAV = "/opt/ros/noetic/share/nav"
PACKAGE = {
    f"{NAV}/package.xml": "<package><name>nav</name></package>\n",
    f"{NAV}/config/costmap.yaml": "speed: 1\nlimits: {turn: deg(90)}\nrates: [1, 2.5]\n",
    f"{NAV}/describe": '#!/bin/sh\necho "<robot name=\\"$1\\"/>"\n',
}
ENV = {"ROBOT": "r7"}


def parameters(pod, name="/"):
    """What the master has below a name, as another pod's rosparam sees it."""
    done = pod.exec("/bin/sh", "/rigel-k8s/exec.sh", "rosparam", "get", name)
    assert done.returncode == 0, done.stdout
    return yaml.safe_load(done.stdout)


def setter(pods, values, *steps):
    """Start what sets global parameters."""
    words = ("--substitute", *steps, "--values", VALUES, "/", "--keep", MARK)
    files = {**PACKAGE, VALUES: json.dumps(values)}
    return pods.start("parameters", *START, *words, files=files, env=ENV)


def is_ready(pod):
    return pod.exec("/bin/sh", "-c", READY).returncode == 0


def test_a_node_is_completed_before_it_starts(pods):
    """Files of its image, values and a command's output are there when it looks for them."""
    master = pods.rosmaster()
    values = {"speed": 5, "frame": "$(env ROBOT)/base", "text": "07", "gains": ["$(env ROBOT)", 1]}
    done = pods.start(
        "planner",
        *(*START, "--substitute", "--load", "$(find nav)/config/costmap.yaml", "/planner/costmap"),
        *("--values", VALUES, "/planner", "--run", "/planner/urdf", "'$(find nav)/describe' x"),
        *("--", "rosparam", "get", "/planner"),
        files={**PACKAGE, VALUES: json.dumps(values)},
        env=ENV,
    )
    assert done.process.wait(240) == 0, done.log()
    assert yaml.safe_load(done.log()) == {
        **values,
        "frame": "r7/base",
        "gains": ["r7", 1],
        "costmap": {"speed": 1, "limits": {"turn": pytest.approx(1.5708, 1e-3)}, "rates": [1, 2.5]},
        "urdf": '<robot name="x"/>\n',
    }
    assert parameters(master, "/planner/speed") == 5


def test_global_parameters_are_set_once(pods, eventually):
    """What is changed at run time stays, also when what sets them restarts."""
    master = pods.rosmaster()
    first = setter(pods, {"map": "$(find nav)/a", "speed": 1, "old": {"x": 1}})
    eventually(lambda: is_ready(first), "the parameters are set")
    assert parameters(master, "/map") == f"{NAV}/a"
    master.exec("rosparam", "set", "/speed", "3")
    first.kill()
    again = setter(pods, {"map": "$(find nav)/a", "speed": 1, "old": {"x": 1}})
    eventually(lambda: is_ready(again), "the restarted one is ready")
    assert parameters(master, "/speed") == 3
    again.kill()
    update = setter(pods, {"map": "b", "speed": 2})
    eventually(lambda: is_ready(update), "the update is ready")
    found = parameters(master)
    assert (found["map"], found["speed"], found["old"]) == ("b", 2, {})


def test_a_master_that_lost_the_global_parameters_gets_them_again(pods, eventually):
    """As roscore without a gate does when it restarts."""
    old = pods.rosmaster()
    pod = setter(pods, {"speed": 1})
    eventually(lambda: is_ready(pod), "the parameters are set")
    old.kill()
    eventually(lambda: not is_ready(pod), "the loss is noticed")
    eventually(  # the file is written anew, and is empty for a moment
        lambda: "the global parameters are not set" in pod.exec("cat", STATE).stdout, "its reason"
    )
    new = pods.answering(pods.start("ros-master", "rosmaster", "--core", address=old.address))
    eventually(lambda: is_ready(pod), "the parameters are set again")
    assert parameters(new, "/speed") == 1
