"""The layer never harms a node: what it lacks, what goes wrong, and all ways in which nodes end."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
from pathlib import Path

import pytest

from rigel_inpod.rmw_notes import (
    CONTROL,
    CONTROL_SIZE,
    SLOT,
    SLOTS_AT,
    STOP,
    VERSION,
    WAIT,
    WORK,
    Notes,
    describe,
    read_all,
)
from tests.support.layer import LAYER, LAYER_WORDS, PROGRAMS, Built, Node, build, compile_c, name
from tests.support.until import until
from tests.unit.rmw.conftest import Start

pytestmark = pytest.mark.programs

#: The signal that stop.sh sends at last.
LAYER_END = 64


def test_a_middleware_may_lack_what_is_optional(tmp_path: Path, start: Start) -> None:
    """A caller gets the answer for it, "unsupported", and all else works."""
    node = name(start(of=build(tmp_path, "-DMINIMAL")))
    node.do("create p /out 1")
    node.do("create s /in 0")
    assert node.do("publish /out 1") == "0"
    node.do("arrive /in 1 1")
    assert node.do("take /in") == "1"
    assert node.do("take /in loaned") == "error 3"
    assert node.do("take /in sequence") == "error 3"
    assert node.do("listen s /in") == "3"
    node.notes.set_mode(STOP)
    node.do("wait 1")
    assert node.do("publish /out 2") == "0"
    assert node.do("sent p /out") == "1"


def test_a_node_of_c_that_is_linked_to_its_middleware(tmp_path: Path, start: Start) -> None:
    """Not only one that loads it, as Python does."""
    node = name(start("wait", of=build(tmp_path, linked=True)))
    node.do("create p /out 0")
    node.do("publish /out 1")
    assert node.do("sent p /out") == ""
    node.notes.set_mode(WORK)
    node.do("publish /out 2")
    assert node.do("sent p /out") == "2"


def test_a_process_without_ros_makes_nothing(built: Built, tmp_path: Path) -> None:
    """A shell, or a Python that loads no ROS, has no file, not even the container's."""
    env = {**os.environ, "LD_PRELOAD": str(built.preload), "RIGEL_RMW": str(tmp_path)}
    subprocess.run(["sh", "-c", "true; ls / >/dev/null"], env=env, check=True)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("where", ["", "/does/not/exist", "/proc/1", "x" * 2000])
def test_a_node_without_a_place_for_notes_works(start: Start, where: str) -> None:
    """As without the layer, in every mode; it says why, once."""
    node = name(start("wait", RIGEL_RMW=where))
    node.do("create p /out 0")
    node.do("create p /more 0")
    node.do("publish /out 1")
    assert node.do("sent p /out") == "1"
    _, errors = node.process.communicate()
    assert errors.count("rigel-k8s: cannot keep notes in ") == (where.startswith("/"))


@pytest.mark.parametrize(("size", "sent"), [("64k", "1"), ("128k", "1"), ("240k", "")])
def test_a_full_file_system_stops_no_node(
    start: Start, built: Built, tmp_path: Path, size: str, sent: str
) -> None:
    """Without room for its notes it works; entities without a slot still follow the mode."""
    room = tmp_path / "small"
    room.mkdir()
    script = f'mount -t tmpfs -o size={size} none "{room}" && exec env "$@"'
    unshare = ("unshare", "--user", "--map-root-user", "--mount", "sh", "-c", script, "sh")
    if subprocess.run([*unshare, "true"], capture_output=True, text=True).returncode:
        pytest.skip("a small file system cannot be mounted here")
    words = (*unshare, f"LD_PRELOAD={built.preload}", f"RIGEL_RMW={room}", *built.main)
    node = name(start("wait", of=Built(tuple(Path(word) for word in words), None)))
    node.do("many 200")
    node.do("create p /out 0")
    node.do("publish /out 1")
    assert node.do("sent p /out") == sent


def test_a_directory_that_is_removed_stops_no_node(node: Node) -> None:
    """Its mapped files stay."""
    shutil.rmtree(node.directory)
    node.do("many 100")
    node.do("create p /out 0")
    node.do("publish /out 1")
    assert node.do("sent p /out") == "1"


