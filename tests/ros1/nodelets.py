"""A nodelet of ours: its package, compiled once in the base image that has a compiler."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
from pathlib import Path

from rigel_k8s.cli.reports import Lines
from rigel_k8s.system.cache import cache_dir, locked
from rigel_lab.images.ros1base import build

from .conftest import unpack

#: Says on one topic what it hears on another, with its parameter words/before in front.
NODELET = """
#include <nodelet/nodelet.h>
#include <pluginlib/class_list_macros.hpp>
#include <ros/ros.h>
#include <std_msgs/String.h>
namespace echo {
class Echo : public nodelet::Nodelet {
  ros::Publisher publisher_;
  ros::Subscriber subscriber_;
  std::string before_;
  void onInit() override {
    getPrivateNodeHandle().param<std::string>("words/before", before_, "");
    publisher_ = getNodeHandle().advertise<std_msgs::String>("echoed", 10);
    subscriber_ = getNodeHandle().subscribe("chatter", 10, &Echo::hear, this);
  }
  void hear(const std_msgs::String::ConstPtr& message) {
    std_msgs::String said;
    said.data = before_ + message->data;
    publisher_.publish(said);
  }
};
}
PLUGINLIB_EXPORT_CLASS(echo::Echo, nodelet::Nodelet)
"""
COMPILE = (
    "g++ -shared -fPIC -I/usr/include/pluginlib -I/usr/include/class_loader"
    " -I/usr/include/rcpputils -I/usr/include/rcutils -I/usr/include/ament_index_cpp"
    " /echo.cpp -o /libecho.so -lnodeletlib -lroscpp -lrosconsole -lroscpp_serialization"
    " -lrostime -lclass_loader"
)
PACKAGE = """<package format="2">
  <name>echo</name>
  <version>1.0.0</version>
  <description>A nodelet</description>
  <maintainer email="a@example.org">A</maintainer>
  <license>MIT</license>
  <depend>nodelet</depend>
  <export><nodelet plugin="${prefix}/plugins.xml"/></export>
</package>
"""
PLUGINS = """<library path="libecho">
  <class name="echo/Echo" type="echo::Echo" base_class_type="nodelet::Nodelet"/>
</library>
"""


def make_package(room: Path) -> dict[str, str | bytes]:
    """Return the files of the package `echo`; what is compiled is kept for all runs.

    Args:
        room: an empty directory to compile in.
    """
    devel = build(Lines(), variant="devel").archive
    made = hashlib.sha256(f"{devel.name} {NODELET} {COMPILE}".encode()).hexdigest()[:16]
    target = cache_dir() / "tests" / f"libecho-{made}.so"
    with locked(target.with_suffix(".lock")):
        if not target.exists():
            unpack(devel, room)
            (room / "echo.cpp").write_text(NODELET)
            subprocess.run(["chroot", str(room), "sh", "-c", COMPILE], check=True)
            shutil.copy(room / "libecho.so", target)
            shutil.rmtree(room)
    folder = "/usr/share/echo"
    return {
        f"{folder}/package.xml": PACKAGE,
        f"{folder}/plugins.xml": PLUGINS,
        f"{folder}/libecho.so": target.read_bytes(),
    }
