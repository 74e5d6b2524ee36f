"""Programs of musl, another C library, started with the layer as a pod does: it lets all pass."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
import time
from pathlib import Path
from threading import Timer

import attrs
import pytest

import rigel_inpod
from rigel_inpod.rmw_notes import read_all
from rigel_rmw import libraries
from tests.support.layer import Built, Node, build, compile_c, name
from tests.unit.rmw.conftest import Start

pytestmark = pytest.mark.programs

SCRIPTS = Path(rigel_inpod.__file__).parent
LIBRARY = f"rmw-{platform.machine()}.so"
REASON = "its C library does not load ours, which needs glibc 2.17 or newer: set `rmw_layer: false`"
#: Stands for the keeper's Python.
PYTHON = "#!/bin/sh\nexit 0\n"
#: What the readiness probe says of the notes of a directory, for a pod that hands over or not.
PROBE = """import rmw_ready, sys
try: print(rmw_ready.look(sys.argv[1], "/n", sys.argv[2] == "hands over"))
except rmw_ready.NotReady as why: print(why)
"""
PLAIN = '#include <stdio.h>\nint main(void) { return puts("works") < 0; }\n'


@pytest.fixture(scope="module")
def musl(tmp_path_factory: pytest.TempPathFactory) -> Built:
    """A node and a middleware of musl, which rmw.sh starts with the library of the wheel."""
    if not shutil.which("musl-gcc"):
        pytest.skip("no musl-gcc (Debian: musl-tools)")
    room = tmp_path_factory.mktemp("musl")
    (room / "bin").mkdir()
    (room / "bin/python3").write_text(PYTHON)
    (room / "bin/python3").chmod(0o755)
    (room / LIBRARY).write_bytes(libraries()[LIBRARY])
    script = Path(shutil.copy(SCRIPTS / "rmw.sh", room))
    made = build(room, target="musl", layer=room / LIBRARY)
    path = {"PATH": f"{room}/bin:{os.environ['PATH']}"}
    return attrs.evolve(
        made, main=(Path("/bin/sh"), script, *made.main), preload=None, options=path
    )


def begin(start: Start, musl: Built) -> Node:
    """Start a node `/n` of a pod that hands over; one that hangs is killed."""
    node = start(of=musl, RIGEL_K8S_PEERS="n-pods")
    limit = Timer(60, node.process.kill)
    limit.daemon = True
    limit.start()
    return name(node)


def use(node: Node) -> None:
    """Let a node do what it does in every mode without the layer."""
    node.do("create p /out 0")
    node.do("create p /map 1")
    node.do("create s /in 0")
    node.do("listen s /in")
    for topic in ("/out", "/map"):
        assert node.do(f"publish {topic} 1") == "0"
        assert node.do(f"sent p {topic}") == "1"
    node.do("arrive /in 1 1")
    assert node.do("take /in") == "1"
    assert node.do("wait 1") == "timeout"
    node.do("destroy p /out")
    node.do("destroy p /map")


def probe(node: Node, how: str) -> str:
    """Return what the readiness probe says of a node's notes."""
    line = [sys.executable, "-B", "-c", PROBE, str(node.directory), how]
    done = subprocess.run(line, cwd=SCRIPTS, capture_output=True, text=True, timeout=60)
    return (done.stdout or done.stderr).strip()


def test_a_node_of_musl_works_as_without_the_layer(musl: Built, start: Start) -> None:
    """Its loader finds all that the layer uses, but the layer's mutex is not one of musl's."""
    node = begin(start, musl)
    use(node)
    time.sleep(1.5)  # by then a thread of the layer's would have hung with the mutex
    node.do("destroy s /in")
    use(node)
    assert list(read_all(str(node.directory))) == []


def test_a_pod_of_musl_says_that_it_has_no_layer(musl: Built, start: Start) -> None:
    """Its probe waits for no notes; the node's log has the reason, once."""
    node = begin(start, musl)
    node.do("create p /out 0")
    assert probe(node, "hands over") == f"it cannot be handed over: {REASON}"
    assert probe(node, "") == "[]", "it is probed as before"
    _, errors = node.process.communicate(timeout=60)
    assert node.process.returncode == 0
    assert errors == f"rigel-k8s: this process cannot be handed over: {REASON}\n"


def test_a_program_of_musl_without_ros_changes_nothing(musl: Built, tmp_path: Path) -> None:
    """A tool of musl in an image of glibc is no reason against a hand-over."""
    source = tmp_path / "plain.c"
    source.write_text(PLAIN)
    line = [*musl.main[:2], compile_c(tmp_path / "plain", source, target="musl")]
    env = {**musl.options, "RIGEL_RMW": str(tmp_path / "notes")}
    done = subprocess.run(line, env=env, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, "works\n", "")
    assert list((tmp_path / "notes").iterdir()) == []


def test_a_setuid_program_of_musl_runs_without_the_layer(musl: Built, tmp_path: Path) -> None:
    """As one of glibc: nothing is loaded, and nothing printed."""
    if os.geteuid() != 0:
        pytest.skip("only root may make a setuid program of another user")
    tmp_path.chmod(0o755)
    program = Path(shutil.copy(musl.main[2], tmp_path / "program"))
    program.chmod(0o4755)
    env = {"LD_PRELOAD": str(musl.main[2].parent / LIBRARY), "RIGEL_RMW": str(tmp_path)}
    line = ["setpriv", "--reuid=1000", "--clear-groups", str(program), str(musl.main[3])]
    words = "node n /\ncreate p /out 0\npublish /out 1\nsent p /out\n"
    done = subprocess.run(line, env=env, input=words, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr) == (0, "ok\nok\n0\n1\n", "")
    assert [path.name for path in tmp_path.iterdir()] == ["program"]
