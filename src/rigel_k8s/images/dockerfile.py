"""The text of a Dockerfile for a ROS workspace; pure: it reads no file and runs nothing.

The order of the layers is that of how often they change: packages, environment, the user's own
commands, build tools, repositories of others, the dependencies that the package.xml files name, and
last the application's sources. So an edit of a source file compiles and does nothing else.
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping

import attrs

from rigel_k8s.distros import ROS1
from rigel_k8s.option_text import split_text

DOCKERFILE = "Dockerfile"
#: Next to the Dockerfile, under the name that Rigel uses.
ENTRYPOINT_FILE = "dockerfile_entrypoint.sh"

_PYTHON2_DISTROS = ROS1.keys() - {"noetic"}
_SETUP_FILE = {"catkin_make": "devel/setup.bash", "colcon": "install/setup.bash"}
#: Debian's colcon only recommends the packages that it cannot work without.
_COLCON_PARTS = (
    *("bash", "cmake", "defaults", "library-path", "metadata", "output"),
    *("package-selection", "parallel-executor", "recursive-crawl", "ros"),
)
_NO_RECOMMENDS = "/etc/apt/apt.conf.d/90rosdep"
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
    entrypoint: tuple[str, ...] = ()
    rosinstall: tuple[str, ...] = ()
    command: str | tuple[str, ...] = ()
    username: str = "rigeluser"

    @property
    def builds(self) -> bool:
        """Whether there is a workspace to compile."""
        return self.compiler != "none" and bool(self.packages or self.rosinstall)

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
        if self.distro not in ROS1:
            return (ros,)
        # rosrun and roslaunch find packages that were never built by this path.
        return (ros, f'export ROS_PACKAGE_PATH="{self.workspace}/src:$ROS_PACKAGE_PATH"')


def dockerfile(recipe: Recipe) -> str:
    """Return the Dockerfile's text, without the mark of its writer."""
    blocks = [*_clones(recipe), f"FROM {recipe.base}\nUSER root\n", *_apt(recipe), *_env(recipe)]
    blocks += [
        *_render_own_commands(recipe),
        *_user(recipe),
        *_tools(recipe),
        *_dependencies(recipe),
    ]
    blocks += [*_workspace(recipe), *_start(recipe)]
    return "\n".join(blocks)


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


def _clones(recipe: Recipe) -> Iterator[str]:
    if not recipe.rosinstall:
        return
    about = "Repositories of others, cloned in a stage of their own: git stays out of the image."
    yield f"# {about}\nFROM {recipe.base} AS repositories\nUSER root\n"
    vcs = _choose_by_system(["vcstool"], [f"{_python(recipe.distro)}-vcstool"])
    yield _run(f"{vcs}{_install(['git', 'openssh-client', '$tools'])}")
    yield "WORKDIR /repositories\n"
    for number, file in enumerate(recipe.rosinstall):
        copy = f"COPY {_quote_paths(file, f'{number}.rosinstall')}\n"
        yield f"{copy}RUN mkdir -p src && vcs import src < {number}.rosinstall\n"


def _apt(recipe: Recipe) -> Iterator[str]:
    if recipe.apt:
        yield _run(_install(map(shlex.quote, recipe.apt)))


def _env(recipe: Recipe) -> Iterator[str]:
    if recipe.env:
        yield "".join(f"ENV {name}={_env_value(value)}\n" for name, value in recipe.env)


def _env_value(value: str) -> str:
    # `$NAME` stays as it is, since docker expands it; `\$` too, which keeps docker from that.
    escaped = re.sub(r"\\(?!\$)", r"\\\\", value).replace('"', '\\"')
    return f'"{escaped}"'


def _render_own_commands(recipe: Recipe) -> Iterator[str]:
    if recipe.docker_run:
        yield "".join(_render_run(command.strip()) for command in recipe.docker_run)


def _render_run(command: str) -> str:
    if re.search(r"(?<!\\)\n", command):
        return f"RUN {json.dumps(['/bin/sh', '-ec', command])}\n"
    return f"RUN {command}\n"


def _user(recipe: Recipe) -> Iterator[str]:
    setup = "".join(f" \\\n        {shlex.quote(line)}" for line in recipe.setup)
    steps = [f"mkdir -p {recipe.workspace}/src"]
    if recipe.username != "root":
        user = recipe.username
        made = f"useradd --create-home --user-group --shell /bin/bash {user}"
        steps.insert(0, f"{{ id -u {user} >/dev/null 2>&1 || {made}; }}")
        steps.append(f"chown -R {user}: {recipe.workspace}")
    # Kubernetes may run the image as any user, and Ubuntu closes homes to others.
    steps.append(f"chmod a+rx {recipe.home}")
    steps.append(f"printf '%s\\n'{setup} \\\n        >> /etc/bash.bashrc")
    about = "Interactive shells (kubectl exec -it POD -- bash) know ROS as well."
    yield f"# {about}\n{_run(_chain(steps))}"


