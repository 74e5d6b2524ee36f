"""The recipe of the ROS 1 base image: Debian's packages and the official image's paths.

Debian has ROS in /usr; the official image has it in /opt/ros/noetic. Links make both true, so that
Dockerfiles, launch files and Rigelfiles with the official paths work.
"""

from __future__ import annotations

from importlib.resources import files

from rigel_k8s.report import Reporter
from rigel_k8s.system import oci
from rigel_k8s.system.oci import Entry, architecture
from rigel_lab.images.base.build import EPOCH, BaseImage, Recipe
from rigel_lab.images.base.build import build as build_recipe
from rigel_lab.images.base.layer import ENTRYPOINT, config
from rigel_lab.images.ros1base.packages import PACKAGES, REFERENCES, SUITE, UNDESCRIBED, Variant

PREFIX = "opt/ros/noetic"
_HOOKS = "etc/catkin/profile.d"

CONFIG = config("noetic")

_COMMANDS = (
    "catkin_find",
    "catkin_init_workspace",
    "catkin_make",
    "catkin_make_isolated",
    "catkin_test_results",
    "catkin_topological_order",
    "rosbag",
    "rosclean",
    "roscore",
    "rosgraph",
    "roslaunch",
    "rosmaster",
    "rosmsg",
    "rosnode",
    "rospack",
    "rosparam",
    "rosrun",
    "rosservice",
    "rossrv",
    "rosstack",
    "rostopic",
    "rosversion",
)


def build(
    report: Reporter,
    *,
    variant: Variant = "core",
    arch: str | None = None,
    force: bool = False,
) -> BaseImage:
    """Return the base image's archive; build it if the cache does not have it.

    Args:
        report: shows the progress.
        variant: `core` runs ROS 1 nodes, `devel` also compiles C++ workspaces.
        arch: the architecture of its programs (`arm64`); None: that of this machine.
        force: build again, to get Debian's latest security updates.

    Raises:
        RigelK8sError: mmdebstrap is missing and cannot be installed here.
        CommandFailed: mmdebstrap failed.
    """
    recipe = Recipe(
        title="ROS 1 base image",
        family="ros1-base",
        name=variant,
        reference=REFERENCES[variant],
        suite=SUITE,
        packages=PACKAGES[variant],
        config=CONFIG,
        overlay=layer(variant, mtime=EPOCH),
        arch=arch or architecture(),
    )
    return build_recipe(recipe, report, force=force)


def list_files(variant: Variant) -> tuple[Entry, ...]:
    """Return the files and links that Debian does not have: a layer, sorted by path."""
    described = (
        Entry(f"usr/share/{name}/package.xml", _package_xml(name, text).encode())
        for name, text in (UNDESCRIBED.items() if variant == "core" else ())
    )
    return tuple(sorted((*_scripts(), *_links(), *described), key=lambda e: e.path))


def layer(variant: Variant, *, mtime: int) -> bytes:
    """Return the layer as an uncompressed tar; the same input gives the same bytes."""
    return oci.layer(list_files(variant), mtime=mtime)


def _scripts() -> tuple[Entry, ...]:
    own = files("rigel_lab.images.ros1base") / "files"
    return (
        # Debian's own set the distribution "Debian"; catkin_make runs them and fails.
        Entry(f"{_HOOKS}/1.ros_distro.sh", b"export ROS_DISTRO=noetic\n"),
        Entry(f"{_HOOKS}/1.ros_etc_dir.sh", b"export ROS_ETC_DIR=/opt/ros/noetic/etc/ros\n"),
        ENTRYPOINT,
        Entry(f"{PREFIX}/.catkin"),
        Entry(f"{PREFIX}/env.sh", (own / "env.sh").read_bytes(), mode=0o755),
        *(
            Entry(f"{PREFIX}/setup.{shell}", (own / f"setup.{shell}").read_bytes())
            for shell in ("bash", "sh", "zsh")
        ),
    )


def _links() -> tuple[Entry, ...]:
    """Only ROS's commands go to bin: all of /usr/bin would come before /usr/local/bin in PATH."""
    return (
        Entry(f"{PREFIX}/etc/ros", link="/etc/ros"),
        Entry(f"{PREFIX}/include", link="/usr/include"),
        Entry(f"{PREFIX}/lib", link="/usr/lib"),
        Entry(f"{PREFIX}/share", link="/usr/share"),
        *(Entry(f"{PREFIX}/bin/{name}", link=f"/usr/bin/{name}") for name in _COMMANDS),
    )


def _package_xml(name: str, description: str) -> str:
    return (
        '<package format="2">\n'
        f"  <name>{name}</name>\n"
        "  <version>1.15.15</version>\n"
        f"  <description>{description} (Debian's build).</description>\n"
        '  <maintainer email="debian-science-maintainers@lists.alioth.debian.org">'
        "Debian Science Maintainers</maintainer>\n"
        "  <license>BSD</license>\n"
        "</package>\n"
    )
