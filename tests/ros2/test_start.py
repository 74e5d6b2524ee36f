"""Containers that their image completes, in ROS 2: what start.sh collects, and a node reads."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import rigel_inpod
from rigel_k8s.app.generations.ros2 import OWN_FILE, render_files
from rigel_k8s.app.options import NodeOptions
from rigel_k8s.objects.scalars import ImageRef

pytestmark = pytest.mark.cluster


SCRIPTS = Path(rigel_inpod.__file__).parent
SHOW = """
import json, rclpy
rclpy.init()
node = rclpy.create_node("n", automatically_declare_parameters_from_overrides=True)
found = node.get_parameters_by_prefix("")
own = ("use_sim_time", "start_type_description_service")
print(json.dumps({name: found[name].value for name in found if name not in own}))
"""


@pytest.mark.parametrize("distro", ["jazzy", "kilted"])
def test_a_node_reads_what_the_image_completes(lab, tmp_path, distro):
    """Over files of the image; in a part of the command line with ROS arguments and without."""
    index = tmp_path / "share/ament_index/resource_index/packages"
    index.mkdir(parents=True)
    (index / "nav").touch()
    file = tmp_path / "share/nav/costmap.yaml"
    file.parent.mkdir()
    file.write_text("/**:\n  ros__parameters: {rate: 1, size: 1.0e3}\n")
    text = 'two\nlines: "[#]" \u00e9'
    later = {"map": "$(find nav)/a", "rate": "$(env RATE)", "a": {"b": ["$(env RATE)"]}, "t": text}
    (tmp_path / "values.json").write_text(json.dumps(later))
    python = str(lab.venv(distro) / "bin" / "python")
    for ros_arguments in ([], ["--ros-args", "--params-file", "$(find nav)/costmap.yaml"]):
        pod = lab.start(
            "n",
            "one",
            *("/bin/sh", str(SCRIPTS / "start.sh"), "ros2", "--substitute"),
            *("--values", str(tmp_path / "values.json"), "/**", "--run", "urdf", "echo '<robot/>'"),
            *("--", python, "-c", SHOW, *ros_arguments),
            **{
                "AMENT_PREFIX_PATH": str(tmp_path),
                "RATE": "7",
                "TMPDIR": str(tmp_path),
                "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4",
            },
        )
        assert pod.process.wait(120) == 0, pod.log()
        expected = {"map": f"{tmp_path}/share/nav/a", "rate": 7, "a.b": [7], "t": text}
        size = {"size": 1000.0} if ros_arguments else {}
        assert json.loads(pod.log()) == {**size, **expected, "urdf": "<robot/>\n"}


@pytest.mark.parametrize("distro", ["jazzy", "kilted"])
def test_a_text_stays_a_text(lab, tmp_path, distro):
    """Also one that rcl, without quotes, reads as a boolean or a number."""
    texts = ["y", "N", "yes", "Off", "12e5", "nan", "inf", "1.10", "0x10", "~", "a: b", "one\ntwo"]
    parameters = {**{f"p{n}": text for n, text in enumerate(texts)}, "list": texts, "rate": 5}
    node = NodeOptions(image=ImageRef("a"), parameters=parameters)
    file = tmp_path / "parameters.yaml"
    file.write_text(render_files(node, {})[OWN_FILE])
    python = str(lab.venv(distro) / "bin" / "python")
    command = (python, "-c", SHOW, "--ros-args", "--params-file", str(file))
    pod = lab.start("n", "one", *command, FASTDDS_BUILTIN_TRANSPORTS="UDPv4")
    assert pod.process.wait(120) == 0, pod.log()
    assert json.loads(pod.log()) == parameters