def test_notes_that_are_cut_off_behind_their_slots_stop_no_node(node: Node) -> None:
    """Entities that come later have no slot, and follow the mode all the same."""
    path = node.directory / node.do("pid")
    os.truncate(path, SLOTS_AT + 32 * SLOT.size)
    node.do("many 100")
    (process,) = node.notes.processes()
    assert process.full > 60
    node.do("create p /out 0")
    node.notes.set_mode(STOP)
    node.do("publish /out 1")
    assert node.do("sent p /out") == ""


def test_notes_are_written_by_their_process_alone(node: Node) -> None:
    """A program that opens them by mistake cannot cut them off, which would end the node."""
    assert (node.directory / node.do("pid")).stat().st_mode & 0o777 == 0o444


def control_of(version: int) -> bytes:
    """Return a file `control` whose processes wait, as a layer of a version has made it."""
    return CONTROL.pack(b"rigelctl", version, WAIT, 0, 0).ljust(CONTROL_SIZE, b"\0")


@pytest.mark.parametrize(
    "content", [b"", b"x" * 100_000, control_of(VERSION - 1), control_of(VERSION + 1)]
)
def test_a_control_file_of_another_kind_is_left_alone(
    start: Start, tmp_path: Path, content: bytes
) -> None:
    """The node works; it says why, and so does its keeper.

    A process may start when the library has been replaced by that of another version of rigel.
    """
    (tmp_path / "notes").mkdir()
    control = tmp_path / "notes/control"
    control.write_bytes(content)
    node = name(start("wait"))
    node.do("create p /out 0")
    node.do("publish /out 1")
    assert node.do("sent p /out") == "1"
    assert control.read_bytes() == content
    with pytest.raises(OSError, match="is not of this version of the layer"):
        Notes(str(tmp_path / "notes"))
    _, errors = node.process.communicate()
    line = "another version of rigel began them; this process cannot be handed over\n"
    assert errors == f"rigel-k8s: cannot keep notes in {tmp_path}/notes: {line}"


def test_more_entities_than_there_are_slots(start: Start) -> None:
    """Those without a slot are not counted, and follow the mode all the same."""
    node = name(start("wait"))
    node.do("many 2100")
    node.do("create p /out 0")
    node.do("create s /in 0")
    node.do("publish /out 1")
    node.do("arrive /in 1 1")
    assert node.do("take /in") == "-"
    assert node.do("sent p /out") == ""
    (process,) = node.notes.processes()
    assert len(process.entities) == 2048
    assert process.full == 55
    node.do("destroy p /out")


def test_a_graph_of_more_than_256_nodes(node: Node) -> None:
    """Its nodes are discovered; those for which the notes have no room are left out."""

    def find_seen() -> set[str]:
        (process,) = node.notes.processes()
        return set(process.seen)

    node.do("nodes 1000")
    names = {f"/robot/node_{number}" for number in range(1000)}
    until(lambda: find_seen() == names, "they are discovered", every=0.1)
    node.do("nodes 9000")
    until(lambda: len(find_seen()) > 1000, "more are discovered", every=0.1)
    assert names < find_seen() < {f"/robot/node_{number}" for number in range(9000)}


def test_nodes_that_become_partners_are_noted_at_once(tmp_path: Path, start: Start) -> None:
    """Not when it is time for a look around, which here is in an hour."""
    seldom = compile_c(
        tmp_path / "seldom.so", *LAYER_WORDS, "-DLOOK_AROUND_NS=(3600ull << 30)", LAYER
    )
    node = name(start(of=build(tmp_path, layer=seldom)))
    node.do("create p /out 0")
    for number in (1, 3):
        node.do(f"nodes {number}")
        node.do(f"match p /out {number}")
        until(
            lambda n=number: [len(one.seen) for one in node.notes.processes()] == [n],
            "they are noted",
        )


def test_nodes_of_one_name_are_noted_one_by_one(node: Node) -> None:
    """A node that has the name of the process's own is another one all the same."""
    node.do("nodes 3 2")
    wanted = ("/robot/node_0", "/robot/node_0", "/robot/node_1")
    until(lambda: [one.seen for one in node.notes.processes()] == [wanted], "they are noted")


def test_entities_that_come_and_go_leave_nothing(node: Node) -> None:
    """Slots are used again."""
    for number in range(600):
        node.do(f"create p /t{number} 0")
        node.do(f"destroy p /t{number}")
    (process,) = node.notes.processes()
    assert [one.kind for one in process.entities] == ["node"]
    assert not process.full


