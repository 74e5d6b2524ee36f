"""Starts nodes with the layer, on a middleware in memory."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Protocol

import pytest

from tests.support.layer import Built, Node, build, name


class Start(Protocol):
    """Starts a process with the layer; `environ` may name the `directory` of its notes."""

    def __call__(self, mode: str = "work", *, of: Built | None = None, **environ: str) -> Node:
        """Return it."""


@pytest.fixture(scope="session")
def built(tmp_path_factory: pytest.TempPathFactory) -> Built:
    """A node that loads ROS with local scope, as Python does, with the layer before it."""
    return build(tmp_path_factory.mktemp("rmw"))


@pytest.fixture(scope="session", params=["GUIDS", "CYCLONE", "ZENOH"])
def either(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Built:
    """The same, of middlewares that name in different ways who sends."""
    return build(tmp_path_factory.mktemp("rmw"), f"-D{request.param}")


@pytest.fixture
def start(built: Built, tmp_path: Path) -> Iterator[Start]:
    """Starts nodes; what is still running at the end is ended."""
    nodes: list[Node] = []

    def start(mode: str = "work", *, of: Built | None = None, **environ: str) -> Node:
        what = of or built
        directory = tmp_path / environ.pop("directory", "notes")
        directory.mkdir(exist_ok=True)
        env = {"RIGEL_RMW": str(directory), "RIGEL_RMW_MODE": mode, **what.options, **environ}
        if what.preload:
            env["LD_PRELOAD"] = str(what.preload)
        process = subprocess.Popen(
            [str(word) for word in what.main],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={"PATH": os.environ["PATH"], **env},
        )
        nodes.append(Node(process, directory))
        return nodes[-1]

    yield start
    for node in nodes:
        node.process.kill()
        with suppress(BrokenPipeError), node.process:
            pass


@pytest.fixture
def node(start: Start) -> Node:
    """A node `/n` that works."""
    return name(start())