def _tools(recipe: Recipe) -> Iterator[str]:
    if not recipe.builds:
        return
    tools = [_install_by_system(recipe)]
    if recipe.distro in ROS1:
        # Debian's catkin would set ROS_DISTRO=Debian, and fail where it has another value.
        tools.append("rm -f /etc/catkin/profile.d/1.ros_distro.sh")
    about = "What builds the workspace; Debian and packages.ros.org name it differently."
    yield f"# {about}\n{_run(_chain(tools))}"


def _install_by_system(recipe: Recipe) -> str:
    debian, ubuntu = [], []
    if recipe.distro in ROS1:
        debian.append("catkin")
        ubuntu.append(f"ros-{recipe.distro}-catkin")
    if recipe.compiler == "colcon":
        debian += ["colcon", *(f"python3-colcon-{part}" for part in _COLCON_PARTS)]
        debian.append("python3-setuptools")  # builds ament_python packages
        ubuntu.append("python3-colcon-common-extensions")
    if recipe.rosdep:
        debian.append("python3-rosdep2")
        ubuntu.append(f"{_python(recipe.distro)}-rosdep")
    install = _install(["build-essential", "cmake", "$tools"])
    return f"{_choose_by_system(debian, ubuntu)}{install}"


def _dependencies(recipe: Recipe) -> Iterator[str]:
    if recipe.rosinstall:
        yield f"COPY --from=repositories {_owner(recipe)}/repositories/src {recipe.workspace}/src\n"
    if not (recipe.builds and recipe.rosdep):
        return
    manifests = [_locate_manifest(package) for package in sorted(recipe.packages)]
    copies = (
        f"COPY {_owner(recipe)}{_quote_paths(path, f'{recipe.sources}/{path}')}\n"
        for path in manifests
    )
    about = "Only the package.xml files, so that this layer outlives an edit of the sources."
    yield f"# {about}\n{''.join(copies)}{_run(_rosdep(recipe))}"


def _locate_manifest(package: str) -> str:
    return "package.xml" if package == "." else f"{package}/package.xml"


def _rosdep(recipe: Recipe) -> str:
    distro = recipe.distro
    return _chain(
        [
            "{ [ -e /etc/ros/rosdep/sources.list.d/20-default.list ] || rosdep init; }",
            f"rosdep update --rosdistro {distro} --include-eol-distros",
            f"echo 'APT::Install-Recommends false;' > {_NO_RECOMMENDS}",
            "apt-get update",
            f"DEBIAN_FRONTEND=noninteractive rosdep install --rosdistro {distro} \\\n"
            f"        --from-paths {recipe.workspace}/src --ignore-src -r -y",
            f"rm -rf /var/lib/apt/lists/* /root/.ros/rosdep {_NO_RECOMMENDS}",
        ]
    )


def _workspace(recipe: Recipe) -> Iterator[str]:
    yield f"COPY {_owner(recipe)}{_quote_paths('.', f'{recipe.sources}/')}\n"
    if recipe.username != "root":
        yield f"USER {recipe.username}\n"
    yield f"WORKDIR {recipe.workspace if recipe.builds else recipe.sources}\n"
    if recipe.builds:
        made = f"source /opt/ros/{recipe.distro}/setup.bash && {_make(recipe)}"
        yield _run(f"bash -c {shlex.quote(made)}")


def _make(recipe: Recipe) -> str:
    program = "colcon build" if recipe.compiler == "colcon" else "catkin_make"
    given = [
        shlex.quote(f"{name if name.startswith('-') else f'-D{name}'}={value}")
        for name, value in recipe.cmake_args.items()
    ]
    return " ".join([program, *(["--cmake-args", *given] if given else [])])


def _start(recipe: Recipe) -> Iterator[str]:
    script = f"{recipe.home}/robot-entrypoint.sh"
    yield f"COPY {ENTRYPOINT_FILE} {script}\n"
    # CMD is repeated: setting ENTRYPOINT drops the base image's CMD.
    command = exec_form(recipe.command) or ("bash",)
    yield f"ENTRYPOINT {json.dumps(['/bin/bash', script])}\nCMD {json.dumps(list(command))}\n"


def _owner(recipe: Recipe) -> str:
    return "" if recipe.username == "root" else f"--chown={recipe.username}:{recipe.username} "


def _python(distro: str) -> str:
    return "python" if distro in _PYTHON2_DISTROS else "python3"


def _choose_by_system(debian: Iterable[str], ubuntu: Iterable[str]) -> str:
    cases = f"""case "$ID" in \\
        debian) tools="{" ".join(debian)}" ;; \\
        *) tools="{" ".join(ubuntu)}" ;; \\
    esac"""
    return f". /etc/os-release \\\n    && {cases} \\\n    && "


def _install(packages: Iterable[str]) -> str:
    install = "DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends"
    listed = "".join(f" \\\n        {package}" for package in packages)
    return _chain(["apt-get update", f"{install}{listed}", "rm -rf /var/lib/apt/lists/*"])


def _chain(steps: Iterable[str]) -> str:
    return " \\\n    && ".join(steps)


def _run(command: str) -> str:
    return f"RUN {command}\n"


def _quote_paths(*paths: str) -> str:
    """Source and destination of a COPY; JSON if a path has a blank."""
    return json.dumps(list(paths)) if any(" " in path for path in paths) else " ".join(paths)
