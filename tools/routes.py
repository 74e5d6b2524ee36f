"""Count what a reader of the code meets: modules, functions, and those that a first deploy enters.

usage: python -m tools.routes

The deploy is of two ROS 1 nodes, on the tests' cluster in memory; what is entered before deploy.py
is what comes before the story (docs/architecture.md). A module counts as one file.
"""

from __future__ import annotations

import ast
import contextlib
import io
import json
import re
import sys
import tempfile
import threading
from collections import Counter
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import FrameType
from typing import Any, cast

ROOT = Path(__file__).parents[1]
SOURCES = ROOT / "src"
DIGEST = "@sha256:" + "ab" * 32
JOB = {
    "namespace": "n",
    "image": f"lab/app{DIGEST}",
    "ros_master_image": f"lab/ros{DIGEST}",
    "nodes": {"talker": {"args": ["talker.py"]}, "listener": {"args": ["listener.py"]}},
}
#: Statements of a function that says no more than its lines.
SHORT = 2


def count_code() -> Iterator[tuple[str, int]]:
    """Yield (what, how many) of all Python in src/."""
    texts = [path.read_text("utf-8") for path in sorted(SOURCES.rglob("*.py"))]
    functions = [
        node
        for text in texts
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
    ]
    names = Counter(word for text in texts for word in re.findall(r"\w+", text))
    short = [one for one in functions if names[one.name] == 2 and len(body_of(one)) <= SHORT]
    yield "lines", sum(len(text.splitlines()) for text in texts)
    yield "modules", len(texts)
    yield "functions", len(functions)
    yield f"of them named once elsewhere, with at most {SHORT} statements", len(short)


def body_of(function: ast.FunctionDef | ast.AsyncFunctionDef) -> list[ast.stmt]:
    """Return a function's statements without its docstring."""
    first = function.body[0]
    has_text = isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant)
    return function.body[1:] if has_text else function.body


def follow_deploy() -> list[tuple[str, str]]:
    """Return the functions that a first deploy enters, (file, name), in the order of entry."""
    entered: dict[tuple[str, str], None] = {}

    def note(frame: FrameType, event: str, _: Any) -> None:
        file, name = frame.f_code.co_filename, frame.f_code.co_name
        if event == "call" and file.startswith(f"{SOURCES}/") and not name.startswith("<"):
            entered.setdefault((file.removeprefix(f"{SOURCES}/"), name))

    with tempfile.TemporaryDirectory() as directory:
        file = Path(directory) / "Rigelfile"
        deploy = {"plugin": "rigel_k8s.OrchestrationPlugin", "with": JOB}
        content = {"application": {"distro": "noetic"}, "jobs": {"deploy": deploy}}
        file.write_text(json.dumps(content), "utf-8")
        run = prepare_cluster()
        threading.setprofile(note)
        sys.setprofile(note)
        try:
            with contextlib.redirect_stderr(io.StringIO()) as errors:
                code = run(["-f", str(file), "run", "job", "deploy", "--timeout", "20s"], "rigel")
        finally:
            sys.setprofile(None)
            threading.setprofile(cast(Any, None))
    if code:
        sys.exit(f"the deploy failed:\n{errors.getvalue()}")
    return list(entered)


def prepare_cluster() -> Any:
    """Let commands use a cluster in memory; return the function that runs a command line."""
    from rigel_graph import watching
    from rigel_k8s import kube
    from rigel_k8s.cli import main
    from rigel_k8s.commands import run

    controllers = import_module("tests.support.controllers")
    fake = import_module("tests.support.fake_cluster")
    cluster = fake.FakeCluster(fake.Store(controllers=controllers.Controllers()))
    cluster.create({"apiVersion": "v1", "kind": "Namespace", "metadata": {"name": "n"}})
    for module, name, value in (
        (kube, "connect", lambda _: cluster),
        (run, "require_kubeconfig", lambda *_: None),
        (watching.GraphWatch, "report", lambda *_, **__: None),  # it runs programs in pods
    ):
        setattr(module, name, value)
    return main.run


def main() -> None:
    """Print the table."""
    rows = list(count_code())
    entered = follow_deploy()
    begin = entered.index(("rigel_k8s/deploy.py", "deploy"))
    for what, some in (("a first deploy enters", entered), ("of it before", entered[:begin])):
        rows.append((f"functions that {what}" if some is entered else what, len(some)))
        rows.append(("files of these", len({file for file, _ in some})))
    for what, number in rows:
        print(f"{number:8,}  {what}")  # noqa: T201


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    main()
