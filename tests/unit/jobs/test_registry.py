"""Names to job types: ours, entry points, import paths, Rigel's interface; and what is told."""

from __future__ import annotations

import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.errors import Interrupted, RigelK8sError, UserError
from rigel_k8s.jobs.importing import importable
from rigel_k8s.jobs.job import JobContext
from rigel_k8s.jobs.names import BUILTIN, list_installed
from rigel_k8s.jobs.registry import job_type, list_names, provider_type
from rigel_k8s.settings import Application
from rigel_k8s.system.trust import trust
from tests.support.recorder import Recorder


@pytest.fixture
def beside(tmp_path: Path) -> Iterator[Path]:
    """A trusted directory; modules imported from it are forgotten after the test."""
    before = set(sys.modules)
    trust(tmp_path)
    yield tmp_path
    for name in set(sys.modules) - before:
        if str(getattr(sys.modules[name], "__file__", "")).startswith(str(tmp_path)):
            del sys.modules[name]


def write(directory: Path, name: str, text: str) -> None:
    (directory / f"{name}.py").write_text(text)


GREET = """
import attrs

@attrs.frozen
class Options:
    whom: str

class Greet:
    options = Options
    def check(self, options, application): return ()
    def run(self, options, job): job.report.line(f"hello {options.whom}")
"""


@pytest.mark.parametrize(
    ("name", "short"),
    [
        ("src.plugin.OrchestrationPlugin", "orchestration"),
        ("rigel_k8s.OrchestrationPlugin", "orchestration"),
        ("rigel.plugins.core.DockerfilePlugin", "dockerfile"),
        ("rigel_k8s.DockerfilePlugin", "dockerfile"),
        ("rigel.plugins.core.BuildXPlugin", "buildx"),
        ("rigel_k8s.BuildXPlugin", "buildx"),
    ],
)
def test_names_of_rigel_and_of_the_peer_mean_ours(name: str, short: str) -> None:
    """A Rigelfile written for Rigel or src.plugin needs no change."""
    assert name in list_names("job")[short]


@pytest.mark.parametrize("kind", ["job", "provider"])
def test_every_name_of_ours_leads_to_a_class_that_fits(kind: Any) -> None:
    """The table of names and the modules of plugins/ agree, and each class keeps the seam."""
    from rigel_k8s.jobs.registry import validate

    resolve = job_type if kind == "job" else provider_type
    for builtin in (*BUILTIN[kind], *list_installed(kind)):
        for name in builtin.names:
            validate(type(resolve(name)), kind, name)


