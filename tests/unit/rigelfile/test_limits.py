# ruff: noqa: E501 - files on one line each
"""Whatever a Rigelfile contains, looking at it ends soon and needs little memory.

Each file is looked at by a process of its own, with limits that the kernel keeps.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import attrs
import pytest

from rigel_k8s.rigelfile import Finding, check_file
from rigel_k8s.rigelfile.limits import EXPRESSION_SECONDS, MOST_SUGGESTIONS

#: Seconds of the processor and bytes of memory, above what the worst file takes: 2 s, 200 MB.
SECONDS, BYTES = 6, 400 * 2**20
Resolve = Callable[[str, str], Any]
HEAD = "application: {distro: noetic}\n"
DEPLOY = """\
jobs:
  deploy:
    plugin: rigel_k8s.OrchestrationPlugin
    with: {deployment_name: demo, nodes: {talker: {image: a, command: [b], env: {X: "%s"}}}}
"""


def expression(text: str) -> str:
    quoted = text.replace("\\", "\\\\").replace('"', '\\"')
    return HEAD + DEPLOY % f"{{{{ {quoted} }}}}"


def doubling(use: str, count: int = 40) -> str:
    lines = [f"  v{n}: {use.replace('NEXT', f'vars.v{n + 1}')}" for n in range(count)]
    text = "\n".join(["vars:", *lines, f"  v{count}: xxxxxxxxxx"])
    return f"{HEAD}{text}\n{DEPLOY % '{{ vars.v0 }}'}"


EXPRESSIONS = [
    *("'a' * 10**9", "10**10**10", "9**9**9**9", "[0] * 10**9", "'%1000000000d' % 1"),
    *("'{:1000000000}'.format(1)", "'{:{}}'.format(1, 10**9)", "'%*d' % (10**9, 1)"),
    *("'a' | center(10**9)", "'a' | indent(10**9, first=true)", "'a'.ljust(10**9)"),
    *("'a'.zfill(10**9)", "'a\tb'.expandtabs(10**9)", "[1] | batch(10**9, 'x') | list"),
    *("range(10**9) | list", "range(99999) | map('center', 9999) | join", "'%d' % 10**9999"),
    "range(99999) | select('in', range(99999) | list) | list",
    *("range(99999) | map('string') | join('a' * 99999)", "('a' * 999) | replace('', 'a' * 99999)"),
    "('a' * 999) | replace('a', 'a' * 999) | replace('a', 'a' * 999)",
    "[[[[[[0] * 99] * 99] * 99] * 99] * 99] * 99 | string",
    "('{0}' * 9999).format('a' * 9999)",
    "'a'.translate({97: 'a' * 99999})",
    *("('a' * 40 ~ 'b') | regex_replace('(a+)+$', '')", "'a' | regex_replace('(a{99999}){99999}')"),
    "('a' * 9999) | regex_replace('a*a*a*a*a*a*b', '')",
    "('a' * 9999) | regex_replace('(.*)', '\\\\1' * 200)",
    *(
        "'a' | regex_replace('((a{1000}){1000}){1000}', '')",
        "[range(99999) | list] | sum(start=[])",
    ),
    *("(" * 400 + "1" + ")" * 400, "- " * 400 + "1", "not " * 200 + "1", "[" * 150 + "]" * 150),
    *("1" + "+1" * 400, "9" * 900, "1" + "0" * 900 + ".0", "'" + "x" * 2000 + "'", "1e999 * 1"),
    *("range(1, 99999) | sum * 10**300", "''.__class__.__mro__", "vars.__class__", "1 // 0"),
    *("cycler('a')", "lipsum(n=10**9)", "'a' | random", "x.y.z", "'\\ud800'", "[1, 2]['a']"),
]

FILES = {
    "texts of texts": doubling("'{{ NEXT }}{{ NEXT }}'"),
    "lists of lists": doubling("['{{ NEXT }}', '{{ NEXT }}']"),
    "mappings of mappings": doubling("{a: '{{ NEXT }}', b: '{{ NEXT }}'}"),
    "expressions of expressions": doubling('"{{ NEXT ~ NEXT }}"'),
    "a long chain": doubling("'{{ NEXT }}'", 3000),
    "a deep chain": doubling(f"{'[' * 60}'{{{{ NEXT }}}}'{']' * 60}", 45),
    "aliases": HEAD
    + "vars:\n  a0: &a0 [x, x, x, x, x, x, x, x, x]\n"
    + "".join(f"  a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]\n" for n in range(1, 9)),
    "two million numbers": HEAD + f"vars: {{a: [{'1,' * 2_000_000}1]}}",
    "a million lines": HEAD + "vars:\n  a:\n" + "  - a\n" * 600_000,
    "as many values as are read, and no more": HEAD + f"vars: {{a: [{'1,' * 19_990}1]}}",
    "one more": HEAD + f"vars: {{a: [{'1,' * 20_000}1]}}",
    "deep brackets": HEAD + "vars: {a: " + "[" * 90_000 + "]" * 90_000 + "}",
    "deep dashes": HEAD + "vars:\n  a:\n    " + "- " * 90_000 + "x",
    "a number without end": HEAD + f"vars: {{a: {'9' * 900_000}}}",
    "base 60": HEAD + f"vars: {{a: {':'.join(['59'] * 300_000)}}}",
    "base 60, not whole": HEAD + f"vars: {{a: {':'.join(['59'] * 199)}.5}}",
    "a hexadecimal number": HEAD + DEPLOY.replace("[b]", f"0x{'f' * 350}") % "",
    "a large matrix": HEAD
    + "jobs: {d: {plugin: network, with: {}}}\nsequences:\n  s:\n    stages: [{parallel: [{jobs: [d]}],"
    + f" matrix: {{{', '.join(f'k{n}: {list(range(20))}' for n in range(9))}}}}}]\n",
    "matrices in each other": HEAD
    + "jobs:\n  d:\n    plugin: rigel_k8s.OrchestrationPlugin\n    with: {deployment_name: d}\n"
    + f"sequences:\n  s:\n    matrix: {{a: {list(range(999))}}}\n"
    + f"    stages: [{{parallel: [{{jobs: [d]}}], matrix: {{b: {list(range(999))}}}}}]\n",
    "many uses of a large job": HEAD
    + "jobs:\n  d:\n    plugin: rigel_k8s.OrchestrationPlugin\n    with:\n      deployment_name: d\n"
    + f"      nodes: {{a: {{image: a, args: {list(map(str, range(2000)))}}}}}\n"
    + f"sequences: {{s: {{stages: [{{jobs: [{', '.join(['{name: d, with: {ros: 1}}'] * 2000)}]}}]}}}}\n",
    "unknown keys": HEAD
    + DEPLOY % ""
    + "".join(f"      imag{n}: x\n" for n in range(9000)).replace("      ", ""),
    "unknown options": HEAD
    + "jobs:\n  d:\n    plugin: rigel_k8s.OrchestrationPlugin\n    with:\n"
    + "".join(f"      deployment_nam{n}: x\n" for n in range(9000)),
    "unknown jobs": HEAD
    + f"jobs: {{{', '.join(f'job{n}: {{plugin: network}}' for n in range(3000))}}}\n"
    + f"sequences: {{s: {{stages: [{{jobs: [{', '.join(f'jib{n}' for n in range(9000))}]}}]}}}}\n",
    "unknown variables": HEAD
    + f"vars: {{{', '.join(f'name{n}: 1' for n in range(3000))}}}\n"
    + "jobs: {d: {plugin: network, with: {a: ["
    + ", ".join(f"'{{{{ vars.nome{n} }}}}'" for n in range(9000))
    + "]}}}\n",
    "one long line of mistakes": HEAD
    + f"jobs: {{{', '.join(f'{{a{n}: {{}}}}: x' for n in range(9000))}}}\n",
    "long command lines": HEAD + DEPLOY.replace("[b]", "a" * 3_000_000) % "",
    "many servers": HEAD
    + "jobs:\n  d:\n    plugin: rigel_k8s.OrchestrationPlugin\n    with:\n      deployment_name: d\n"
    + "      ros: 2\n      network: {mode: discovery-server, servers: 2147483647}\n"
    + "      nodes: {a: {image: a, command: [b]}}\n",
    "a range without room": HEAD
    + "jobs:\n  d:\n    plugin: rigel_k8s.OrchestrationPlugin\n    with:\n      deployment_name: d\n"
    + "      network: {mode: macvlan, interface: eth0, subnet: 0.0.0.0/0, ipam: static,\n"
    + "        exclude: [0.0.0.0/1, 128.0.0.0/1]}\n"
    + "      nodes: {a: {image: a, command: [b]}, b: {image: a, command: [b]}}\n",
    "control characters": HEAD
    + 'vars: {a: "\\e[2J\\u202e\\a"}\njobs: {"\\e[2J": {plugin: "\\e]0;x\\a"}}\n',
    "bytes that are no text": "\ud800",
    "nothing": "",
}


#: Imports the program once, then looks at each file that it reads of, in a process with limits.
SERVER = f"""
import contextlib, io, json, os, resource, sys
from rigel_k8s.cli.main import run
with contextlib.redirect_stdout(io.StringIO()):  # what the first run imports is there for all
    assert run(["-f", sys.argv[1], "render"], "rigel") == 0
