"""The Dockerfile job: what it refuses, and what it writes into a real directory."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import attrs
import pytest

from rigel_build.dockerfile import (
    Compiler,
    DockerfileJob,
    DockerfileOptions,
    DockerfileVariable,
    DockerRun,
)
from rigel_k8s.errors import UserError
from rigel_k8s.jobs.job import JobContext
from rigel_k8s.settings import Application, Settings
from tests.support.recorder import Recorder


@attrs.frozen
class Project:
    """An application's directory, and the job run on it."""

    directory: Path

    def run(self, **options: Any) -> list[str]:
        told = Recorder()
        application = Application("noetic", self.directory)
        DockerfileJob().run(
            DockerfileOptions(**options), JobContext("dockerfile", application, told)
        )
        return told.texts

    def text(self, name: str = "Dockerfile") -> str:
        return (self.directory / name).read_text()

    def package(self, place: str) -> None:
        (self.directory / place).mkdir(parents=True, exist_ok=True)
        (self.directory / place / "package.xml").write_text("<package/>")


@pytest.fixture
def project(tmp_path: Path) -> Project:
    directory = tmp_path / "my app"
    directory.mkdir()
    return Project(directory)


def test_writes_a_dockerfile_its_entrypoint_and_what_to_ignore(project: Project) -> None:
    """All three files are there, marked as ours, and told."""
    lines = project.run()
    for name in ("Dockerfile", "dockerfile_entrypoint.sh", ".dockerignore"):
        assert "Written by rigel-k8s" in project.text(name)
        assert f"{project.directory / name} written" in lines
    assert project.text("dockerfile_entrypoint.sh").startswith("#!/bin/bash\n")
    assert "FROM ros:noetic\n" in project.text()
    assert "ros_workspace/src/my_app/" in project.text()


def test_says_what_is_unchanged(project: Project) -> None:
    """A second run writes nothing; a changed option writes what it changes."""
    project.run()
    before = (project.directory / "Dockerfile").stat().st_mtime_ns
    names = ("Dockerfile", "dockerfile_entrypoint.sh", ".dockerignore")
    assert {f"{project.directory / name} unchanged" for name in names} <= set(project.run())
    assert (project.directory / "Dockerfile").stat().st_mtime_ns == before
    lines = project.run(command="true")
    assert f"{project.directory / 'Dockerfile'} written" in lines
    assert f"{project.directory / 'dockerfile_entrypoint.sh'} unchanged" in lines


@pytest.mark.parametrize("name", ["Dockerfile", "dockerfile_entrypoint.sh"])
def test_never_overwrites_what_the_user_wrote(name: str, project: Project) -> None:
    """A file without our mark stays as it is, nothing else is written, and the way out is told."""
    (project.directory / name).write_text("FROM mine\n")
    with pytest.raises(UserError, match="not written by this job") as caught:
        project.run()
    assert caught.value.hint
    assert project.text(name) == "FROM mine\n"
    assert [file.name for file in project.directory.iterdir()] == [name]


def test_a_dangling_link_is_not_ours(project: Project) -> None:
    """A link that leads nowhere is not written through."""
    (project.directory / "Dockerfile").symlink_to(project.directory / "elsewhere")
    with pytest.raises(UserError, match="not written by this job"):
        project.run()


def test_a_dockerignore_of_the_users_is_used_as_it_is(project: Project) -> None:
    """The user's .dockerignore does not stand in the way, and stays."""
    (project.directory / ".dockerignore").write_text("data\n")
    project.run()
    assert project.text(".dockerignore") == "data\n"


def test_packages_are_found_as_catkin_finds_them(project: Project) -> None:
    """Not below a package, not where CATKIN_IGNORE lies, not in what was built, not hidden."""
    for place in ("src/a", "src/a/inner", "src/b", "src/c", "devel/x", "install/y", ".cache/z"):
        project.package(place)
    (project.directory / "src/c/CATKIN_IGNORE").touch()
    project.run()
    copied = [line for line in project.text().splitlines() if "package.xml /" in line]
    assert [line.split()[2] for line in copied] == ["src/a/package.xml", "src/b/package.xml"]