def test_process_1_of_a_container_can_be_ended_from_inside(
    start: Start, built: Built, tmp_path: Path
) -> None:
    """One that ignores all signals: no other process of the container could kill it."""
    words = ("unshare", "--user", "--map-root-user", "--pid", "--fork", "--kill-child")
    if subprocess.run([*words, "true"], capture_output=True).returncode:
        pytest.skip("no process namespace can be made here")
    line = (*words, "env", f"LD_PRELOAD={built.preload}", f"RIGEL_RMW={tmp_path}", *built.main)
    node = name(start(of=Built(tuple(map(Path, line)), None)))
    (first,) = (
        Path(f"/proc/{node.process.pid}/task/{node.process.pid}/children").read_text().split()
    )
    os.kill(int(first), LAYER_END)
    assert node.process.wait(60) == 137


def test_a_setuid_program_runs_without_the_layer(built: Built, tmp_path: Path) -> None:
    """The kernel's loader leaves out what is preloaded by its path, and nothing is printed."""
    if os.geteuid() != 0:
        pytest.skip("only root may make a setuid program of another user")
    tmp_path.chmod(0o755)
    program = Path(shutil.copy(built.main[0], tmp_path / "program"))
    program.chmod(0o4755)
    env = {"LD_PRELOAD": str(built.preload), "RIGEL_RMW": str(tmp_path)}
    line = ["setpriv", "--reuid=1000", "--clear-groups", str(program), *map(str, built.main[1:])]
    done = subprocess.run(line, env=env, input="node n /\n", capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "ok\n", "")
    assert not list(tmp_path.glob("control*"))


def test_a_forked_process_leaves_its_parents_notes_alone(node: Node) -> None:
    """It has a file of its own when it makes entities, and obeys the same mode."""
    node.do("create p /out 0")
    parent = int(node.do("pid"))
    node.do("wait 1 3")
    node.send("fork")
    node.do("publish /out 1")
    node.do("wait 1 3")
    before = {p.pid: p for p in read_all(str(node.directory))}
    assert list(before) == [parent]
    assert [one.count for one in before[parent].entities] == [0, 0, 3]
    child = int(node.do("pid"))
    name(node).do("create p /in_child 0")
    assert node.do("thread") == "ok"
    node.notes.set_mode(STOP)
    node.do("publish /in_child 1")
    assert node.do("sent p /in_child") == ""
    after = {p.pid: [one.name for one in p.entities] for p in read_all(str(node.directory))}
    assert after[parent] == ["/n", "/out", ""]
    assert "/in_child" in after[child]
    node.send("_exit")
    assert node.process.wait() == 0
    until(lambda: not node.notes.alive(), "both are seen to have ended")


@pytest.mark.parametrize(
    ("how", "code"),
    [("", 0), ("_exit", 0), ("abort", -signal.SIGABRT), ("kill", -signal.SIGKILL)],
)
def test_a_process_that_has_ended_is_known_to_have_ended(node: Node, how: str, code: int) -> None:
    """In every way; its file is removed, and what reads all calls it ended."""
    pid = int(node.do("pid"))
    assert node.notes.alive()
    if how == "kill":
        node.process.kill()
    elif how:
        node.send(how)
    else:
        assert node.process.stdin
        node.process.stdin.close()
    assert node.process.wait() == code
    assert [one.ended for one in read_all(str(node.directory))] == [True]
    assert describe(str(node.directory))["processes"] == []
    assert not node.notes.alive()
    assert not list(node.notes.processes())
    assert not (node.directory / str(pid)).exists()


def test_a_process_that_becomes_another_program_has_ended(node: Node) -> None:
    """Its process number and its start stay the same, and no node runs in it."""
    assert node.notes.alive()
    node.send("exec")
    until(lambda: not node.notes.alive(), "the node is gone")
    assert node.process.poll() is None


def test_a_thread_that_ends_frees_its_slot(node: Node) -> None:
    """A thread pool that grows and shrinks does not fill the file."""
    for _ in range(100):
        node.do("thread")
    (process,) = node.notes.processes()
    assert [one.kind for one in process.entities] == ["node"]


def test_a_helper_of_ours_works_and_is_not_counted(start: Start) -> None:
    """A program beside the node, such as one that makes its transitions, in the same directory."""
    helper = name(start("wait", RIGEL_K8S_EXEC="1"))
    helper.do("create p /out 0")
    helper.do("publish /out 1")
    assert helper.do("sent p /out") == "1"
    assert not helper.notes.alive()
    assert helper.notes.survey() == ([], {})
    assert [one.helper for one in read_all(str(helper.directory))] == [True]


