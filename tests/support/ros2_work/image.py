"""The ROS 2 base image with the programs of this folder, and an action's types for them."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from rigel_lab.images.base.build import EPOCH
from rigel_lab.images.ros2base import recipe
from rigel_lab.images.ros2base.packages import Distro

from .. import shared
from ..recorder import Recorder
from . import HERE, PACKAGE

#: test_msgs, which has the only action on PyPI: its version and digest.
WHEELS: dict[Distro, tuple[str, str]] = {
    "jazzy": ("2.0.3", "aa6be70f53c9d5607fc105ba7ba72c462a06416e6cf83406a27b08e757da2e1c"),
    "kilted": ("2.3.0", "52b571b0bdbda588f18e8cf8c17327e71c293523fe32de30a7571b44a2da33a7"),
}
PROGRAMS = ("worker.py", "caller.py", "talker.py", "goal.py", "managed.py", "manager.py")
DOCKERFILE = f"""
FROM BASE
ADD ros.tar /
COPY {PACKAGE} /opt/{PACKAGE}
RUN chmod 755 /opt/{PACKAGE}/*.py && cd "/opt/ros/$ROS_DISTRO" \\
 && mkdir -p lib share/ament_index/resource_index/packages \\
 && touch share/ament_index/resource_index/packages/{PACKAGE} \\
 && ln -s /opt/{PACKAGE} share/{PACKAGE} && ln -s /opt/{PACKAGE} lib/{PACKAGE}
"""


def push_work(name: str, base: str, distro: Distro = "jazzy") -> None:
    """Build it on a base image, and push it under a name such as HOST:PORT/ros2-work:jazzy."""
    version, digest = WHEELS[distro]
    with tempfile.TemporaryDirectory() as scratch:
        context = Path(scratch)
        lock = f"ros-test-msgs=={version} --hash=sha256:{digest}\n"
        found = recipe.fetch(lock, context / "wheels", Recorder())
        recipe.write_tree(found, recipe.prefix(distro), context / "ros.tar", mtime=EPOCH)
        package = context / PACKAGE
        package.mkdir()
        shutil.copy(HERE / "robot.launch.xml", package)
        for program in PROGRAMS:
            text = (HERE / program).read_text()
            (package / program).write_text(f"#!/usr/bin/env python3\n{text}")
        (context / "Dockerfile").write_text(DOCKERFILE.replace("BASE", base))
        build = {"image": name, "push": True, "platforms": []}
        job = {"plugin": "rigel_k8s.BuildXPlugin", "with": build}
        whole = {"application": {"distro": distro}, "jobs": {"build": job}}
        (context / "Rigelfile").write_text(json.dumps(whole))
        words = ["-m", "rigel_k8s", "-f", str(context / "Rigelfile"), "run", "job", "build"]
        subprocess.run([sys.executable, *words], check=True, timeout=shared.BUILDS)
