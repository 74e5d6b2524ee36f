"""Each command's words arrive at its action as they were meant; results come out as documented."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
import pytest
import yaml
from click.testing import CliRunner, Result

from rigel_k8s.app.generation import GENERATIONS
from rigel_k8s.cli import tables, width
from rigel_k8s.cli.main import cli
from rigel_k8s.cli.pods import port_pair
from rigel_k8s.cli.rigelfiles import count
from rigel_k8s.cli.words import Timeout
from rigel_k8s.commands import doctor as doctors
from rigel_k8s.commands import fleet, pods, releases, targets
from rigel_k8s.commands import run as runs
from rigel_k8s.commands.logs import lines as log_lines
from rigel_k8s.commands.logs import reading as logs
from rigel_k8s.errors import ProblemsError, UserError
from rigel_k8s.objects.refs import ObjectRef
from rigel_k8s.problems import Problem
from rigel_k8s.release.history import Entry
from rigel_k8s.release.types import Plan, ReleaseId, Step
from rigel_k8s.rigelfile import render_starter
from rigel_k8s.settings import Settings
from rigel_lab import cluster as local
from rigel_lab.images import ros1base
from rigel_lab.images.base import delivery

GLOBAL = ["-f", "robots/Rigelfile", "--context", "lab", "--kubeconfig", "kc", "-n", "test"]
SETTINGS = Settings(Path("robots/Rigelfile"), "lab", Path("kc"), "test")


class Recorder:
    """Stands for an action: keeps what it was called with."""

    def __init__(self, result: Any = None) -> None:
        self.result = result
        self.calls: list[tuple[tuple[Any, ...], dict[str, Any]]] = []

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        self.calls.append((args, kwargs))
        return self.result

    @property
    def args(self) -> tuple[Any, ...]:
        return self.calls[-1][0]

    @property
    def kwargs(self) -> dict[str, Any]:
        return self.calls[-1][1]


def call(*words: str, **options: Any) -> Result:
    """Run the command line with all global options."""
    result = CliRunner().invoke(cli, [*GLOBAL, *words], standalone_mode=False, **options)
    if result.exception:
        raise result.exception
    return result


@pytest.fixture
def record(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Put a recorder in an action's place."""

    def put(module: Any, name: str, result: Any = None) -> Recorder:
        recorder = Recorder(result)
        monkeypatch.setattr(module, name, recorder)
        return recorder

    return put


def test_run(record: Any) -> None:
    """`run sequence NAME` with a time and --adopt."""
    action = record(runs, "run")
    call("run", "sequence", "demo", "--timeout", "5m", "--adopt")
    kind, name, settings, _ = action.args
    assert (kind, name) == ("sequence", "demo")
    assert settings == Settings(
        Path("robots/Rigelfile"), "lab", Path("kc"), "test", timeout=300, adopt=True
    )


def test_render(record: Any) -> None:
    """Warnings go to standard error, so that the YAML can be piped on."""
    found = releases.Manifests(({"kind": "A"}, {"kind": "B"}), ("R:1:1: beware [x]",))
    action = record(releases, "render", found)
    done = call("render", "deploy", "--data", "robot=r1", "--data", "count=2", "--data", "a=b: c")
    data = {"robot": "r1", "count": 2, "a": "b: c"}
    assert action.args == (SETTINGS, "deploy", data)
    assert done.stdout == "---\nkind: A\n---\nkind: B\n"
    assert done.stderr == "R:1:1: beware [x]\n"


@pytest.mark.parametrize(("changes", "code"), [(True, 1), (False, 0)])
def test_diff(record: Any, *, changes: bool, code: int) -> None:
    """The exit code tells only where asked to, the summary counts."""
    ref = ObjectRef("v1", "Service", "test", "a")
    keep, change = Step("keep", ref), Step("change", ref)
    steps = (keep, change) if changes else (keep,)
    text = "--- a\n+++ b\n@@ -1 +1 @@\n-old\n+new\n" if changes else ""
    action = record(releases, "diff", releases.Difference(steps, text, ()))
    done = call("diff", "--exit-code", "--adopt", color=True)
    assert done.return_value == code
    assert call("diff").return_value == 0
    assert action.calls[0][0][0].adopt is True
    assert done.stderr == ("1 to change, 1 unchanged\n" if changes else "1 unchanged\n")
    assert ("\x1b[32m+new\x1b[0m" in done.stdout) is changes