for line in sys.stdin:
    command = json.loads(line)
    child = os.fork()
    if not child:
        resource.setrlimit(resource.RLIMIT_CPU, ({SECONDS}, {SECONDS}))
        resource.setrlimit(resource.RLIMIT_AS, ({BYTES}, {BYTES}))
        for number in (1, 2):
            os.dup2(os.open(command["to"] + str(number), os.O_CREAT | os.O_WRONLY), number)
        code = run(command["words"], "rigel")
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""


@attrs.frozen
class Looked:
    """How a command ended: its exit code, or the signal that ended it as a negative number."""

    code: int
    out: str
    err: str


class Looker:
    """Runs commands one after the other, each in a process of its own with the kernel's limits."""

    def __init__(self, server: subprocess.Popen[str], place: Path) -> None:
        self._server = server
        self._place = place
        self._count = 0

    def look(self, file: Path, *words: str) -> Looked:
        assert self._server.stdin
        assert self._server.stdout
        self._count += 1
        to = self._place / f"{self._count}-"
        command = {"words": ["-f", str(file), *words], "to": str(to)}
        print(json.dumps(command), file=self._server.stdin, flush=True)
        code = int(self._server.stdout.readline())
        return Looked(code, *(Path(f"{to}{number}").read_text("utf-8") for number in (1, 2)))

    def expect_end(self, file: Path, command: str) -> str:
        """Return what a command printed, which ended with findings or results."""
        ended = self.look(file, command)
        assert "Traceback" not in ended.err, ended.err[-2000:]
        assert ended.code in (0, 2), (ended.code, ended.err[-500:])
        shown = ended.out + ended.err
        assert len(shown) < 2**20 or ended.code == 0
        assert all(c.isprintable() or c in "\n\t" for c in shown)
        return shown


