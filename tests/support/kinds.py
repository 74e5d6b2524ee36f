"""Which kinds of problems the code has: read from the calls that make one, without running any.

A kind is the argument `kind` of one of MAKERS. It is a literal, a constant of its module, a choice
of such, or passed on: a parameter of another maker, or the `kind` of a value that has one. Anything
else cannot be seen here and is reported, so that no kind escapes.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import attrs

SOURCES = Path(__file__).parents[2] / "src"
#: Programs for pods, whose functions have the same names for other things.
OTHERS = ("rigel_exporter", "rigel_gate", "rigel_inpod", "rigel_lab")
PROBLEM, PREFLIGHT, GRAPH, ROS_GRAPH, CAUSE, REFUSAL = (
    *("problem", "preflight", "graph", "rosgraph"),
    *("cause", "refusal"),
)


@attrs.frozen
class Maker:
    """A class or function that takes a kind: where its argument stands, and what it makes.

    Attributes:
        home: the folder in which the name means this.
        place: the index of the argument, None where it is only given by its name.
    """

    family: str
    place: int | None
    home: str = ""


MAKERS: Mapping[str, Sequence[Maker]] = {
    "Problem": [Maker(PROBLEM, 2)],
    "Finding": [Maker(PROBLEM, 2)],
    "make_finding": [Maker(PROBLEM, 2)],
    "problem_at": [Maker(PROBLEM, None, "rigel_k8s/network")],
    "make_problem": [Maker(PROBLEM, 3, "rigel_k8s/release/refusals")],
    "report": [Maker(PROBLEM, 2, "rigel_k8s/rigelfile/grammar.py")],
    "_refuse": [Maker(PROBLEM, 2, "rigel_k8s/rigelfile/parse.py")],
    "_report": [Maker(PROBLEM, 2, "rigel_k8s/rigelfile/structure.py")],
    "Mismatch": [Maker(PROBLEM, 1, "rigel_k8s/rigelfile")],
    "_Wrong": [Maker(PROBLEM, 1, "rigel_k8s/rigelfile")],
    "error": [Maker(PROBLEM, 2, "rigel_muto")],
    "note": [Maker(PROBLEM, 2, "rigel_muto")],
    "loss": [Maker(PROBLEM, None, "rigel_muto")],
    "lose": [Maker(PROBLEM, 3, "rigel_muto")],
    "_lose": [Maker(PROBLEM, 3, "rigel_muto")],
    "_lose_parameter": [Maker(PROBLEM, 3, "rigel_muto/nodes.py")],
    "_lose_with_advice": [Maker(PROBLEM, 3, "rigel_muto/nodes.py")],
    "PreflightFinding": [Maker(PREFLIGHT, 0)],
    "_overlapping": [Maker(PREFLIGHT, 0, "rigel_k8s/network/preflight")],
    "GraphFinding": [Maker(GRAPH, 0)],
    "GraphProblem": [Maker(ROS_GRAPH, 0)],
    "Cause": [Maker(CAUSE, 0, "rigel_k8s/release/rollout")],
    "Refusal": [Maker(REFUSAL, 0, "rigel_muto/agent")],
    "Malformed": [Maker(REFUSAL, 1, "rigel_muto/agent")],
}


@attrs.frozen
class Use:
    """A kind in the code, and where."""

    family: str
    kind: str
    place: str
    call: ast.Call | None = None


@attrs.frozen
class Unseen(Exception):
    """An argument whose kinds cannot be read from the code."""

    text: str


def find_kinds(sources: Path = SOURCES) -> list[Use]:
    """Return every kind in the code.

    Raises:
        Unseen: a call whose kind is computed.
    """
    found = []
    for path in sorted(sources.rglob("*.py")):
        if path.relative_to(sources).parts[0] not in OTHERS:
            found += list(Module(path, sources).find_uses())
    return found


class Module:
    """One module: its calls, and the names that stand for kinds in it."""

    def __init__(self, path: Path, sources: Path) -> None:
        """Read the module."""
        self._name = path.relative_to(sources).as_posix()
        self._tree = ast.parse(path.read_text("utf-8"))
        self._parents = {
            child: parent
            for parent in ast.walk(self._tree)
            for child in ast.iter_child_nodes(parent)
        }

    def find_uses(self) -> Iterator[Use]:
        """Yield the kinds of calls, of parameters' defaults and of classes of values."""
        for node in ast.walk(self._tree):
            if isinstance(node, ast.Call):
                yield from self._find_in_call(node)
            elif isinstance(node, ast.FunctionDef):
                yield from self._find_in_function(node)
            elif isinstance(node, ast.ClassDef) and self._is_value(node):
                yield from self._find_in_class(node)

    def _find_in_call(self, call: ast.Call) -> Iterator[Use]:
        name = getattr(call.func, "id", None) or getattr(call.func, "attr", "")
        for maker in MAKERS.get(name, ()):
            if not self._name.startswith(maker.home):
                continue
            argument = next((one.value for one in call.keywords if one.arg == "kind"), None)
            if argument is None and maker.place is not None and len(call.args) > maker.place:
                argument = call.args[maker.place]
            if argument is not None:
                for kind in self._read(argument, call):
                    yield Use(maker.family, kind, f"{self._name}:{call.lineno}", call)

    def _find_in_function(self, function: ast.FunctionDef) -> Iterator[Use]:
        """Yield the default of a parameter `kind`, and the kinds of `yield kind, message, ...`."""
        owner = self._parents[function]
        name = owner.name if isinstance(owner, ast.ClassDef) else function.name
        for maker in MAKERS.get(name, MAKERS.get(function.name, ())):
            arguments = function.args
            pairs = [
                *zip(reversed(arguments.args), reversed(arguments.defaults), strict=False),
                *zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True),
            ]
            for argument, default in pairs:
                if argument.arg == "kind" and default and self._name.startswith(maker.home):
                    for kind in self._read(default, function):
                        yield Use(maker.family, kind, f"{self._name}:{function.lineno}")
        if self._name == "rigel_k8s/discovery/findings.py" and "Wrong" in ast.unparse(
            function.returns or function
        ):
            for node in ast.walk(function):
                if isinstance(node, ast.Yield) and isinstance(node.value, ast.Tuple):
                    for kind in self._read(node.value.elts[0], node):
                        yield Use(GRAPH, kind, f"{self._name}:{node.lineno}")

    def _is_value(self, cls: ast.ClassDef) -> bool:
        """Whether a class of scalars names the kind of what it refuses."""
        return any(
            ast.unparse(base) in ("Number", "Text", "str", "int", "float") for base in cls.bases
        )

    def _find_in_class(self, cls: ast.ClassDef) -> Iterator[Use]:
        for line in cls.body:
            target = (
                line.targets[0] if isinstance(line, ast.Assign) else getattr(line, "target", None)
            )
            value = getattr(line, "value", None)
            if isinstance(target, ast.Name) and target.id == "kind" and value is not None:
                for kind in self._read(value, cls):
                    yield Use(PROBLEM, kind, f"{self._name}:{line.lineno}")

    def _read(self, value: ast.expr, where: ast.AST, own: str = "") -> Iterator[str]:
        """Yield the kinds that an expression may be; nothing where it is one of another value.

        Args:
            own: the name that it is assigned to, which has been read already.
        """
        if isinstance(value, ast.Name) and value.id == own:
            return
        if isinstance(value, ast.Constant) and isinstance(value.value, str):
            yield value.value
        elif isinstance(value, ast.IfExp):
            yield from self._read(value.body, where, own)
            yield from self._read(value.orelse, where, own)
        elif isinstance(value, ast.Attribute) and value.attr == "kind":
            return
        elif isinstance(value, ast.Name):
            yield from self._read_name(value.id, where)
        elif isinstance(value, ast.Call) and ast.unparse(value).startswith(
            "getattr(kind, 'kind', "
        ):
            yield from self._read(value.args[2], where)
        elif isinstance(value, ast.Call) and getattr(value.func, "attr", "") == "get":
            for table in find_values(self._tree, ast.unparse(value.func.value)):
                for kind in getattr(table, "values", []):
                    yield from self._read(kind, where)
        else:
            raise Unseen(f"{self._name}:{value.lineno}: {ast.unparse(value)}")

    def _read_name(self, name: str, where: ast.AST) -> Iterator[str]:
        """Yield what a name stands for: a parameter that is passed on, a variable or a constant."""
        scope: ast.AST | None = where
        while scope is not None:
            if isinstance(scope, ast.FunctionDef):
                arguments = scope.args
                if name in {one.arg for one in (*arguments.args, *arguments.kwonlyargs)}:
                    self._require_maker(scope, name)
                    return
            if isinstance(scope, ast.FunctionDef | ast.Module):
                if self._is_looped(scope, name):
                    return
                values = list(find_values(scope, name))
                if values:
                    for value in values:
                        yield from self._read(value, scope, name)
                    return
            scope = self._parents.get(scope)
        yield from self._read_import(name)

    def _require_maker(self, function: ast.FunctionDef, name: str) -> None:
        """Refuse a parameter of a function that is not known to take a kind."""
        owner = self._parents[function]
        names = {function.name, owner.name if isinstance(owner, ast.ClassDef) else ""}
        if not names & set(MAKERS):
            raise Unseen(
                f"{self._name}:{function.lineno}: {function.name}({name}) is not in MAKERS"
            )

    def _is_looped(self, scope: ast.AST, name: str) -> bool:
        """Whether a name is that of a loop over values whose kinds are found elsewhere."""
        loops = (node for node in ast.walk(scope) if isinstance(node, ast.For))
        known = {
            ("rigel_k8s/discovery/findings.py", "wrong"),
            ("rigel_k8s/release/refusals/admission.py", "reasons.items()"),
        }
        return any(
            re.search(rf"\b{name}\b", ast.unparse(loop.target))
            and (self._name, ast.unparse(loop.iter)) in known
            for loop in loops
        )

    def _read_import(self, name: str) -> Iterator[str]:
        """Yield a constant that the module imports from another one."""
        for line in self._tree.body:
            if isinstance(line, ast.ImportFrom) and name in {one.name for one in line.names}:
                other = SOURCES / f"{(line.module or '').replace('.', '/')}.py"
                yield from Module(other, SOURCES)._read_name(name, Module(other, SOURCES)._tree)
                return
        raise Unseen(f"{self._name}: {name} is not defined here")


def find_values(scope: ast.AST, name: str) -> Iterator[ast.expr]:
    """Yield what is assigned to a name, alone or as one of several."""
    for line in ast.walk(scope):
        if not isinstance(line, ast.Assign):
            continue
        target = line.targets[0]
        if ast.unparse(target) == name:
            yield line.value
        elif isinstance(target, ast.Tuple) and isinstance(line.value, ast.Tuple):
            for one, value in zip(target.elts, line.value.elts, strict=False):
                if ast.unparse(one) == name:
                    yield value
