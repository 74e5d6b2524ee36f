"""Rigelfiles run whole: from text to jobs, with job types beside the file."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.errors import JobFailed, ProblemsError, UserError
from rigel_k8s.jobs import values
from rigel_k8s.rigelfile import load
from rigel_k8s.settings import Settings
from rigel_k8s.system.trust import trust
from tests.support.recorder import Recorder
from tests.support.running import run_job, run_sequence

TYPES = """
import attrs
from rigel_k8s.errors import RigelK8sError, UserError
from rigel_k8s.problems import Problem

@attrs.frozen
class Options:
    say: str = ""
    number: int = 0
    store: str = ""
    many: list[str] = attrs.Factory(list)
    release: str = ""

class Say:
    options = Options
    def check(self, options, application):
        if options.number < 0:
            return [Problem(("number",), "must not be negative", "bad-number")]
        if options.number == 13:
            return [Problem(("number",), "brings bad luck", "luck", "warning")]
        return []
    def run(self, options, job):
        if options.say == "fail":
            raise RigelK8sError("told to fail")
        job.report.line(f"{options.say} {options.number} {','.join(options.many)}".strip())
        job.data.setdefault("said", []).append(options.say)
        if options.store:
            job.data[options.store] = options.say
    def exclusive(self, options, application, settings):
        return options.release or None

class Provider:
    options = Options
    def check(self, options, application): return ()
    def connect(self, options, name, report):
        report.line(f"connected {name} {options.say}")
        return options.say
    def disconnect(self, connection): print("disconnected", connection)

class Rigels:
    def __init__(self, raw_data, global_data, application, providers_data, shared_data={}):
        self.all = (raw_data, global_data, application.distro, application.dir, providers_data)
        self.shared_data = shared_data
    def setup(self): pass
    def start(self): pass
    def process(self): self.shared_data["all"] = self.all
    def stop(self): pass
"""


@pytest.fixture
def directory(tmp_path: Path) -> Iterator[Path]:
    (tmp_path / "mine.py").write_text(TYPES)
    trust(tmp_path)
    yield tmp_path
    for name in ("mine", "lists"):
        sys.modules.pop(name, None)


def settings(directory: Path, text: str) -> Settings:
    path = directory / "Rigelfile"
    path.write_text("application: {distro: noetic}\n" + text)
    return Settings(rigelfile=path)


def sequence(directory: Path, text: str, told: Recorder, name: str = "s") -> dict[str, Any]:
    chosen = settings(directory, text)
    return run_sequence(load(chosen.rigelfile), name, settings=chosen, report=told)


def job(directory: Path, text: str, told: Recorder, name: str = "j") -> dict[str, Any]:
    chosen = settings(directory, text)
    return run_job(load(chosen.rigelfile), name, settings=chosen, report=told)


def test_a_job_runs_with_its_options(directory: Path, told: Recorder) -> None:
    """vars are in, the reporter bears the job's name, the data comes back."""
    text = "vars: {v: hello}\njobs: {j: {plugin: mine.Say, with: {say: '{{ vars.v }}', number: 2}}}"
    assert job(directory, text, told) == {"said": ["hello"]}
    assert ("/j", "line", "hello 2") in told.entries


def test_a_sequence_runs_its_stages_in_order_with_overrides(
    directory: Path, told: Recorder
) -> None:
    """`with` of a stage's entry replaces the job's keys one by one, and only there."""
    text = """
jobs:
  a: {plugin: mine.Say, with: {say: a, number: 1, store: x}}
  b: {plugin: mine.Say, with: {say: "{{ data.x }}b"}}
sequences:
  s:
    stages:
      - jobs: [{name: a, with: {number: 7}}, b]
      - {jobs: [a], dependencies: [b]}
"""
    sequence(directory, text, told)
    assert told.of("line") == ["a 7", "ab 0", "ab 0", "a 1"]