@pytest.fixture(scope="module")
def looker(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Looker]:
    place = tmp_path_factory.mktemp("printed")
    first = place / "Rigelfile"
    first.write_text(expression("1 + 1"))
    command = [sys.executable, "-c", SERVER, str(first)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as server:
        yield Looker(server, place)


@pytest.mark.programs
@pytest.mark.parametrize("name", FILES)
def test_a_file_that_would_take_everything(name: str, looker: Looker, tmp_path: Path) -> None:
    """A check and a render end with findings or results, within the kernel's limits."""
    file = tmp_path / "Rigelfile"
    file.write_bytes(FILES[name].encode("utf-8", "surrogatepass"))
    for command in ("check", "render"):
        looker.expect_end(file, command)


def test_expressions_that_would_take_everything(looker: Looker, tmp_path: Path) -> None:
    """Each, in a file of its own, ends within the kernel's limits."""
    file = tmp_path / "Rigelfile"
    for text in EXPRESSIONS:
        file.write_text(expression(text))
        looker.expect_end(file, "check")


SLOW = expression("('a' * 40 ~ 'b') | regex_replace('(a+)+$', '')")


def test_expressions_that_take_too_long_end_the_check(tmp_path: Path, resolve: Resolve) -> None:
    """One error at the expression that was being computed, whatever else is wrong with the file."""
    file = tmp_path / "Rigelfile"
    file.write_text(SLOW + "wrong: 1\n")
    began = time.thread_time()
    (found,) = check_file(file, {}, resolve).findings
    assert time.thread_time() - began < 2 * EXPRESSION_SECONDS
    assert found.kind == "too-large"
    assert found.message == (
        "the expressions of this file take too long; the check stopped at this one"
    )
    assert SLOW.splitlines()[found.span.line - 1][found.span.column - 1 :].startswith('"{{')


def test_in_a_thread_the_time_is_checked_between_expressions(
    tmp_path: Path, resolve: Resolve
) -> None:
    """Rigel 0.3 runs jobs in threads, which no signal reaches."""
    file = tmp_path / "Rigelfile"
    one = "{{ ('a' * 21 ~ 'b') | regex_replace('(a+)+$', '') }}"
    lines = [f'  v{number}: "{one}"\n' for number in range(200)]
    file.write_text(HEAD + "vars:\n" + "".join(lines) + "jobs: {}\n")
    found: list[Finding] = []
    thread = threading.Thread(target=lambda: found.extend(check_file(file, {}, resolve).findings))
    thread.start()
    thread.join(60)
    assert [one.kind for one in found] == ["too-large"]
    assert 3 < found[0].span.line < 203


def test_an_expression_may_not_fill_the_memory(tmp_path: Path, resolve: Resolve) -> None:
    """One error at its place; the check goes on, and so does the process."""
    limits = resource.getrlimit(resource.RLIMIT_AS)
    file = tmp_path / "Rigelfile"
    file.write_text(HEAD + 'vars: {a: "{{ \'a\' * 10**9 }}", b: "{{ vars.none }}"}\njobs: {}\n')
    found = [one.message for one in check_file(file, {}, resolve).findings]
    assert "'a' * 10**9 needs too much memory" in found
    assert len(found) == 2
    assert resource.getrlimit(resource.RLIMIT_AS) == limits


def test_paths_that_are_no_files(looker: Looker, tmp_path: Path) -> None:
    """A pipe, a device, a directory, a link that leads away or to itself, a file that is too large."""
    elsewhere = tmp_path / "elsewhere"
    elsewhere.write_text(HEAD)
    place = tmp_path / "place"
    place.mkdir()
    os.mkfifo(place / "pipe")
    links = {
        "zero": "/dev/zero",
        "loop": place / "loop",
        "away": elsewhere,
        "env": "/proc/self/environ",
    }
    for name, target in links.items():
        (place / name).symlink_to(target)
    with (place / "large").open("wb") as file:
        file.truncate(100 * 2**20)
    for name in ("pipe", ".", "large", *links):
        ended = looker.look(place / name, "check")
        assert ended.code == 2, (name, ended)
        assert "error: " in ended.err
        assert "Traceback" not in ended.err
    assert "is outside the Rigelfile's directory" in looker.look(place / "away", "check").err


def test_files_that_options_name(looker: Looker, tmp_path: Path) -> None:
    """A parameter file lies beside the Rigelfile, is a file, and is small; else it is not read."""
    place = tmp_path / "place"
    place.mkdir()
    (tmp_path / "secret.yaml").write_text("password: hunter2\n")
    (place / "link.yaml").symlink_to(tmp_path / "secret.yaml")
    os.mkfifo(place / "pipe.yaml")
    (place / "deep.yaml").write_text("- " * 130_000 + "x")
    (place / "large.yaml").write_text("a: b\n" * 100_000)
    (place / "good.yaml").write_text("a: b\n")
    names = ("../secret.yaml", str(tmp_path / "secret.yaml"), "link.yaml", "pipe.yaml", "deep.yaml")
    for name in (*names, "large.yaml", "/dev/zero", "/etc/passwd", "good.yaml"):
        node = f"{{image: a, package: p, executable: e, parameter_files: ['{name}']}}"
        (place / "Rigelfile").write_text(
            "application: {distro: jazzy}\n"
            + (DEPLOY % "").replace('{image: a, command: [b], env: {X: ""}}', node)
        )
        outside = "secret" in name or name in ("link.yaml", "/dev/zero", "/etc/passwd")
        kind = "[untrusted]" if outside else "[bad-parameter-file]"
        for command in ("check", "render"):
            shown = looker.expect_end(place / "Rigelfile", command)
            assert "hunter2" not in shown
            assert (f"{kind}\n" in shown) == (name != "good.yaml"), shown[-2000:]


def test_only_variables_that_the_file_names_are_read(tmp_path: Path) -> None:
    """Neither a hint nor an expression looks at the rest of the environment."""

    class Environment(dict[str, str]):
        def __init__(self) -> None:
            self.asked: set[str] = set()

        def __contains__(self, name: object) -> bool:
            self.asked.add(str(name))
            return False

        def _refuse(self, *arguments: object) -> None:
            raise AssertionError("the whole environment is read")

        __iter__ = keys = items = values = _refuse  # type: ignore[assignment]

    environ = Environment()
    file = tmp_path / "Rigelfile"
    file.write_text(
        HEAD
        + "vars: {a: '{{ vars.NAMED }}', b: \"{{ vars['OTHER'] | upper }}\", c: '{{ HOME }}'}\n"
    )
    assert len(check_file(file, environ, lambda kind, name: None).findings) == 3
    assert environ.asked == {"NAMED", "OTHER"}


def test_similar_names_are_searched_for_the_first_problems(tmp_path: Path) -> None:
    """A file with thousands of unknown names is refused without searching for each of them."""
    uses = ", ".join(["'{{ vars.robo }}'"] * (MOST_SUGGESTIONS + 10))
    file = tmp_path / "Rigelfile"
    file.write_text(HEAD + f"vars: {{robot: 1, all: [{uses}]}}\n")
    messages = [one.message for one in check_file(file, {}, lambda kind, name: None).findings]
    similar = [message for message in messages if "did you mean vars.robot?" in message]
    assert (len(similar), len(messages)) == (MOST_SUGGESTIONS, MOST_SUGGESTIONS + 10)