def test_a_cluster_that_is_up_has_the_current_context(record: Any) -> None:
    """Which may have been another one before."""
    there = local.ClusterStatus("a", "rigel-a", True, "s", "r:5000", "v1.37.2", (), "", "/logs")
    record(local, "up", there)
    words = "Your kubeconfig's current context is rigel-a now"
    assert words in call("cluster", "up", "--name", "a").stdout


def test_logs_of_a_node_with_two_pods_name_the_pod(record: Any) -> None:
    """Of a failed update, say; a note is of the node."""
    pods = ("talker-1", "talker-1", "talker-2", "talker-1")
    record(logs, "logs", [log_lines.LogLine("talker", pod, pod[-1]) for pod in pods])
    assert call("logs", "talker").stdout == "1\n1\n[talker-2] 2\n[talker-1] 1\n"


def test_logs(record: Any) -> None:
    """Options of kubectl's meaning; our own notes are no output of a node's."""
    lines = [
        log_lines.LogLine("talker", "talker-1", "hello"),
        log_lines.LogLine("listener", "listener-1", "no log yet", note=True),
    ]
    action = record(logs, "logs", lines)
    done = call(
        "logs", "-f", "-p", "--since", "5m", "--tail", "3", "--timestamps", "talker", "listener"
    )
    options = log_lines.LogOptions(follow=True, since=300, tail=3, previous=True)
    assert action.args == (SETTINGS, ("talker", "listener"), options, None)
    assert done.stdout == "[talker] hello\n"
    assert done.stderr == "[listener] no log yet\n"
    assert call("logs", "talker").stdout == "hello\n"
    call("logs", "--job", "second")
    assert action.args[3] == "second"


@pytest.mark.parametrize(
    ("words", "tail"),
    [
        ("-f", 10),
        ("", None),
        ("-f --tail 0", 0),
        ("-f --since 1h", None),
        ("-f --level warn", None),
    ],
)
def test_a_follow_begins_with_the_last_lines(record: Any, words: str, tail: int | None) -> None:
    action = record(logs, "logs", [])
    call("logs", *words.split())
    assert action.args[2].tail == tail


def test_a_line_does_nothing_to_the_terminal_but_color_it(record: Any) -> None:
    """roscore's first line sets the terminal's title."""
    text = "\x1b]2;roscore\x07\x1b[33m[WARN] late\x1b[0m\x1b[2J\x1b]0;x\x1b\\ \x9b2J\r\x1bc!"
    record(logs, "logs", [log_lines.LogLine("talker", "talker-1", text)])
    done = CliRunner().invoke(cli, ["logs", "talker"], color=True)
    assert done.stdout == "\x1b[33m[WARN] late\x1b[0m 2J!\n"


def test_exec(record: Any) -> None:
    """What stands behind -- is the command's, its exit code is ours."""
    action = record(pods, "execute", 7)
    done = call("exec", "-i", "talker", "--", "rostopic", "echo", "-n", "1", "/chatter")
    assert done.return_value == 7
    settings, node, command = action.args
    assert (settings, node) == (SETTINGS, "talker")
    assert command == ("rostopic", "echo", "-n", "1", "/chatter")
    assert action.kwargs["stdin"] is not None
    assert action.kwargs["tty"] is False


def test_exec_without_a_command_is_a_shell(record: Any) -> None:
    """Its standard input is ours; a terminal only where there is one."""
    action = record(pods, "execute", 0)
    call("exec", "talker")
    assert action.args[2] == ()
    assert action.kwargs["stdin"] is not None
    assert "not a terminal" in call("exec", "-it", "talker").stderr
    assert action.kwargs["tty"] is False


def test_forward(record: Any) -> None:
    """LOCAL:REMOTE as kubectl has it."""
    action = record(pods, "forward", ["127.0.0.1:80 -> a:90"])
    assert call("forward", "talker", "80:90", "7000").stdout == "127.0.0.1:80 -> a:90\n"
    assert action.args == (SETTINGS, "talker", {90: 80, 7000: 7000}, None)


@pytest.mark.parametrize(
    ("text", "pair"), [("80", (80, 80)), ("8080:80", (80, 8080)), (":80", (80, 0))]
)
def test_ports(text: str, pair: tuple[int, int]) -> None:
    """PORT, LOCAL:REMOTE and :REMOTE."""
    assert port_pair(text) == pair