def test_options_that_wait_for_nothing_are_made_once(
    directory: Path, told: Recorder, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The check before the run has made them; only what another job stores is made again."""
    made: list[str] = []

    def realise(rigelfile: Any, spec: Any, *rest: Any) -> Any:
        made.append(spec.name)
        return again(rigelfile, spec, *rest)

    again = values.realise
    monkeypatch.setattr(values, "realise", realise)
    where = settings(
        directory,
        """
jobs:
  a: {plugin: mine.Say, with: {say: one, store: x}}
  b: {plugin: mine.Say, with: {say: "{{ data.x }}"}}
sequences: {all: {stages: [{jobs: [a, b]}]}}
""",
    )
    run_sequence(load(where.rigelfile), "all", settings=where, report=told)
    assert made == ["b"]


def test_a_stage_matrix_gives_each_branch_its_values(directory: Path, told: Recorder) -> None:
    """Also where the values come from vars, and keep their types."""
    text = """
vars: {ns: [1, 2]}
jobs: {a: {plugin: mine.Say, with: {say: "{{ data.w }}", number: "{{ data.n }}"}}}
sequences:
  s: {stages: [{parallel: [{jobs: [a]}], matrix: {n: "{{ vars.ns }}", w: [x, y]}}]}
"""
    sequence(directory, text, told)
    assert sorted(told.of("line")) == ["x 1", "x 2", "y 1", "y 2"]


def test_a_matrix_may_come_from_what_a_job_stored(directory: Path, told: Recorder) -> None:
    """`{{ data.x }}` as a matrix' values, known only when the stage starts."""
    (directory / "lists.py").write_text(
        "class L:\n    options = dict\n    def check(self, o, a): return ()\n"
        "    def run(self, o, job): job.data['list'] = ['p', 'q']\n"
    )
    text = """
jobs:
  l: {plugin: lists.L, with: {}}
  a: {plugin: mine.Say, with: {say: "{{ data.w }}"}}
sequences:
  s: {stages: [{jobs: [l]}, {parallel: [{jobs: [a]}], matrix: {w: "{{ data.list }}"}}]}
"""
    sequence(directory, text, told)
    assert sorted(told.of("line")) == ["p 0", "q 0"]


def test_a_sequences_own_matrix_runs_all_stages_for_each(directory: Path, told: Recorder) -> None:
    """Rigel ignores it."""
    text = """
jobs:
  a: {plugin: mine.Say, with: {say: "{{ data.w }}", store: seen}}
  b: {plugin: mine.Say, with: {say: "{{ data.seen }}!"}}
sequences:
  s: {matrix: {w: [x, y]}, stages: [{jobs: [a]}, {jobs: [b]}]}
"""
    sequence(directory, text, told)
    assert sorted(told.of("line")) == ["x 0", "x! 0", "y 0", "y! 0"]


def test_the_whole_sequence_is_checked_before_the_first_job(
    directory: Path, told: Recorder
) -> None:
    """Problems of the last job, of a branch and of a provider keep the first from running."""
    text = """
providers: {p: {provider: mine.Provider, with: {sya: x}}}
jobs:
  a: {plugin: mine.Say, with: {say: a}}
  b: {plugin: mine.Say, with: {number: "{{ data.n }}"}}
  c: {plugin: mine.Sya, with: {}}
  d: {plugin: mine.Say, with: {numbre: 1}}
sequences:
  s: {stages: [{jobs: [a]}, {parallel: [{jobs: [b]}], matrix: {n: [1, -1]}}, {jobs: [c, d]}]}
"""
    with pytest.raises(ProblemsError) as caught:
        sequence(directory, text, told)
    assert told.entries == []
    found = "\n".join(caught.value.details)
    assert re.search(r"Rigelfile:3:.*\"sya\".*did you mean \"?say", found)
    assert re.search(r"Rigelfile:6:.*must not be negative.*\[bad-number\]", found)
    assert re.search(
        r"Rigelfile:7:.*mine has no Sya \(did you mean mine\.Say.*\[unknown-plugin\]", found
    )
    assert re.search(r"Rigelfile:8:.*\"numbre\".*did you mean \"?number", found)
    assert caught.value.exit_code == 2


def test_jobs_that_the_sequence_does_not_use_are_not_its_matter(
    directory: Path, told: Recorder
) -> None:
    """A broken job elsewhere in the file is `rigel check`'s to tell."""
    text = """
jobs: {a: {plugin: mine.Say, with: {say: a}}, bad: {plugin: no.Such, with: {}}}
sequences: {s: {stages: [{jobs: [a]}]}}
"""
    sequence(directory, text, told)
    assert told.of("line") == ["a 0"]


def test_warnings_are_told_once_and_stop_nothing(directory: Path, told: Recorder) -> None:
    """With their place, before the first job."""
    text = """
jobs: {a: {plugin: mine.Say, with: {say: a, number: 13}}}
sequences: {s: {stages: [{jobs: [a, a]}]}}
"""
    sequence(directory, text, told)
    (warning,) = told.of("warn")
    assert "brings bad luck" in warning
    assert told.entries[0][1] == "warn"


def test_data_that_nobody_stored_is_told_with_its_place(directory: Path, told: Recorder) -> None:
    """Unknown until the job runs, and then an error of the user's."""
    text = "jobs: {j: {plugin: mine.Say, with: {say: '{{ data.nobody }}'}}}"
    with pytest.raises(JobFailed, match=r"^job j: ") as caught:
        job(directory, text, told)
    assert caught.value.exit_code == 2
    assert "nobody" in "\n".join(caught.value.details)


def test_what_check_finds_in_data_stops_the_job(directory: Path, told: Recorder) -> None:
    """Options that only the data completes are checked before run, too."""
    (directory / "lists.py").write_text(
        "class L:\n    options = dict\n    def check(self, o, a): return ()\n"
        "    def run(self, o, job): job.data['n'] = -5\n"
    )
    text = """
jobs: {l: {plugin: lists.L, with: {}}, a: {plugin: mine.Say, with: {number: "{{ data.n }}"}}}
sequences: {s: {stages: [{jobs: [l, a]}]}}
"""
    with pytest.raises(JobFailed) as caught:
        sequence(directory, text, told)
    assert "must not be negative" in "\n".join(caught.value.details)


def test_providers_surround_a_job(
    directory: Path, told: Recorder, capsys: pytest.CaptureFixture[str]
) -> None:
    """All that are declared are connected, and disconnected after a failure too."""
    text = """
providers: {p: {provider: mine.Provider, with: {say: secret}}}
jobs: {j: {plugin: mine.Say, with: {say: fail}}}
"""
    with pytest.raises(JobFailed, match="job j: told to fail"):
        job(directory, text, told)
    assert "connected p secret" in told.of("line")
    assert capsys.readouterr().out == "disconnected secret\n"


@pytest.mark.parametrize(
    "stages",
    [
        "[{parallel: [{jobs: [a]}], matrix: {n: [1, 2]}}]",
        "[{jobs: [b], dependencies: [a]}]",
        "[{jobs: [x], dependencies: [a, b]}]",
        "[{parallel: [{jobs: [x]}, {jobs: [a]}], matrix: {n: [1, 2]}}]",
    ],
)
def test_two_deploys_of_one_release_side_by_side_are_refused(
    directory: Path, told: Recorder, stages: str
) -> None:
    """Before anything runs: branches of a matrix, a job and its dependency, two dependencies."""
    text = f"""
jobs:
  a: {{plugin: mine.Say, with: {{release: demo}}}}
  b: {{plugin: mine.Say, with: {{release: demo}}}}
  x: {{plugin: mine.Say, with: {{}}}}
sequences: {{s: {{stages: {stages}}}}}
"""
    with pytest.raises(UserError, match="would work on demo at the same time") as caught:
        sequence(directory, text, told)
    assert told.entries == []
    assert caught.value.hint


@pytest.mark.parametrize(
    "stages",
    [
        "[{jobs: [a, a]}]",
        "[{jobs: [a]}, {jobs: [a]}]",
        "[{matrix: {n: [1, 2]}, "
        "parallel: [{jobs: [{name: a, with: {release: 'demo-{{ data.n }}'}}]}]}]",
    ],
)
def test_deploys_one_after_the_other_or_of_two_releases_are_fine(
    directory: Path, told: Recorder, stages: str
) -> None:
    """src.plugin's deploy and update are one after the other; robots have a release each."""
    text = f"""
jobs: {{a: {{plugin: mine.Say, with: {{release: demo}}}}}}
sequences: {{s: {{stages: {stages}}}}}
"""
    sequence(directory, text, told)
    assert len(told.of("line")) == 2


def test_a_matrix_value_that_is_no_list_is_told(directory: Path, told: Recorder) -> None:
    """A template that gives a text where a list is needed."""
    text = """
vars: {w: x}
jobs: {a: {plugin: mine.Say, with: {}}}
sequences: {s: {stages: [{parallel: [{jobs: [a]}], matrix: {w: "{{ vars.w }}"}}]}}
"""
    with pytest.raises(ProblemsError) as caught:
        sequence(directory, text, told)
    assert "list" in "\n".join(caught.value.details)


STORING = """
class Store:
    options = dict
    def check(self, options, application): return ()
    def run(self, options, job): job.data.update(options)
"""


@pytest.mark.parametrize(
    ("store", "words"),
    [("{w: x}", "must be a list, not str"), ("{other: [x]}", "data.w")],
)
def test_a_matrix_that_data_spoils_is_told(
    directory: Path, told: Recorder, store: str, words: str
) -> None:
    """What an earlier job stored is no list, or not there: known only when the stage starts."""
    (directory / "lists.py").write_text(STORING)
    text = """
jobs: {l: {plugin: lists.Store, with: STORE}, a: {plugin: mine.Say, with: {}}}
sequences: {s: {stages: [{jobs: [l]}, {parallel: [{jobs: [a]}], matrix: {w: "{{ data.w }}"}}]}}
"""
    text = text.replace("STORE", store)
    with pytest.raises(JobFailed, match="the matrix of a parallel stage") as caught:
        sequence(directory, text, told)
    assert words in "\n".join(caught.value.details)
    assert caught.value.exit_code == 2


def test_keys_that_are_not_known_yet_are_no_conflict(directory: Path, told: Recorder) -> None:
    """Each branch stores its own release's name; before the run both look alike."""
    (directory / "lists.py").write_text(STORING)
    text = """
jobs:
  l: {plugin: lists.Store, with: {r: "demo{{ data.n }}"}}
  a: {plugin: mine.Say, with: {release: "{{ data.r }}"}}
sequences: {s: {stages: [{parallel: [{jobs: [l, a]}], matrix: {n: [1, 2]}}]}}
"""
    sequence(directory, text, told)
    assert len(told.of("line")) == 2


def test_a_class_for_rigel_gets_what_rigel_would_give(directory: Path, told: Recorder) -> None:
    """Raw data as it is written, vars, application, connections."""
    text = """
vars: {v: 1}
providers: {p: {provider: mine.Provider, with: {say: c}}}
jobs: {j: {plugin: mine.Rigels, with: {a: [1, "1.10"], b: "{{ vars.v }}"}}}
"""
    given = job(directory, text, told)["all"]
    assert given[:3] == ({"a": [1, "1.10"], "b": 1}, {"v": 1}, "noetic")
    assert given[4] == {"p": "c"}


@pytest.mark.parametrize(("run", "what"), [(run_job, "job"), (run_sequence, "sequence")])
def test_an_unknown_name_is_told_with_the_nearest(
    directory: Path, told: Recorder, run: Any, what: str
) -> None:
    """Of jobs for `run job`, of sequences for `run sequence`."""
    text = """
jobs: {deploy: {plugin: mine.Say, with: {}}}
sequences: {deploy_all: {stages: [{jobs: [deploy]}]}}
"""
    chosen = settings(directory, text)
    with pytest.raises(UserError, match=f'unknown {what} "deplyo", did you mean "deploy'):
        run(load(chosen.rigelfile), "deplyo", settings=chosen, report=told)
