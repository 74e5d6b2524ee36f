"""Job types as Rigel's plugins, in classes of the same interface (test_real_rigel.py: Rigel)."""

from __future__ import annotations

import logging
import subprocess
import sys
import threading
import types
from pathlib import Path
from typing import Any

import pytest

import rigel_k8s
from rigel_build.dockerfile import DockerfileJob
from rigel_k8s.compat.plugin import LogReport
from rigel_k8s.errors import Interrupted, RigelK8sError
from rigel_k8s.jobs.types.container_registry import ContainerRegistry
from rigel_k8s.problems import Problem

from .rigelfiles import DOCKERFILE

REGISTRY = "{server: reg.example, username: u, password: p}"


class Plugin:
    """What a plugin of Rigel 0.3 must be a subclass of."""

    def __init__(
        self,
        raw_data: Any,
        global_data: Any,
        application: Any,
        providers_data: Any,
        shared_data: Any = None,
    ) -> None:
        self.raw_data = raw_data

    def setup(self) -> None: ...
    def start(self) -> None: ...
    def process(self) -> None: ...
    def stop(self) -> None: ...


class Provider:
    """What a provider of Rigel 0.3 must be a subclass of."""

    def __init__(self, identifier: str, raw: Any, global_data: Any, providers_data: Any) -> None:
        self.identifier = identifier
        self.providers_data = providers_data

    def connect(self) -> None: ...
    def disconnect(self) -> None: ...


class RigelError(Exception):
    """What Rigel's command line catches."""