def test_without_packages_the_sources_are_copied_and_that_is_told(project: Project) -> None:
    """A directory of plain scripts needs no compiler; who expected one reads why."""
    assert any("nothing to compile" in line for line in project.run())
    assert "catkin_make" not in project.text()
    project.package("a")
    assert not any("nothing to compile" in line for line in project.run())
    assert "catkin_make" in project.text()


def test_scalars_are_written_as_yaml_has_them(project: Project) -> None:
    """true stays true and 1.5 stays 1.5 in variables and CMake arguments."""
    project.package("a")
    project.run(
        compiler=Compiler(cmake_args={"A": True, "B": 2}),
        env=[DockerfileVariable("C", False), DockerfileVariable("D", 1.5)],
    )
    assert "--cmake-args -DA=true -DB=2" in project.text()
    assert 'ENV C="false"\nENV D="1.5"' in project.text()


def test_a_missing_rosinstall_file_is_told(project: Project) -> None:
    """The file is looked for before docker does, relative to the application's directory."""
    with pytest.raises(UserError, match=r"rosinstall: .* no file deps\.rosinstall"):
        project.run(rosinstall=["deps.rosinstall"])
    with pytest.raises(UserError, match=r"python_requirements_files: .* no file r\.txt"):
        project.run(python_requirements_files=["r.txt"])


def test_a_missing_directory_is_told(tmp_path: Path) -> None:
    """application.dir has to be there."""
    with pytest.raises(UserError, match=r"application\.dir"):
        Project(tmp_path / "none").run()


@pytest.mark.parametrize(
    ("options", "path", "message"),
    [
        ({"command": "echo 'a"}, ("command",), "no closing quotation"),
        ({"ros_image": "ros:noetic:x"}, ("ros_image",), "invalid image reference"),
        ({"username": "Robot One"}, ("username",), "invalid user name"),
        ({"apt": ["good", "a b"]}, ("apt", 1), 'invalid Debian package "a b"'),
        ({"apt": ["'x*; reboot'"]}, ("apt", 0), "invalid Debian package"),
        ({"apt": ["x; reboot"]}, ("apt", 0), "invalid Debian package"),
        ({"env": [DockerfileVariable("A-B")]}, ("env", 0, "name"), '"A-B" is not a name'),
        ({"env": [DockerfileVariable("A", "x\ny")]}, ("env", 0, "value"), "several lines"),
    ],
)
def test_what_would_fail_in_the_build_is_told_before(
    options: dict[str, Any], path: tuple[str | int, ...], message: str
) -> None:
    """Each problem has the path of its value."""
    (problem,) = DockerfileJob().check(DockerfileOptions(**options), Application("noetic"))
    assert problem.path == path
    assert message in problem.message


def test_catkin_make_is_for_ros_1() -> None:
    """catkin_make with a ROS 2 distribution is a mistake; without a name the right one is taken."""
    humble = Application("humble")
    (problem,) = DockerfileJob().check(DockerfileOptions(Compiler("catkin_make")), humble)
    assert "use colcon" in problem.message
    assert not DockerfileJob().check(DockerfileOptions(), humble)


def test_all_of_rigels_options_pass() -> None:
    """A Rigelfile of Rigel's users has no problem; what only a run can tell is let through."""
    options = DockerfileOptions(
        compiler=Compiler("catkin_make", {"-DCMAKE_BUILD_TYPE": "Release"}),
        command="roslaunch a b.launch",
        apt=[
            *("ros-noetic-tf", "curl=7.*", "libc6:amd64", "x/stable"),
            *("libfoo*", "'^libbar.*-dev'", '"libb?z[12]"'),
        ],
        entrypoint=["export A=1"],
        env=[DockerfileVariable("A", "b")],
        rosinstall=["a.rosinstall"],
        ros_image="{{ data.base }}",
        docker_run=["echo 'x'", DockerRun("echo y")],
        python_requirements_files=["requirements.txt"],
        username="{{ data.user }}",
    )
    assert DockerfileJob().check(options, Application("noetic")) == []


def test_two_jobs_of_one_directory_exclude_each_other(tmp_path: Path) -> None:
    """The runner is told what two jobs must not write side by side."""
    job, options = DockerfileJob(), DockerfileOptions()
    places = [Application("noetic", tmp_path / name) for name in ("a", "a/../a", "b")]
    assert len({job.exclusive(options, place, Settings()) for place in places}) == 2