@pytest.mark.parametrize("text", ["", "0", "70000", "a", "1:2:3", "80:", "-1", "99999:80"])
def test_ports_that_are_none(text: str) -> None:
    """The message says how a port is written."""
    with pytest.raises(click.BadParameter, match=r"invalid port .*: use PORT"):
        port_pair(text)


@pytest.mark.parametrize(
    ("text", "seconds"), [("90", 90), ("90s", 90), ("5m", 300), ("1.5h", 5400)]
)
def test_durations(text: str, seconds: float) -> None:
    """As people write them."""
    assert Timeout().convert(text, None, None) == seconds


@pytest.mark.parametrize("text", ["", "m", "0", "-5s", "5 days", "nan", "inf"])
def test_durations_that_are_none(text: str) -> None:
    """The message says how one is written."""
    with pytest.raises(click.BadParameter, match="invalid duration"):
        Timeout().convert(text, None, None)


def test_history(record: Any) -> None:
    """A table for people, JSON for scripts."""
    values = {
        "number": 1,
        "status": "good",
        "created": "2026-01-01T00:00:00Z",
        "by": "ada@laptop",
        "description": "d",
        "images": ["robot:1"],
        "changes": ["talker: changed"],
    }
    record(releases, "history", [SimpleNamespace(**values)])
    assert json.loads(call("history", "-o", "json").stdout) == [values]
    head, row = (" ".join(line.split()) for line in call("history").stdout.splitlines())
    assert head == "REVISION STATUS AGE BY DESCRIPTION IMAGE CHANGES"
    assert row.startswith("1 good ")
    assert row.endswith(" ada@laptop d robot:1 talker: changed")