@pytest.fixture
def rigel(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rigel has been imported already."""
    members = {
        "rigel": {},
        "rigel.plugins": {"Plugin": Plugin},
        "rigel.plugins.plugin": {"Plugin": Plugin},
        "rigel.providers": {"Provider": Provider},
        "rigel.providers.provider": {"Provider": Provider},
        "rigel.exceptions": {"RigelError": RigelError},
    }
    for name, content in members.items():
        module = types.ModuleType(name)
        vars(module).update(content)
        monkeypatch.setitem(sys.modules, name, module)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A directory with a Rigelfile, which is the current one."""
    (tmp_path / "Rigelfile").write_text(DOCKERFILE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def say(monkeypatch: pytest.MonkeyPatch, words: str) -> None:
    monkeypatch.setattr(sys, "argv", words.split())


def given(command: str) -> dict[str, Any]:
    """What Rigel 0.3 makes of the job's `with`: it does not know the filter."""
    return {"ros_image": "{{ vars.base | regex_replace(':.*', ':1.10') }}", "command": command}


def test_without_rigel_the_name_is_the_job_type() -> None:
    """The same public name for both readers."""
    assert rigel_k8s.DockerfilePlugin is DockerfileJob
    assert rigel_k8s.ContainerRegistryProvider is ContainerRegistry


def test_an_unknown_name_is_no_attribute() -> None:
    """hasattr and import errors stay what they are."""
    for name in ("NoSuchPlugin", "anything"):
        with pytest.raises(AttributeError, match=name):
            getattr(rigel_k8s, name)


@pytest.mark.programs
def test_importing_the_package_imports_nothing_else() -> None:
    """`import rigel_k8s`, and a look for a submodule, cost nothing."""
    code = "import rigel_k8s, sys; hasattr(rigel_k8s, 'x');"
    code += "sys.exit(sum(m.startswith('rigel_k8s.') for m in sys.modules))"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_where_rigel_has_been_imported_it_is_a_plugin_of_rigels(rigel: None) -> None:
    """Rigel loads nothing but subclasses of its own; each name gives one class, always the same."""
    assert issubclass(rigel_k8s.DockerfilePlugin, Plugin)
    before = rigel_k8s.DockerfilePlugin
    assert rigel_k8s.BuildXPlugin is not before
    assert rigel_k8s.DockerfilePlugin is before
    assert rigel_k8s.DockerfilePlugin.__name__ == "DockerfilePlugin"
    assert issubclass(rigel_k8s.ContainerRegistryProvider, Provider)


def test_it_does_the_jobs_work_with_our_own_reading_of_the_file(
    rigel: None, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The filter is applied, 1.10 stays 1.10, and the work is done after start()."""
    say(monkeypatch, "rigel run job dockerfile")
    plugin = rigel_k8s.DockerfilePlugin(given("roslaunch a b.launch"), {}, None, {}, {})
    plugin.setup()
    assert not (here / "Dockerfile").exists()
    plugin.start()
    assert "ros:1.10" in (here / "Dockerfile").read_text()
    plugin.process()
    plugin.stop()
    assert (here / "Dockerfile").exists(), "stop() must not undo anything"


def test_a_sequences_overrides_are_followed(
    rigel: None, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The job is recognised by its data although Rigel does not say which it is."""
    say(monkeypatch, "rigel run sequence build")
    plugin = rigel_k8s.DockerfilePlugin(given("rosrun c d"), {}, None, {}, {})
    plugin.setup()
    plugin.start()
    assert '"rosrun", "c", "d"' in (here / "Dockerfile").read_text()


def test_what_is_wrong_is_rigels_error_with_our_words(
    rigel: None, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rigel logs it and exits with 1; the text has the line."""
    say(monkeypatch, "rigel run job deploy")
    raw = {"namespace": "Not_A_Name", "application_image": "a"}
    plugin = rigel_k8s.OrchestrationPlugin(raw, {}, None, {}, {})
    with pytest.raises(RigelError) as caught:
        plugin.setup()
    assert "Rigelfile:21:18:" in str(caught.value)
    assert "Not_A_Name" in str(caught.value)


def test_no_rigelfile_is_rigels_error(
    rigel: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever of ours goes wrong, Rigel's command line can tell it."""
    monkeypatch.chdir(tmp_path)
    say(monkeypatch, "rigel run job deploy")
    with pytest.raises(RigelError):
        rigel_k8s.DockerfilePlugin({}, {}, None, {}, {}).setup()


def running(
    monkeypatch: pytest.MonkeyPatch,
    work: Any,
    shared: dict[str, Any] | None = None,
    providers: dict[str, Any] | None = None,
) -> Any:
    """Return a plugin that is set up, whose job's work is a function."""
    monkeypatch.setattr(DockerfileJob, "run", lambda self, options, job: work(job))
    say(monkeypatch, "rigel run job dockerfile")
    plugin = rigel_k8s.DockerfilePlugin(
        given("roslaunch a b.launch"), {}, None, providers or {"p": 1}, shared
    )
    plugin.setup()
    return plugin


def test_data_and_connections_are_rigels(
    rigel: None, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What jobs store reaches Rigel's other plugins, and theirs ours."""
    shared = {"before": 1}

    def work(job: Any) -> None:
        job.data["after"] = (job.data["before"], job.providers["p"])

    running(monkeypatch, work, shared).start()
    assert shared == {"before": 1, "after": (1, 1)}


def test_a_failure_is_rigels_error(
    rigel: None, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the job's name, the details and the way out."""

    def work(job: Any) -> None:
        raise RigelK8sError("not ready", hint="see the log", details=["line 1"])

    with pytest.raises(RigelError) as caught:
        running(monkeypatch, work).start()
    assert str(caught.value).splitlines() == [
        "job dockerfile: not ready",
        "  line 1",
        "hint: see the log",
    ]


@pytest.mark.parametrize("name", ["rigel.providers.core.", "rigel_k8s."])
def test_the_registry_is_connected_once_for_our_plugins(
    rigel: None, here: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    """By ourselves where Rigel's own hands none on, else by Rigel, through ours."""
    text = (here / "Rigelfile").read_text()
    provider = f"{{provider: {name}ContainerRegistryProvider, with: {REGISTRY}}}"
    (here / "Rigelfile").write_text(f"{text}\nproviders: {{r: {provider}}}\n")
    events: list[str] = []

    def connect(self: Any, options: Any, name: str, report: Any) -> str:
        events.append(f"connect {name} {options.server}")
        return f"of {name}"

    monkeypatch.setattr(ContainerRegistry, "connect", connect)
    monkeypatch.setattr(ContainerRegistry, "disconnect", lambda self, c: events.append(f"end {c}"))
    connected: dict[str, Any] = {}
    if name == "rigel_k8s.":
        outer = rigel_k8s.ContainerRegistryProvider("r", {}, {}, connected)
        outer.connect()
    seen = []
    plugin = running(monkeypatch, lambda job: seen.append(job.providers["r"]), providers=connected)
    plugin.start()
    if name == "rigel_k8s.":
        outer.disconnect()
    assert seen == ["of r"]
    assert events == ["connect r reg.example", "end of r"]


def test_providers_that_only_rigel_knows_are_not_our_matter(
    rigel: None, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rigel has connected them; what they stored is handed on."""
    text = (here / "Rigelfile").read_text()
    (here / "Rigelfile").write_text(f"{text}\nproviders: {{s: {{provider: no.Ssh, with: {{}}}}}}\n")
    seen = []
    work = running(monkeypatch, lambda job: seen.append(dict(job.providers)), providers={"s": 2})
    work.start()
    assert seen == [{"s": 2}]


def test_warnings_are_logged(
    rigel: None,
    here: Path,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """What only deserves a look is told, with its place, and the job runs."""
    problem = Problem(("command",), "roslaunch is slow", "slow", "warning")
    monkeypatch.setattr(DockerfileJob, "check", lambda self, options, application: [problem])
    running(monkeypatch, lambda job: None)
    (record,) = caplog.records
    assert record.levelname == "WARNING"
    assert "roslaunch is slow [slow]" in record.getMessage()


def test_a_registry_that_refuses_is_rigels_error(
    rigel: None, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rigel tells it as one of its own."""

    def refuse(self: Any, options: Any, name: str, report: Any) -> None:
        raise RigelK8sError("wrong password")

    text = (here / "Rigelfile").read_text()
    provider = f"{{provider: rigel_k8s.ContainerRegistryProvider, with: {REGISTRY}}}"
    (here / "Rigelfile").write_text(f"{text}\nproviders: {{r: {provider}}}\n")
    monkeypatch.setattr(ContainerRegistry, "connect", refuse)
    with pytest.raises(RigelError, match="wrong password"):
        rigel_k8s.ContainerRegistryProvider("r", {}, {}, {}).connect()


def test_stop_from_a_signal_handler_ends_the_work_and_waits(
    rigel: None, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Rigel's handler calls stop() in the midst of start(); nothing is left half done."""
    at_work, events = threading.Event(), []

    def work(job: Any) -> None:
        at_work.set()
        assert job.cancel.wait(20)
        events.append("cleaned up")
        raise Interrupted("stopped")

    plugin = running(monkeypatch, work)
    caught: list[BaseException] = []

    def start() -> None:
        try:
            plugin.start()
        except RigelError as error:
            caught.append(error)

    thread = threading.Thread(target=start)
    thread.start()
    assert at_work.wait(20)
    plugin.stop()
    assert events == ["cleaned up"]
    thread.join(20)
    assert len(caught) == 1


def test_what_jobs_tell_is_logged_once_for_each_change(caplog: pytest.LogCaptureFixture) -> None:
    """Rigel's log gets a line for a change, with the part's name."""
    caplog.set_level(logging.INFO, logger="Rigel")
    report = LogReport()
    report.line("a")
    report.child("job").child("talker").progress("pod", "starting")
    again = report.child("job")
    for state in ("starting", "starting", "ready"):
        again.progress("pod", state)
    report.warn("careful")
    assert [(r.levelname, r.getMessage()) for r in caplog.records] == [
        ("INFO", "a"),
        ("INFO", "job: talker: pod: starting"),
        ("INFO", "job: pod: starting"),
        ("INFO", "job: pod: ready"),
        ("WARNING", "careful"),
    ]