def test_who_is_fit_to_work(start: Start) -> None:
    """Every process has a node, and has turned its executor or published without one."""
    node = start("wait")
    node.do("pid")
    assert not node.notes.fit()
    name(node).do("create p /out 0")
    assert not node.notes.fit()
    node.do("wait 1")
    assert node.notes.fit()
    other = name(start("wait"))
    assert not node.notes.fit()
    other.do("create p /out 0")
    other.do("publish /out 1")
    assert node.notes.fit()


def test_partners_are_counted(node: Node) -> None:
    """Also of a node that has nothing to do, and waits."""
    node.do("create p /out 0")
    node.do("wait 1")
    node.do("match p /out 3")
    node.send("wait 10000")
    until(lambda: node.entity("/out")["matched"] == 3, "they are counted", every=0.02)


def test_partners_of_a_node_without_an_executor_are_counted(node: Node) -> None:
    """One that only publishes, or is called when something arrives."""
    node.do("create p /out 0")
    node.do("match p /out 3")
    until(lambda: node.entity("/out")["matched"] == 3, "they are counted", every=0.02)


def test_an_exception_of_the_middleware_passes(tmp_path: Path, built: Built) -> None:
    """Through the layer to the node that catches it, and it does not count as taking for ever."""
    if not shutil.which("c++"):
        pytest.skip("there is no compiler of C++")
    source = PROGRAMS / "throws.cpp"
    library = tmp_path / "librmw_throws.so"
    line = [
        "c++",
        "-std=c++17",
        "-fPIC",
        "-shared",
        "-DMIDDLEWARE",
        str(source),
        "-o",
        str(library),
    ]
    subprocess.run(line, check=True)
    main = tmp_path / "main"
    subprocess.run(["c++", "-std=c++17", str(source), str(library), "-o", str(main)], check=True)
    notes = tmp_path / "notes"
    notes.mkdir()
    env = {
        "LD_PRELOAD": str(built.preload),
        "RIGEL_RMW": str(notes),
        "LD_LIBRARY_PATH": str(tmp_path),
    }
    process = subprocess.Popen([str(main)], env=env, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    with process:
        assert process.stdout
        assert process.stdout.readline() == b"caught 2\n"
        assert not Notes(str(notes)).is_taking()
    assert process.returncode == 0


@pytest.mark.parametrize("fake", ["-DGUIDS", "-DCYCLONE"])
@pytest.mark.parametrize("sanitizer", ["address,undefined", "thread"])
def test_threads_of_a_node_while_its_mode_changes(
    start: Start, tmp_path: Path, sanitizer: str, fake: str
) -> None:
    """They publish, take, come and go, and wait; a sanitizer sees nothing."""
    trial = tmp_path / "trial.c"
    trial.write_text("int main(void) { return 0; }")
    words = (f"-fsanitize={sanitizer}", "-fno-sanitize-recover=all")
    line = ["cc", *words, str(trial), "-o", str(tmp_path / "trial")]
    if not shutil.which("cc") or subprocess.run(line, capture_output=True).returncode:
        pytest.skip(f"the machine's compiler has no sanitizer of {sanitizer}")
    made = (fake, "-fPIC", "-shared", PROGRAMS / "fake.c")
    compile_c(tmp_path / "librmw_fake.so", *words, *made)
    sources = (PROGRAMS / "main.c", PROGRAMS / "client.c", LAYER)
    beside = (f"-L{tmp_path}", "-lrmw_fake", f"-Wl,-rpath,{tmp_path}", "-rdynamic")
    main = compile_c(tmp_path / "main", *words, "-O1", "-DLINKED", *sources, *beside)
    options = {"TSAN_OPTIONS": "halt_on_error=1", "ASAN_OPTIONS": "detect_leaks=0"}
    node = name(start(of=Built((main,), None, options)))
    node.send("stress 1500")
    for turn in range(60):
        node.notes.set_mode(turn % 5)
        node.notes.set_hold_goals(turn % 2 == 0)
        node.notes.write_drop(node.notes.newest(), node.notes.goals())
        list(node.notes.processes())
    node.notes.set_mode(WORK)
    assert node.process.stdin
    assert node.process.stdout
    answer = node.process.stdout.readline()
    node.process.stdin.close()
    node.process.wait()
    assert node.process.stderr
    assert (answer, node.process.returncode) == ("done\n", 0), node.process.stderr.read()