def test_changes_in_a_history_are_readable_in_a_narrow_terminal(
    record: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """They go on in the next lines: the old value and the new one are what they are read for."""
    for module in (tables, width):
        monkeypatch.setattr(module, "find_room", lambda _: 80)
    tags = "to ".join(f"registry.example:5000/team/robot:{tag} " for tag in (1, 2)).strip()
    changes = ("brake.parameters.limit: 1.8 to 1.6", f"image {tags}", "lidar is new")
    by, image = "ada@workstation", "registry.example/team/robot:1.2"
    description = "deploy with new limits"
    entries = [
        Entry(3, "superseded", "", by, description, (image,), given, ())
        for given in (changes, changes[2:])
    ]
    record(releases, "history", entries)
    heads, *lines = call("history").stdout.splitlines()
    assert max(map(len, lines)) <= 80
    begin = heads.index("CHANGES")
    assert " ".join(line[begin:] for line in lines) == f"{'; '.join(changes)} lidar is new"
    further = lines[1:-1]
    assert further
    assert not "".join(line[:begin] for line in further).strip()


@pytest.mark.parametrize(
    ("words", "passed"),
    [(["3"], (None, 3)), (["robot", "3"], ("robot", 3)), (["4", "3"], ("4", 3))],
)
def test_one_revision(record: Any, words: list[str], passed: tuple[Any, ...]) -> None:
    """By its number, with or without the release's name."""
    entry = Entry(3, "good", "2026-01-01T00:00:00Z", "ada", "d", ("robot:1",), ("a: 1 to 2",), ())
    revision = SimpleNamespace(failure="", source="/robot", options={"image": "robot:1"})
    asked = record(releases, "show", (entry, revision))
    text = call("history", *words).stdout
    assert asked.args[1:] == passed
    shown = yaml.safe_load(text)
    assert (shown["revision"], shown["changes"]) == (3, ["a: 1 to 2"])
    assert shown["with"] == {"image": "robot:1"}
    assert json.loads(call("history", *words, "-o", "json").stdout) == shown


def test_revisions_are_compared(record: Any) -> None:
    """Two at most."""
    asked = record(releases, "compare", "-a\n+b")
    done = call("diff", "--revision", "3", "--revision", "5", "--exit-code")
    assert (asked.args[1:], done.stdout) == ((None, 3, 5), "-a\n+b\n")
    with pytest.raises(UserError, match="more than twice"):
        call("diff", *["--revision", "1"] * 3)


def test_rollback(record: Any) -> None:
    """To a number or to the last good one; --job where there are several releases."""
    new = SimpleNamespace(number=4, description="rollback to revision 2")
    chosen = record(targets, "release", "b")
    action = record(releases, "rollback", new)
    assert call("rollback", "2", "--job", "b").stdout == "revision 4: rollback to revision 2\n"
    assert (chosen.args[1], chosen.kwargs, action.args[2]) == ("b", {"named": True}, 2)
    call("rollback")
    assert (chosen.args[1], action.args[2]) == (None, None)


def test_down(record: Any) -> None:
    """Data goes only with --volumes, and then only after a yes."""
    ref = ObjectRef("v1", "Service", "test", "a")
    plan = Plan(ReleaseId("test", "app"), (Step("prune", ref), Step("forget", ref)))
    record(targets, "release", SimpleNamespace(id=plan.release))
    action = record(releases, "down", plan)
    left = "1 kept for its data: a (--volumes deletes it)"
    assert call("down").stdout == f"removed app from test: 1 object deleted, {left}\n"
    assert action.kwargs == {"volumes": False}
    call("down", "--volumes", "-y")
    assert action.kwargs == {"volumes": True}
    record(releases, "down", Plan(plan.release, ()))
    assert call("down").stdout == "there is no release app in the namespace test\n"


def test_down_of_a_sequence(record: Any) -> None:
    """A line for each release, also for one that did not exist."""
    ref = ObjectRef("v1", "Service", "r1", "a")
    there, missing = ReleaseId("r1", "app"), ReleaseId("r2", "app")
    plan = Plan(there, (Step("prune", ref),))
    action = record(fleet, "down", [(there, plan), (missing, Plan(missing, ()))])
    assert call("down", "--sequence", "fleet").stdout == (
        "removed app from r1: 1 object deleted\nthere is no release app in the namespace r2\n"
    )
    assert action.args[:2] == (SETTINGS, "fleet")
    with pytest.raises(click.UsageError, match="either a job or a sequence"):
        call("down", "deploy", "--sequence", "fleet")


def test_down_does_not_ask_where_nobody_can_answer(record: Any) -> None:
    """In a script --volumes without -y deletes nothing and says how to say yes."""
    record(targets, "release", SimpleNamespace(id=ReleaseId("test", "app")))
    action = record(releases, "down")
    with pytest.raises(Exception, match="no terminal to ask"):
        call("down", "--volumes")
    assert action.calls == []


@pytest.mark.parametrize(("answer", "code"), [("y", 0), ("n", 1)])
def test_down_asks_in_a_terminal(
    record: Any, monkeypatch: pytest.MonkeyPatch, answer: str, code: int
) -> None:
    """It deletes a running robot, and nothing is deleted without a yes."""
    release = ReleaseId("test", "app")
    record(targets, "release", SimpleNamespace(id=release))
    action = record(releases, "down", Plan(release, ()))
    there = SimpleNamespace(stdin=SimpleNamespace(isatty=lambda: True))
    monkeypatch.setattr("rigel_k8s.cli.releases.sys", there)
    done = call("down", input=answer)
    assert "Delete app from test?" in done.output
    assert ((done.return_value or 0), len(action.calls)) == (code, 1 - code)
    call("down", "-y")
    assert len(action.calls) == 2 - code


@pytest.mark.parametrize(
    ("words", "kind"), [(("job", "a"), "job"), (("sequence", "a"), "sequence"), (("a",), None)]
)
def test_run_takes_a_name_alone(record: Any, words: tuple[str, ...], kind: str | None) -> None:
    """What it is, the Rigelfile says."""
    action = record(runs, "run")
    call("run", *words)
    assert action.args[:2] == (kind, "a")
    for wrong in (("task", "a"), ("job", "a", "b")):
        with pytest.raises(click.UsageError, match="name one job or one sequence"):
            call("run", *wrong)


@pytest.mark.parametrize(
    ("errors", "warnings", "text"),
    [
        (0, 0, "no problems"),
        (0, 1, "1 warning, no errors"),
        (1, 0, "1 error"),
        (2, 3, "2 errors, 3 warnings"),
    ],
)
def test_check_counts(errors: int, warnings: int, text: str) -> None:
    """A warning is not nothing, and many errors have a total."""
    assert count(errors, warnings) == text


def test_doctor(record: Any) -> None:
    """A line for each need, what to do where one lacks, exit code 1."""
    found = [
        doctors.Need("cluster", "lab, v1.34.4"),
        doctors.lack("storage", "none", "make one"),
    ]
    record(doctors, "examine", found)
    done = call("doctor")
    assert done.return_value == 1
    assert done.stdout == "✓ cluster: lab, v1.34.4\n✗ storage: none\n    make one\n"
    cluster, storage = json.loads(call("doctor", "-o", "json").stdout)
    assert (cluster["problem"], storage["problem"]["remedy"]) == (None, "make one")


def test_doctor_warns(record: Any) -> None:
    """A warning has a sign of its own, and the exit code of success: a deploy works."""
    problem = Problem((), "clocks: differ", "clocks-differ", "warning", remedy="run chrony")
    record(doctors, "examine", [doctors.Need("clocks", "differ", problem)])
    done = call("doctor")
    assert (done.return_value, done.stdout) == (0, "! clocks: differ\n    run chrony\n")


def test_image(record: Any) -> None:
    """The name that was pushed goes to standard output, for scripts."""
    built = record(ros1base, "build", "the archive")
    delivered = record(delivery, "deliver", "host:5000/ros:noetic")
    words = ("--push", "host:5000/ros:noetic", "--variant", "devel", "--arch", "arm64")
    done = call("image", "ros1-base", *words)
    assert done.stdout == "host:5000/ros:noetic\n"
    assert built.kwargs == {"variant": "devel", "arch": "arm64", "force": False}
    assert delivered.args[:2] == ("the archive", "host:5000/ros:noetic")


@pytest.fixture
def starter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A directory with what `rigel init` writes."""
    monkeypatch.chdir(tmp_path)
    CliRunner().invoke(cli, ["init", "--ros", "1"], catch_exceptions=False)
    return tmp_path / "Rigelfile"


def test_init_writes_what_check_takes(starter: Path) -> None:
    """The first two commands of a new user work; a file that is there is not overwritten."""
    done = CliRunner().invoke(cli, ["check"], standalone_mode=False)
    assert (done.return_value, done.stdout) == (0, "Rigelfile: no problems\n")
    starter.write_text("mine")
    refused = CliRunner().invoke(cli, ["init"], standalone_mode=False)
    assert "already exists" in str(refused.exception)
    assert starter.read_text() == "mine"
    CliRunner().invoke(cli, ["init", "--force"], catch_exceptions=False)
    assert "rigel run sequence demo" in starter.read_text()


def test_init_writes_one_for_ros2_by_default(starter: Path) -> None:
    """It passes the check, for a distribution of ROS 2, with the network said."""
    CliRunner().invoke(cli, ["init", "--force"], catch_exceptions=False)
    done = CliRunner().invoke(cli, ["check"], standalone_mode=False)
    assert (done.return_value, done.stdout) == (0, "Rigelfile: no problems\n")
    assert "distro: lyrical" in starter.read_text()


@pytest.mark.parametrize(
    ("words", "shell", "distro"),
    [
        (["--ros", "jazzy"], "humble", "jazzy"),
        (["--ros", "1"], "humble", "noetic"),
        (["--ros", "melodic"], "", "melodic"),
        ([], "humble", "humble"),
        ([], "noetic", "noetic"),
        ([], "unheard-of", "lyrical"),
    ],
)
def test_init_writes_it_for_a_distribution(
    starter: Path, monkeypatch: pytest.MonkeyPatch, words: list[str], shell: str, distro: str
) -> None:
    """Without one, for that of the shell; its packages are those of the distribution, too."""
    monkeypatch.setenv("ROS_DISTRO", shell)
    CliRunner().invoke(cli, ["init", "--force", *words], catch_exceptions=False)
    text = starter.read_text()
    assert f"distro: {distro}\n" in text
    assert f"apt: [ros-{distro}-" in text
    done = CliRunner().invoke(cli, ["check"], standalone_mode=False)
    assert done.return_value == 0, done.stdout


def test_init_for_what_is_no_distribution(starter: Path) -> None:
    done = CliRunner().invoke(cli, ["init", "--force", "--ros", "jazy"], standalone_mode=False)
    assert str(done.exception) == '"jazy" is no distribution of ROS, did you mean "jazzy"?'


@pytest.mark.parametrize("ros", ["1", "2"])
def test_machines_can_pull_from_the_registry_of_init(ros: str) -> None:
    """On another machine `localhost` is that machine."""
    registry = yaml.safe_load(render_starter(GENERATIONS[ros].starter))["vars"]["registry"]
    assert not registry.startswith(("localhost", "127."))


PARAMETERS = """\
application: {distro: noetic}
jobs:
  deploy:
    plugin: rigel_k8s.OrchestrationPlugin
    with:
      deploy_ros_master: true
      parameter_files: [missing.yaml, {file: list.yaml}]
      nodes:
        arm: {image: a, args: [arm], parameter_files: [good.yaml, broken.yaml]}
"""


@pytest.mark.parametrize("command", ["check", "render"])
def test_parameter_files_are_read_by_check_and_render(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each that is missing or wrong is a problem of its place, with the line in a broken file."""
    monkeypatch.chdir(tmp_path)
    Path("Rigelfile").write_text(PARAMETERS)
    Path("list.yaml").write_text("- a\n")
    Path("good.yaml").write_text("speed: 1\n")
    Path("broken.yaml").write_text("speed: 1\nrate: [1, 2\nframe: base\n")
    done = CliRunner().invoke(cli, [command], standalone_mode=False)
    if isinstance(done.exception, ProblemsError):
        shown, code = "\n".join(done.exception.details), done.exception.exit_code
    else:
        shown, code = done.stdout, done.return_value
    found = re.findall(r"^Rigelfile:(\d+:\d+): (.*) \[bad-parameter-file\]$", shown, re.M)
    assert code == 2
    assert [place for place, _ in found] == ["7:25", "7:46", "9:67"]
    missing, listed, broken = (message for _, message in found)
    assert "missing.yaml: No such file or directory" in missing
    assert listed.endswith("list.yaml is not a mapping of parameter names to values")
    assert "broken.yaml:3:6 is not YAML: " in broken


def test_a_parameter_file_with_a_template_waits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An earlier job may store its name."""
    monkeypatch.chdir(tmp_path)
    named = PARAMETERS.replace("[good.yaml, broken.yaml]", '["{{ data.file }}"]')
    Path("Rigelfile").write_text(named.replace("[missing.yaml, {file: list.yaml}]", "[]"))
    done = CliRunner().invoke(cli, ["check"], standalone_mode=False)
    assert (done.return_value, done.stdout) == (0, "Rigelfile: no problems\n")


def test_check_tells_in_json(starter: Path) -> None:
    """Editors and scripts get places; exit code 2 as without -o."""
    starter.write_text(starter.read_text().replace("deploy_ros_master: true", "deploy_ros: true"))
    done = CliRunner().invoke(cli, ["check", "-o", "json"], standalone_mode=False)
    assert done.return_value == 2
    (finding,) = json.loads(done.stdout)
    assert finding["kind"] == "unknown-key"
    assert (finding["file"], finding["severity"]) == ("Rigelfile", "error")
    line = starter.read_text().splitlines()[finding["line"] - 1]
    assert line[finding["column"] - 1 :].startswith("deploy_ros: true")


def test_schema_is_json(starter: Path) -> None:
    """An editor can load it."""
    done = CliRunner().invoke(cli, ["schema"], catch_exceptions=False)
    assert json.loads(done.stdout)["type"] == "object"


def test_names_are_completed_from_the_rigelfile(starter: Path) -> None:
    """`rigel render <TAB>` offers the jobs that deploy, and so on; a broken file offers nothing."""
    from click.shell_completion import ShellComplete

    def offered(*words: str, begin: str = "") -> list[str]:
        completion = ShellComplete(cli, {}, "rigel", "_RIGEL_COMPLETE")
        return [item.value for item in completion.get_completions(list(words), begin)]

    assert offered("render") == ["deploy"]
    assert offered("-f", str(starter), "logs", "--job") == ["deploy"]
    assert offered("logs", "-f") == ["talker", "listener", "ros-master"]
    assert offered("exec", begin="l") == ["listener"]
    assert offered("run", "sequence") == ["demo", "update"]
    assert offered("run", "job", begin="b") == ["build"]
    starter.write_text("jobs: [")
    assert offered("render") == offered("logs") == offered("run", "job") == []


@pytest.mark.programs
@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion(shell: str) -> None:
    """The script that a shell sources."""
    done = CliRunner().invoke(cli, ["completion", shell], prog_name="rigel")
    assert "_RIGEL_COMPLETE" in done.stdout
