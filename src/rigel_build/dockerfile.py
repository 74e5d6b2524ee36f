"""The job that writes a Dockerfile for a ROS workspace; it builds nothing and runs no program."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import ClassVar, Literal

import attrs

from rigel_build.recipe import (
    DOCKERFILE,
    ENTRYPOINT_FILE,
    Recipe,
    dockerfile,
    entrypoint,
    exec_form,
    render_dockerignore,
)
from rigel_k8s.errors import UserError
from rigel_k8s.image_reference import parse_reference
from rigel_k8s.jobs.job import JobContext, JobReporter
from rigel_k8s.option_text import Scalar, has_template, text_of
from rigel_k8s.problems import Problem
from rigel_k8s.ros import DISTROS_1
from rigel_k8s.settings import Application, Settings

MARK = "# Written by rigel-k8s from a Rigelfile."

_MARK_LINE = f"{MARK} Edit that, or remove this line to keep the file as your own.\n"
_IGNORE_FILE = ".dockerignore"
_USER = re.compile(r"[a-z_][a-z0-9_-]{0,31}")
_PACKAGE = re.compile(r"[a-z0-9][a-z0-9+.-]*(:[a-z0-9]+)?([=/][A-Za-z0-9.+~:*-]+)?")
#: What apt-get takes as a pattern of names; in Rigel 0.3 it is quoted for the shell.
_PATTERN = re.compile(r"""(['"]?)\^?[a-z0-9(\[][A-Za-z0-9+.*?^$|()\[\]-]*\1""")
_VARIABLE = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_LEFT_OUT = frozenset({"build", "devel", "install", "log", "logs"})
_UNBUILT = frozenset({"CATKIN_IGNORE", "COLCON_IGNORE", "AMENT_IGNORE"})


@attrs.frozen
class Compiler:
    """What builds the workspace.

    Attributes:
        name: `catkin_make`, `colcon`, or `none`; default: catkin_make for ROS 1, else colcon.
        cmake_args: CMake variables by name.
    """

    name: Literal["catkin_make", "colcon", "none"] | None = None
    cmake_args: Mapping[str, Scalar] = attrs.field(factory=dict)


@attrs.frozen
class DockerfileVariable:
    """An environment variable of the image.

    Attributes:
        name: the variable's name.
        value: its value; `$NAME` in it is expanded.
    """

    name: str
    value: Scalar = ""


@attrs.frozen
class DockerRun:
    """A command of `docker_run`, as a newer Rigel writes it.

    Attributes:
        command: the command.
    """

    command: str


@attrs.frozen
class DockerfileOptions:
    """The options of a Dockerfile job, those of Rigel's DockerfilePlugin and `rosdep`.

    Attributes:
        compiler: what builds the workspace, and with which CMake variables.
        command: the image's default command: text or a list of words.
        apt: Debian packages to install; also patterns, such as `libfoo*` and `^libfoo.*-dev$`.
        entrypoint: lines of shell to run in the container before its command.
        env: environment variables of the image.
        rosinstall: .rosinstall or .repos files whose repositories are built with the application.
        ros_image: the image to start from; default: ros:DISTRO.
        docker_run: commands to run as root while the image is built, before the sources are copied.
        python_requirements_files: requirements.txt files whose packages pip installs.
        username: the user that builds and runs; `root` creates none.
        rosdep: install what the package.xml files depend on; false: `apt` lists everything.
    """

    compiler: Compiler = attrs.field(factory=Compiler)
    command: str | Sequence[str] = ""
    apt: Sequence[str] = ()
    entrypoint: Sequence[str] = ()
    env: Sequence[DockerfileVariable] = ()
    rosinstall: Sequence[str] = ()
    ros_image: str | None = None
    docker_run: Sequence[str | DockerRun] = ()
    python_requirements_files: Sequence[str] = ()
    username: str = "rigeluser"
    rosdep: bool = True


class DockerfileJob:
    """Writes Dockerfile, dockerfile_entrypoint.sh and, if it does not exist, .dockerignore."""

    options: ClassVar[type[DockerfileOptions]] = DockerfileOptions
    needs_cluster: ClassVar[bool] = False

    def check(self, options: DockerfileOptions, application: Application) -> Sequence[Problem]:
        """Return what docker, apt or the compiler would refuse."""
        return [
            *_check_compiler(options, application),
            *_check_command(options),
            *_check_image(options),
            *_check_words(options),
        ]

    def exclusive(
        self, options: DockerfileOptions, application: Application, settings: Settings
    ) -> str | None:
        """Return the file that two jobs must not write at the same time."""
        return str((application.dir / DOCKERFILE).resolve())

    def run(self, options: DockerfileOptions, job: JobContext) -> None:
        """Write the files that changed; UserError if one of them is the user's own."""
        directory = job.application.dir
        if not directory.is_dir():
            raise UserError(
                f"application.dir: the directory {directory} does not exist",
                hint="set it to the directory of the sources, relative to the Rigelfile",
            )
        recipe = _recipe(options, job.application)
        _check_files("rosinstall", recipe.rosinstall, directory)
        _check_files("python_requirements_files", recipe.python_requirements, directory)
        script = f"#!/bin/bash\n{_MARK_LINE}{entrypoint(recipe)}"
        files = {
            directory / DOCKERFILE: f"{_MARK_LINE}{dockerfile(recipe)}",
            directory / ENTRYPOINT_FILE: script,
        }
        for file in files:
            _refuse_foreign(file)
        if _is_ours(directory / _IGNORE_FILE):
            files[directory / _IGNORE_FILE] = f"{_MARK_LINE}{render_dockerignore(recipe.packages)}"
        if not recipe.builds:
            job.report.line(
                f"nothing to compile in {directory}: the sources are copied as they are"
            )
        for file, text in files.items():
            _write(file, text, job.report)


def _recipe(options: DockerfileOptions, application: Application) -> Recipe:
    directory = application.dir
    command = options.command
    return Recipe(
        distro=application.distro,
        base=options.ros_image or f"ros:{application.distro}",
        source_name=re.sub(r"[^\w.-]", "_", directory.resolve().name) or "application",
        packages=tuple(sorted(_packages(directory))),
        compiler=_compiler(options, application),
        cmake_args={name: text_of(value) for name, value in options.compiler.cmake_args.items()},
        rosdep=options.rosdep,
        apt=tuple(package.strip("'\"") for package in options.apt),
        env=tuple((variable.name, text_of(variable.value)) for variable in options.env),
        docker_run=tuple(r if isinstance(r, str) else r.command for r in options.docker_run),
        python_requirements=tuple(options.python_requirements_files),
        entrypoint=tuple(options.entrypoint),
        rosinstall=tuple(options.rosinstall),
        command=command if isinstance(command, str) else tuple(command),
        username=options.username,
    )


def _compiler(options: DockerfileOptions, application: Application) -> str:
    ros1 = application.distro in DISTROS_1
    return options.compiler.name or ("catkin_make" if ros1 else "colcon")


def _packages(directory: Path) -> Iterator[str]:
    """Yield the directories with a package.xml, as catkin and colcon find them."""
    workspace = not (directory / "package.xml").exists()
    for place, names, files in os.walk(directory):
        here = Path(place).relative_to(directory)
        if _UNBUILT.intersection(files):
            names.clear()
        elif "package.xml" in files:
            names.clear()
            yield here.as_posix()
        else:
            top = workspace and here == Path()
            names[:] = [n for n in names if n[0] != "." and not (top and n in _LEFT_OUT)]


def _check_compiler(options: DockerfileOptions, application: Application) -> Iterator[Problem]:
    if options.compiler.name == "catkin_make" and application.distro not in DISTROS_1:
        message = f"catkin_make builds ROS 1, but {application.distro} is ROS 2: use colcon"
        yield Problem(("compiler", "name"), message, "bad-compiler")


def _check_command(options: DockerfileOptions) -> Iterator[Problem]:
    command = options.command
    if not isinstance(command, str) or has_template(command):
        return
    try:
        exec_form(command)
    except ValueError as error:
        message = f"the command cannot be split into words: {str(error).lower()}"
        yield Problem(("command",), message, "bad-command")


def _check_image(options: DockerfileOptions) -> Iterator[Problem]:
    if options.ros_image is None or has_template(options.ros_image):
        return
    try:
        parse_reference(options.ros_image)
    except UserError as error:
        yield Problem(("ros_image",), error.message, "bad-image")


def _check_words(options: DockerfileOptions) -> Iterator[Problem]:
    if not _fits(_USER, options.username):
        message = (
            f'invalid user name "{options.username}": use lower case letters, digits, "_" and "-"'
        )
        yield Problem(("username",), message, "bad-name")
    for number, package in enumerate(options.apt):
        if not _fits(_PACKAGE, package) and not _PATTERN.fullmatch(package):
            message = (
                f'invalid Debian package "{package}": write one NAME or NAME=VERSION per entry'
            )
            yield Problem(("apt", number), message, "bad-name")
    for number, variable in enumerate(options.env):
        if not _fits(_VARIABLE, variable.name):
            message = f'"{variable.name}" is not a name of an environment variable'
            yield Problem(("env", number, "name"), message, "bad-name")
        if "\n" in text_of(variable.value):
            message = (
                "a Dockerfile cannot set a value with several lines: export it in `entrypoint`"
            )
            yield Problem(("env", number, "value"), message, "bad-value")


def _fits(pattern: re.Pattern[str], text: str) -> bool:
    return has_template(text) or pattern.fullmatch(text) is not None


def _check_files(option: str, files: Sequence[str], directory: Path) -> None:
    for file in files:
        if not (directory / file).is_file():
            raise UserError(
                f"{option}: {directory} has no file {file}",
                hint="write its path relative to the application's directory, all that docker sees",
            )


def _is_ours(file: Path) -> bool:
    """Whether the file may be written: it does not exist, or begins with our mark."""
    if not file.is_file():
        return not os.path.lexists(file)
    return MARK in "".join(file.read_text("utf-8", errors="replace").splitlines()[:2])


def _refuse_foreign(file: Path) -> None:
    if not _is_ours(file):
        raise UserError(
            f"{file} was not written by this job, so it is not overwritten",
            hint="to generate it, remove the file; to keep it, remove this job from the sequence",
        )


def _write(file: Path, text: str, report: JobReporter) -> None:
    if file.exists() and file.read_text("utf-8") == text:
        report.line(f"{file} unchanged")
        return
    new = file.with_name(f".{file.name}.new")
    new.write_text(text, "utf-8")
    new.chmod(0o755 if file.suffix == ".sh" else 0o644)
    new.replace(file)
    report.line(f"{file} written")
