"""The text of a Dockerfile for a ROS workspace: files/Dockerfile.jinja, filled in by a `Recipe`.

It reads no file of the workspace and runs nothing.
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Iterable, Mapping
from importlib.resources import files

import attrs

from rigel_k8s.option_text import split_text
from rigel_k8s.ros import DISTROS_1

DOCKERFILE = "Dockerfile"
#: Next to the Dockerfile, under the name that Rigel uses.
ENTRYPOINT_FILE = "dockerfile_entrypoint.sh"

_PYTHON2_DISTROS = DISTROS_1.keys() - {"noetic"}
_SETUP_FILE = {"catkin_make": "devel/setup.bash", "colcon": "install/setup.bash"}
#: Debian's colcon only recommends the packages that it cannot work without.
_COLCON_PARTS = (
    *("bash", "cmake", "defaults", "library-path", "metadata", "output"),
    *("package-selection", "parallel-executor", "recursive-crawl", "ros"),
)
_NEEDS_SHELL = re.compile(r"""[$`&|;<>(){}*?!~#\n]|^\w+=""")


@attrs.frozen
class Recipe:
    """All that a Dockerfile depends on.

    Attributes:
        distro: the ROS distribution, whose set-up is /opt/ros/DISTRO/setup.bash.
        base: the image to start from.
        source_name: the directory below src/ that the application's sources go to.
        packages: directories with a package.xml, relative to the sources; none: nothing is built.
        compiler: `catkin_make`, `colcon`, or `none` for sources that need no build.
        cmake_args: CMake variables, with or without `-D`.
        rosdep: install what the package.xml files depend on.
        apt: Debian packages.
        env: environment variables; `$NAME` in a value is expanded.
        docker_run: commands run as root before the sources are copied.
        python_requirements: files with packages of PyPI, relative to the sources.
        entrypoint: lines of shell run in the container before its command.
        rosinstall: files that vcs imports, relative to the sources.
        command: the default command, as text or words; empty: an interactive shell.
        username: the user that runs; created unless the base image has it.
    """

    distro: str
    base: str
    source_name: str
    packages: tuple[str, ...] = ()
    compiler: str = "catkin_make"
    cmake_args: Mapping[str, str] = attrs.field(factory=dict)
    rosdep: bool = True
    apt: tuple[str, ...] = ()
    env: tuple[tuple[str, str], ...] = ()
    docker_run: tuple[str, ...] = ()
    python_requirements: tuple[str, ...] = ()
    entrypoint: tuple[str, ...] = ()
    rosinstall: tuple[str, ...] = ()
    command: str | tuple[str, ...] = ()
    username: str = "rigeluser"

    @property
    def builds(self) -> bool:
        """Whether there is a workspace to compile."""
        return self.compiler != "none" and bool(self.packages or self.rosinstall)

    @property
    def python(self) -> str:
        """The beginning of the names of Python packages in its system."""
        return "python" if self.distro in _PYTHON2_DISTROS else "python3"

    @property
    def home(self) -> str:
        """The user's home directory in the image."""
        return "/root" if self.username == "root" else f"/home/{self.username}"

    @property
    def workspace(self) -> str:
        """The workspace's directory in the image."""
        return f"{self.home}/ros_workspace"

    @property
    def sources(self) -> str:
        """The directory in the image that the application's sources go to."""
        return f"{self.workspace}/src/{self.source_name}"

    @property
    def setup(self) -> tuple[str, ...]:
        """The lines of shell that set up ROS and the application."""
        ros = f"source /opt/ros/{self.distro}/setup.bash"
        if self.builds:
            return (ros, f"source {self.workspace}/{_SETUP_FILE[self.compiler]}")
        if self.distro not in DISTROS_1:
            return (ros,)
        # rosrun and roslaunch find packages that were never built by this path.
        return (ros, f'export ROS_PACKAGE_PATH="{self.workspace}/src:$ROS_PACKAGE_PATH"')


def dockerfile(recipe: Recipe) -> str:
    """Return the Dockerfile's text, without the mark of its writer."""
    # It takes longer to import than all that a deploy without a build does here.
    from jinja2 import Environment, StrictUndefined

    environment = Environment(
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True, undefined=StrictUndefined
    )
    filters = {"quote": shlex.quote, "env_value": _env_value, "run_value": _run_value}
    environment.filters.update(filters)
    text = (files(__package__) / "files" / "Dockerfile.jinja").read_text("utf-8")
    debian, ubuntu = _list_tools(recipe)
    owner = f"--chown={recipe.username}:{recipe.username} "
    return environment.from_string(text).render(
        recipe=recipe,
        user=recipe.username,
        workspace=recipe.workspace,
        ros1=recipe.distro in DISTROS_1,
        owner="" if recipe.username == "root" else owner,
        debian_tools=debian,
        ubuntu_tools=ubuntu,
        build=_build(recipe),
        entrypoint_file=ENTRYPOINT_FILE,
        command=json.dumps(list(exec_form(recipe.command) or ("bash",))),
        paths=_quote_paths,
    )


def entrypoint(recipe: Recipe) -> str:
    """Return the text of the script that every container of the image starts with, no shebang."""
    own = [line.rstrip("\n") for line in recipe.entrypoint]
    place = recipe.workspace if recipe.builds else recipe.sources
    end = ["# The command takes this shell's place, so that signals reach it.", 'exec "$@"']
    return "\n".join(["set -e", *recipe.setup, f"cd {shlex.quote(place)}", *own, *end, ""])


def render_dockerignore(packages: Iterable[str]) -> str:
    """Return the text of a .dockerignore: what must not get into the image or invalidate a layer.

    A whole workspace (no package.xml at its top) may hold what was built in it before, which would
    be found twice.
    """
    built = () if "." in packages else ("build", "devel", "install", "log", "logs")
    return "\n".join(
        [".git", "Rigelfile", DOCKERFILE, ".dockerignore", "**/__pycache__", *built, ""]
    )


def exec_form(command: str | tuple[str, ...]) -> tuple[str, ...]:
    """Return a command as words, with a shell only if needed: a shell swallows signals."""
    if not isinstance(command, str):
        return command
    text = command.strip()
    words = _json_words(text)
    if words is not None:
        return words
    if _NEEDS_SHELL.search(text):
        return ("bash", "-c", text)
    return tuple(split_text(text))


def _json_words(text: str) -> tuple[str, ...] | None:
    if not text.startswith("["):
        return None
    try:
        words = json.loads(text)
    except ValueError:
        return None
    return tuple(words) if all(isinstance(word, str) for word in words) else None


def _env_value(value: str) -> str:
    # `$NAME` stays as it is, since docker expands it; `\$` too, which keeps docker from that.
    escaped = re.sub(r"\\(?!\$)", r"\\\\", value).replace('"', '\\"')
    return f'"{escaped}"'


def _run_value(command: str) -> str:
    """Return what RUN gets of a command; one of several lines is a script."""
    text = command.strip()
    return json.dumps(["/bin/sh", "-ec", text]) if re.search(r"(?<!\\)\n", text) else text


def _list_tools(recipe: Recipe) -> tuple[list[str], list[str]]:
    """Return the packages that build the workspace, by Debian's names and by packages.ros.org's."""
    debian, ubuntu = [], []
    if recipe.distro in DISTROS_1:
        debian.append("catkin")
        ubuntu.append(f"ros-{recipe.distro}-catkin")
    if recipe.compiler == "colcon":
        debian += ["colcon", *(f"python3-colcon-{part}" for part in _COLCON_PARTS)]
        debian.append("python3-setuptools")  # builds ament_python packages
        ubuntu.append("python3-colcon-common-extensions")
    if recipe.rosdep:
        debian.append("python3-rosdep2")
        ubuntu.append(f"{recipe.python}-rosdep")
    return debian, ubuntu


def _build(recipe: Recipe) -> str:
    """Return the command that builds the workspace."""
    program = "colcon build" if recipe.compiler == "colcon" else "catkin_make"
    given = [
        shlex.quote(f"{name if name.startswith('-') else f'-D{name}'}={value}")
        for name, value in recipe.cmake_args.items()
    ]
    words = [program, *(["--cmake-args", *given] if given else [])]
    return f"source /opt/ros/{recipe.distro}/setup.bash && {' '.join(words)}"


def _quote_paths(*paths: str) -> str:
    """Source and destination of a COPY; JSON if a path has a blank."""
    return json.dumps(list(paths)) if any(" " in path for path in paths) else " ".join(paths)