@pytest.mark.programs
def test_names_are_resolved_without_importing_other_job_types() -> None:
    """A file that is only checked for its grammar pays for no job type."""
    import subprocess

    code = (
        "import sys; from rigel_k8s.jobs.registry import list_names; list_names('job');"
        "sys.exit(any(m.startswith(('rigel_k8s.jobs.types', 'rigel_build')) for m in sys.modules))"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_class_beside_the_rigelfile_is_found_by_its_import_path(beside: Path) -> None:
    """`plugin: greet.Greet` with greet.py next to the Rigelfile."""
    write(beside, "greet", GREET)
    greet = job_type("greet.Greet", beside)
    assert greet.options.__name__ == "Options"
    assert str(beside) not in sys.path


def test_modules_beside_the_rigelfile_can_be_imported_while_it_runs(beside: Path) -> None:
    """A job that imports its neighbour late finds it, and sys.path is as before afterwards."""
    write(beside, "late", "X = 1")
    before = list(sys.path)
    with importable(beside):
        import late  # type: ignore[import-not-found]

        assert late.X == 1
    assert sys.path == before


def test_an_entry_point_is_found_by_its_name(beside: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An installed package offers a job type under a short name."""
    write(beside, "greet", GREET)
    dist = beside / "greet-1.dist-info"
    dist.mkdir()
    (dist / "METADATA").write_text("Metadata-Version: 2.1\nName: greet\nVersion: 1\n")
    (dist / "entry_points.txt").write_text("[rigel_k8s.jobs]\ngreet = greet:Greet\n")
    with monkeypatch.context() as patch:
        patch.syspath_prepend(str(beside))
        assert type(job_type("greet")).__name__ == "Greet"
        assert "greet" in list_names("job")


@pytest.mark.parametrize(
    ("name", "message", "hint"),
    [
        (
            "orchestratoin",
            'unknown job type "orchestratoin", did you mean orchestration?',
            "use one of",
        ),
        (
            "src.plugn.OrchestrationPlugin",
            "did you mean src.plugin.OrchestrationPlugin?",
            "use one of",
        ),
        ("nothing.at.All", 'unknown job type "nothing.at.All"', "beside the Rigelfile"),
        (
            "rigel.plugins.core.ComposePlugin",
            "is Rigel's own, and Rigel is not installed",
            "repository",
        ),
        (
            "rigel.plugins.core.DockerfilPlugin",
            "mean rigel.plugins.core.DockerfilePlugin?",
            "use one of",
        ),
        ("attr.x.Nothing", 'unknown job type "attr.x.Nothing"', "use one of"),
        (
            "rigel_k8s.OrchestrationPlugn",
            "module rigel_k8s has no OrchestrationPlugn",
            "did you mean rigel_k8s.OrchestrationPlugin?",
        ),
        ("attr.Zebra", "module attr has no Zebra", "check what attr defines"),
        ("antigravity.Job", 'unknown job type "antigravity.Job"', "use one of"),
        (".x.Y", 'unknown job type ".x.Y"', "use one of"),
        ("attr.validators", "attr.validators is a module, not a class", "class"),
    ],
)
def test_an_unknown_name_is_told_with_the_nearest(name: str, message: str, hint: str) -> None:
    """What is unknown, what it may have meant, what is known."""
    with pytest.raises(UserError) as caught:
        job_type(name)
    assert message in caught.value.message
    assert hint in str(caught.value.hint)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("import nothing_like_this\nclass Greet: pass", "ModuleNotFoundError: No module named"),
        ("class Greet(:", "SyntaxError"),
        ("1/0", "ZeroDivisionError"),
    ],
)
def test_a_module_that_breaks_is_not_called_unknown(beside: Path, text: str, message: str) -> None:
    """The file is there; what is wrong in it is told."""
    write(beside, "broken_greet", text)
    with pytest.raises(UserError, match="cannot import") as caught:
        job_type("broken_greet.Greet", beside)
    assert message in caught.value.message


@pytest.mark.parametrize(
    ("old", "new", "faults"),
    [
        ("options = Options", "", ["it has no `options`"]),
        ("options = Options", "options = 3", ["its `options` is 3, not an attrs class"]),
        (
            "run(self, options, job)",
            "run(self, options)",
            ["run(self, options) must be run(self, o"],
        ),
        ("run(self, options, job)", "go(self)", ["it has no method run(self, options, job)"]),
        ("check(self, options, app", "check(self, app", ["must be check(self, options, applicati"]),
        (
            "options = Options",
            "def __init__(self, x): pass",
            ["no `options`", "not need arguments"],
        ),
        (
            "options = Options",
            "options = Options\n    def exclusive(self): pass",
            ["exclusive(self) must be exclusive(self, options, application, settings)"],
        ),
    ],
)
def test_a_class_that_does_not_fit_is_told_with_method_and_signature(
    beside: Path, old: str, new: str, faults: list[str]
) -> None:
    """All that does not fit at once, when the class is resolved and not when it runs."""
    write(beside, "misfit", GREET.replace(old, new))
    with pytest.raises(UserError, match=r"misfit\.Greet is not a job type") as caught:
        job_type("misfit.Greet", beside)
    for fault in faults:
        assert fault in "\n".join((caught.value.message, *caught.value.details))


RIGEL_STYLE = """
class Hello:
    def __init__(self, raw_data, global_data, application, providers_data, shared_data={}):
        self.args = (raw_data, global_data, application, providers_data)
        self.shared = shared_data
        self.shared["calls"] = []
    def setup(self): self.shared["calls"].append("setup")
    def start(self): self.shared["calls"].append("start")
    def process(self):
        raw, vars, application, providers = self.args
        self.shared["calls"].append((raw, vars, application.distro, providers))
        PROCESS
    def stop(self): self.shared["calls"].append("stop")
"""


def rigel_style(beside: Path, process: str = "pass") -> Any:
    write(beside, "hello", "import threading\n" + RIGEL_STYLE.replace("PROCESS", process))
    return job_type("hello.Hello", beside)


def context(**more: Any) -> JobContext:
    return JobContext("j", Application("noetic"), Recorder(), vars={"v": 1}, **more)


def test_a_class_of_rigels_interface_runs_as_rigel_would_run_it(beside: Path) -> None:
    """setup, start, process, stop, with the five arguments; Rigel itself is not needed."""
    job = context(providers={"p": 2})
    rigel_style(beside).run({"a": "1.10"}, job)
    work = ({"a": "1.10"}, {"v": 1}, "noetic", {"p": 2})
    assert job.data["calls"] == ["setup", "start", work, "stop"]


def test_a_class_of_rigels_interface_is_stopped_when_it_fails(beside: Path) -> None:
    """Rigel forgets stop() there; exit() inside it is an error of the job, not of the program."""
    job = context()
    with pytest.raises(RigelK8sError, match=r"it called exit\(4\)"):
        rigel_style(beside, "raise SystemExit(4)").run({}, job)
    assert job.data["calls"][-1] == "stop"


def test_a_class_of_rigels_interface_serves_without_process(beside: Path) -> None:
    """A dependency is set up and started, says ready, and is stopped when it is cancelled."""
    job = context(serving=True)
    thread = threading.Thread(target=rigel_style(beside).run, args=({}, job))
    thread.start()
    assert job.ready.wait(20)
    assert job.data["calls"] == ["setup", "start"]
    job.cancel.set()
    thread.join(20)
    assert job.data["calls"] == ["setup", "start", "stop"]


def test_a_class_of_rigels_interface_is_stopped_while_it_works(beside: Path) -> None:
    """Cancelling calls stop() beside the running process(), once, as Rigel's handler does."""
    process = "self.shared['in'].set(); self.shared['out'].wait(20)"
    job = context(data={"in": threading.Event(), "out": threading.Event()})
    kind = rigel_style(beside, process)
    stop = sys.modules["hello"].Hello.stop

    def release(self: Any) -> None:
        stop(self)
        job.data["out"].set()

    sys.modules["hello"].Hello.stop = release
    caught: list[BaseException] = []

    def run() -> None:
        try:
            kind.run({}, job)
        except Interrupted as error:
            caught.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    assert job.data["in"].wait(20)
    job.cancel.set()
    thread.join(20)
    assert job.data["calls"].count("stop") == 1
    assert len(caught) == 1


def test_a_provider_of_rigels_interface_is_connected(beside: Path) -> None:
    """Jobs get what it stores under its name; disconnect reaches the same instance."""
    write(
        beside,
        "robots",
        "class Robots:\n"
        "    def __init__(self, identifier, raw_data, global_data, providers_data):\n"
        "        self.name, self.raw, self.data = identifier, raw_data, providers_data\n"
        "    def connect(self): self.data[self.name] = ['connected', self.raw]\n"
        "    def disconnect(self): self.data[self.name].append('disconnected')\n",
    )
    provider = provider_type("robots.Robots", beside)
    connection = provider.connect({"k": 1}, "r", Recorder())
    assert connection == ["connected", {"k": 1}]
    provider.disconnect(connection)
    assert connection == ["connected", {"k": 1}, "disconnected"]
