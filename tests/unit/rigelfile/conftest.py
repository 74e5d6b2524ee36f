"""A job type and a provider of the tests' own: one option of each kind that a class may have."""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal

import attrs
import pytest

from rigel_k8s.errors import UserError
from rigel_k8s.problems import Problem
from rigel_k8s.rigelfile import Rigelfile, load
from rigel_k8s.settings import Application

Scalar = str | int | float | bool


class Size(str):
    kind = "bad-size"
    expects = "a size such as 5Mi"

    @classmethod
    def parse(cls, raw: str) -> Size:
        if not raw.removesuffix("Mi").isdigit():
            raise ValueError(f'"{raw}" is not {cls.expects}')
        return cls(raw)


class Port(int):
    kind = "bad-port"
    expects = "a port from 1 to 65535"

    @classmethod
    def parse(cls, raw: str) -> Port:
        if not 0 < int(raw) < 65536:
            raise ValueError(f"{raw} is not {cls.expects}")
        return cls(raw)


class Colour(enum.Enum):
    RED = "red"
    GREEN = "green"


@attrs.frozen(kw_only=True)
class Wheel:
    """A wheel."""

    name: str
    radius: float = attrs.field(default=0.1, validator=attrs.validators.gt(0))
    port: Port | None = None


@attrs.frozen(kw_only=True)
class Ready:
    """When it is ready.

    Attributes:
        command: what to ask,
            in words.
        seconds: how long to wait.
    """

    command: str | list[str] | None = None
    seconds: int = 5


@attrs.frozen(kw_only=True)
class Limits:
    """What it may use."""

    least: int = 0
    most: int = 9


@attrs.frozen(kw_only=True)
class Robot:
    """A robot."""

    nested_under: ClassVar[str] = "robot"

    image: str = attrs.field(metadata={"doc": "what to run"})
    size: Size = attrs.field(default=Size("5Mi"))
    port: Port | None = None
    speed: float = 1.0
    count: int = 1
    enabled: bool = True
    mode: Literal["fast", "slow"] = "slow"
    colour: Colour = Colour.RED
    file: Path | None = None
    wheels: Sequence[Wheel] = ()
    named: Mapping[Size, Wheel] = attrs.field(factory=dict)
    env: Mapping[str, Scalar] = attrs.field(factory=dict)
    words: str | list[Scalar] = ""
    ports: list[Port | Wheel] = attrs.field(factory=list)
    ready: Ready | Literal["none"] | None = None
    limits: Limits = attrs.field(factory=Limits)
    raw: Any = None
    seconds: int = attrs.field(default=1, metadata={"key": "seconds!", "aliases": ("secs",)})


class RobotJob:
    options: ClassVar[type[Robot]] = Robot

    def check(self, options: Robot, application: Application) -> Sequence[Problem]:
        found = []
        if options.image == "forbidden":
            found.append(Problem(("image",), f"not on {application.distro}", "bad-image"))
        if options.limits.least > options.limits.most:
            found.append(Problem(("limits", "least"), "least is more than most", "bad-limits"))
        if options.count > 100:
            message = "more than a hundred"
            found.append(Problem(("count",), message, "many", severity="warning", at_key=True))
        for number, wheel in enumerate(options.wheels):
            if wheel.name == "square":
                found.append(Problem(("wheels", number, "name"), "it is square", "bad-wheel"))
        return found


class FreeJob:
    options: ClassVar[type[Any]] = dict

    def check(self, options: Any, application: Application) -> Sequence[Problem]:
        return []


@attrs.frozen
class Account:
    """An account."""

    user: str
    password: str


class Shop:
    options: ClassVar[type[Account]] = Account

    def check(self, options: Account, application: Application) -> Sequence[Problem]:
        return []


TYPES: Mapping[tuple[str, str], type[Any]] = {
    ("job", "test.Robot"): RobotJob,
    ("job", "test.Free"): FreeJob,
    ("provider", "test.Shop"): Shop,
}

Resolver = Callable[[str, str], Any]
Loader = Callable[..., Rigelfile]


@pytest.fixture
def types() -> Any:
    """This module's classes, by name."""
    return globals()


@pytest.fixture
def resolve() -> Resolver:
    """What finds the tests' own types."""

    def find(kind: str, name: str) -> Any:
        if (kind, name) not in TYPES:
            raise UserError(f"no {kind} type is called {name}", hint="known: test.Robot")
        return TYPES[kind, name]()

    return find


@pytest.fixture
def loaded(tmp_path: Path) -> Loader:
    """Loads a text, with an application added, as a Rigelfile."""

    def load_text(text: str, environ: Mapping[str, str] | None = None) -> Rigelfile:
        file = tmp_path / "Rigelfile"
        file.write_text(f"application: {{distro: noetic}}\n{text}")
        return load(file, environ or {})

    return load_text
