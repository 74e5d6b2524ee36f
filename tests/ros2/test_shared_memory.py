"""Programs of one pod exchange images by shared memory, and those of other pods get them by UDP."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from rigel_k8s.app.generation import GENERATIONS
from rigel_k8s.network.dds import fastdds_profile, transports
from rigel_k8s.network.wiring import NetworkPlan, PodIdentity

pytestmark = pytest.mark.cluster

NODE = Path(__file__).parents[2] / "bench" / "image_node.py"
SIZE = 6_000_000


def sent_to_itself(pod):
    """Return the bytes that have passed a pod's loopback, by which UDP goes inside of it."""
    done = subprocess.run(
        ["ip", "-n", pod.network, "-s", "-j", "link", "show", "lo"], check=True, capture_output=True
    )
    return json.loads(done.stdout)[0]["stats64"]["tx"]["bytes"]


@pytest.mark.parametrize("distro", ["jazzy", "kilted", "humble"])
def test_images_go_by_shared_memory_in_a_pod_and_by_udp_beyond(lab, tmp_path, distro):
    """By the variable, and before jazzy by the profile."""
    plan = NetworkPlan("lab", "lab", None, GENERATIONS["2"], distro)
    pod = PodIdentity("one", "ros:x", shares_memory=True)
    env = {"ROS_DOMAIN_ID": "0"}
    if distro == "humble":  # its wheels do not exist; jazzy reads the same profile
        profile, distro = tmp_path / "fastdds.xml", "jazzy"
        profile.write_text(fastdds_profile(shared_memory=True))
        env |= {"FASTRTPS_DEFAULT_PROFILES_FILE": str(profile)}
    else:
        env |= {key: one["value"] for key, one in transports(plan, pod).items()}
    one, two = (lab.start(name, name, "sleep", "600", **env) for name in ("one", "two"))
    lab.settle()
    python = str(lab.venv(distro) / "bin" / "python")
    programs = []
    for place, role in ((one, "subscribe"), (two, "subscribe"), (one, "publish")):
        line = [python, str(NODE), role, str(SIZE), "2", "RELIABLE", "2"]
        programs.append(subprocess.Popen(place.entering(line), stdout=subprocess.PIPE))
        lab.cleanup.callback(programs[-1].wait)
        lab.cleanup.callback(programs[-1].kill)
    found = [json.loads(one.communicate(timeout=120)[0].splitlines()[-1]) for one in programs]
    near, far, sender = found
    assert sender["partners"] == 2
    assert len(near["delays"]) > sender["sent"] / 2
    assert far["delays"]
    assert sent_to_itself(one) < SIZE
