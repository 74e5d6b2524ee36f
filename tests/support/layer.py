"""The layer, a middleware in memory and a node that tests drive by lines of text."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

import attrs

import rigel_inpod
import rigel_rmw
from rigel_inpod.rmw_notes import Notes

PROGRAMS = Path(__file__).parents[1] / "unit/rmw/programs"
LAYER = Path(rigel_rmw.__file__).parent / "layer.c"
KEEPER = Path(rigel_inpod.__file__).parent / "keeper.py"
WARNINGS = ("-std=gnu11", "-Wall", "-Wextra", "-Wno-unused-parameter", "-Werror", "-g")
LIBRARY = ("-fPIC", "-shared", "-fvisibility=default")
#: Of hatch_build.py.
LAYER_WORDS = ("-O2", "-fexceptions", "-fPIC", "-shared", "-fvisibility=hidden")


def compile_c(out: Path, *words: str | Path, target: str = "") -> Path:
    """Compile with the machine's compiler, else with that of PyPI, which knows other machines.

    Args:
        target: another machine, or "musl": this one with another C library.
    """
    compiler = [sys.executable, "-m", "ziglang", "cc", *(["-target", target] if target else [])]
    if found := shutil.which({"": "cc", "musl": "musl-gcc"}.get(target, "")):
        compiler = [found]
    line = [*compiler, *WARNINGS, *map(str, words), "-o", str(out), "-ldl", "-lpthread"]
    done = subprocess.run(line, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return out


@attrs.frozen
class Built:
    """What runs: `main` with its arguments, before which `preload` is loaded."""

    main: tuple[Path, ...]
    preload: Path | None
    options: dict[str, str] = attrs.Factory(dict)


def build(
    room: Path, *fake: str, linked: bool = False, target: str = "", layer: Path | None = None
) -> Built:
    """Build the middleware (`fake`: words for it), the node and the layer; they stay together."""
    compiled = partial(compile_c, target=target)
    layer = layer or compiled(room / "layer.so", *LAYER_WORDS, LAYER)
    compiled(room / "librmw_fake.so", *LIBRARY, *fake, PROGRAMS / "fake.c")
    beside = (f"-L{room}", "-lrmw_fake", "-Wl,-rpath,$ORIGIN")
    if linked:
        sources = (PROGRAMS / "main.c", PROGRAMS / "client.c")
        main = compiled(room / "main", "-DLINKED", *sources, *beside)
        return Built((main,), layer)
    allowed = ("-Wl,--unresolved-symbols=ignore-all",) if fake else ()
    client = compiled(room / "client.so", *LIBRARY, PROGRAMS / "client.c", *beside, *allowed)
    return Built((compiled(room / "main", PROGRAMS / "main.c"), client), layer)


@attrs.define
class Node:
    """A running node; `notes` are its container's."""

    process: subprocess.Popen[str]
    directory: Path
    _notes: Notes | None = None

    @property
    def notes(self) -> Notes:
        """What its keeper has; opened once, since it stays open."""
        if self._notes is None:
            self._notes = Notes(str(self.directory))
        return self._notes

    def do(self, line: str) -> str:
        """Let it do something, and return its answer."""
        self.send(line)
        assert self.process.stdout
        answer = self.process.stdout.readline()
        assert answer, f"the node has ended at {line!r} with {self.process.wait()}"
        return answer.rstrip("\n")

    def send(self, line: str) -> None:
        """Let it do something that it does not answer."""
        assert self.process.stdin
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()

    def entity(self, name: str) -> dict[str, object]:
        """What its notes say of an entity."""
        found = [one for p in self.notes.processes() for one in p.entities if one.name == name]
        return dict(found[0]._asdict())


def name(node: Node) -> Node:
    """Give a process its node `/n`."""
    node.do("node n /")
    return node


def start_keeper(
    node: Node, pod: str, port: int, script: Path = KEEPER, **more: str
) -> tuple[dict[str, str], subprocess.Popen[str]]:
    """Start the keeper of a node in a pod of the one workload; return its environment, too.

    Args:
        port: the first of four, at 127.0.0.1, where all keepers of the workload are.
        more: further variables.
    """
    environ = {
        "PATH": os.environ["PATH"],
        "RIGEL_RMW": str(node.directory),
        "RIGEL_K8S_WORKLOAD": "n/r/talker",
        "RIGEL_K8S_POD": pod,
        "RIGEL_K8S_PEERS": "127.0.0.1",
        "RIGEL_K8S_PEERS_PORT": str(port),
        **more,
    }
    line = [sys.executable, "-S", "-E", "-B", str(script.parent / "lean.py"), str(script), "run"]
    return environ, subprocess.Popen(line, env=environ, stdout=subprocess.PIPE, text=True)
