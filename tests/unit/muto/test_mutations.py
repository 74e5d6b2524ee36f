"""Stacks with something wrong in them: converted into a Rigelfile that is right, or refused."""

from __future__ import annotations

import copy
import json
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from rigel_k8s.commands import rigelfiles
from rigel_k8s.errors import UserError
from rigel_k8s.settings import Settings
from rigel_muto import convert as muto
from rigel_muto.options import Muto

from .shapes import FOLDER

FILES = ("talker-listener", "thing", "described", "not-carried", "solution")
STACKS = [json.loads((FOLDER / f"{name}.json").read_text("utf-8")) for name in FILES]
TEXTS = ["$(arg robot)", "$(arg x", "$(find a)", "", "~/x", "-", "{{ vars.HOME }}", "\u00e9", "2"]
VALUES = [*TEXTS, "true", "a b", "/", "\x07", "'", None, 0, 1.5, True, [], {}, [[]], {"a": 1}]
KEYS = ("name", "param", "from", "if", "env", "extra", "command", "stack", "node", "namespace")


def list_places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Yield each container with each of its keys."""
    if not isinstance(value, dict | list):
        return
    for key, child in value.items() if isinstance(value, dict) else enumerate(value):
        yield value, key
        yield from list_places(child)


def mutate(stack: Any, chance: random.Random) -> Any:
    """Return a stack with a value removed, replaced or added."""
    result = copy.deepcopy(stack)
    for _ in range(chance.randint(1, 3)):
        container, key = chance.choice(list(list_places(result)))
        kind = chance.choice(("remove", "replace", "replace", "add"))
        if kind == "remove":
            del container[key]
        elif kind == "replace":
            container[key] = copy.deepcopy(chance.choice(VALUES))
        elif isinstance(container, dict):
            container[chance.choice(KEYS)] = copy.deepcopy(chance.choice(VALUES))
        else:
            container.append(copy.deepcopy(chance.choice(VALUES)))
    return result


@pytest.mark.parametrize("stack", range(len(STACKS)), ids=FILES)
def test_a_mutated_stack_is_converted_or_refused(
    stack: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Never with a traceback; the same each time; what is printed passes `rigel check`."""
    monkeypatch.chdir(tmp_path)
    chance = random.Random(stack)
    converted = 0
    for _ in range(25):
        Path("stack.json").write_text(json.dumps(mutate(STACKS[stack], chance)))
        try:
            made = muto.convert(Muto(stack="stack.json"))
        except UserError:
            continue
        converted += 1
        assert made == muto.convert(Muto(stack="stack.json"))
        Path("Rigelfile").write_text(made.text)
        result = rigelfiles.check(Settings(rigelfile=Path("Rigelfile")))
        assert not result.errors, result.render_findings()
    assert converted
