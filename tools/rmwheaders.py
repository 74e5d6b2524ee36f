"""Compare what the layer declares of ROS 2's middleware interface with the headers of ROS 2.

usage: python -m tools.rmwheaders NAME=CLONE@REF ... NAME=FOLDER ...

Each argument is a distribution: a revision of a clone of ros2/rmw, or a folder with headers such as
/opt/ros/jazzy/include. Prints a table in Markdown, and exits with 1 if a function or a struct
differs. One that a distribution lacks is no difference: the layer passes over it.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Iterator, Mapping
from itertools import groupby
from pathlib import Path

LAYER = Path(__file__).parents[1] / "src/rigel_rmw/layer.c"
_SETS = ("subscriptions", "guard_conditions", "services", "clients", "events")
#: The layer's own structs, and those that they stand for, as far as they go.
STRUCTS = {
    "node_t": ("rmw_node_t",),
    "entity_t": ("rmw_publisher_t", "rmw_subscription_t", "rmw_service_t", "rmw_client_t"),
    "gid_t_": ("rmw_gid_t",),
    "info_t": ("rmw_message_info_t",),
    "request_id_t": ("rmw_request_id_t",),
    "request_t": ("rmw_service_info_t",),
    "duration_t": ("rmw_time_t",),
    "entities_t": tuple(f"rmw_{name}_t" for name in _SETS),
    "qos_t": ("rmw_qos_profile_t",),
    "messages_t": ("rmw_message_sequence_t", "rmw_message_info_sequence_t"),
    "allocator_t": ("rcutils_allocator_t",),
    "serialized_t": ("rcutils_uint8_array_t",),
    "texts_t": ("rcutils_string_array_t",),
    "ends_t": ("rmw_topic_endpoint_info_array_t",),
    "type_t": ("rosidl_message_type_support_t", "rosidl_service_type_support_t"),
}
#: Names that stand for a type of another name.
_PLAIN = {
    "_Bool": "bool",
    "rmw_time_point_value_t": "int64_t",
    "rcutils_time_point_value_t": "int64_t",
    "rmw_ret_t": "int",
    "ret_t": "int",
}
_FILLERS = frozenset(
    ("const", "static", "extern", "struct", "RMW_PUBLIC", "RMW_WARN_UNUSED", "RMW_DEPRECATED")
)
_FUNCTIONS = ("callback_t", "announce_t", "_function")

Shape = tuple[str, ...]


def main(words: list[str]) -> int:
    """Print the table; return the exit code."""
    headers = {name: read(where) for name, where in (word.split("=", 1) for word in words)}
    rows = dict(compare(preprocess(LAYER), headers))
    lines = ["| | " + " | ".join(headers) + " |", "|---" * (len(headers) + 1) + "|"]
    ordered = sorted(rows, key=lambda name: (rows[name], name))
    for answers, names in groupby(ordered, rows.__getitem__):
        lines.append(f"| {', '.join(f'`{name}`' for name in names)} | {' | '.join(answers)} |")
    sys.stdout.write("\n".join(lines) + "\n")
    return any("differs" in answers for answers in rows.values())


def compare(mine: str, headers: Mapping[str, str]) -> Iterator[tuple[str, Shape]]:
    """Yield functions and structs with what each distribution says of them."""
    for function in sorted(set(re.findall(r"\brmw_\w+(?=\()", mine))):
        own = signatures(mine, function)
        yield function, tuple(_judge(own, signatures(text, function)) for text in headers.values())
    for own_name, names in STRUCTS.items():
        shape = fields(mine, own_name)
        assert shape, f"{LAYER} has no {own_name}"
        for name in names:
            found = [fields(text, name) for text in headers.values()]
            yield name, tuple(_judge({shape}, {one[: len(shape)]} - {()}) for one in found)


def _judge(mine: set[Shape], found: set[Shape]) -> str:
    if not found:
        return "not there"
    return "same" if mine == found else "differs"


def signatures(text: str, function: str) -> set[Shape]:
    """Return how a function is declared: the kinds of what it returns and takes."""
    pattern = rf"([\w ]+[\s*]+){function}\s*\(([^()]*)\)\s*[{{;]"
    found = (match.groups() for match in re.finditer(pattern, text))
    return {
        (kind(result), *(kind(one) for one in taken.split(",") if one.strip() not in ("", "void")))
        for result, taken in found
        if "return" not in result.split()
    }


def fields(text: str, name: str) -> Shape:
    """Return the kinds of a struct's fields, those of structs in it in their places."""
    named = re.search(rf"struct [^{{}};]*\{{([^{{}}]*)\}}\s*{name}\s*;", text)
    match = named or re.search(rf"struct (?:\w+ )?{name}\s*\{{([^{{}}]*)\}}\s*;", text)
    shape: list[str] = []
    for field in match[1].split(";") if match else ():
        if field.strip():
            head, *more = field.split(",") if "(" not in field else [field]
            what = kind(head)
            inner = fields(text, what) if what.endswith(("_t", "_t_")) else ()
            shape += (inner or (what,)) * (1 + len(more))
    return tuple(shape)


def kind(declaration: str) -> str:
    """Return what a parameter or field is for its caller: a pointer, bytes, or a plain type."""
    words = [one for one in re.sub(r"\[.*", "", declaration).split() if one not in _FILLERS]
    if "*" in declaration or any(word.endswith(_FUNCTIONS) for word in words):
        return "pointer"
    if "[" in declaration:
        return "bytes"
    if "enum" in words or not words:
        return "int"
    return _PLAIN.get(words[0], words[0])


def preprocess(source: Path) -> str:
    """Return C after its preprocessor, without attributes."""
    cc = [found] if (found := shutil.which("cc")) else [sys.executable, "-m", "ziglang", "cc"]
    done = subprocess.run([*cc, "-E", "-P", source], capture_output=True, text=True, check=True)
    nested = r"__attribute__\s*\(\([^()]*(\([^()]*\))?[^()]*\)\)"
    return re.sub(nested, "", done.stdout)


def read(where: str) -> str:
    """Return the headers of a distribution, without comments and directives."""
    if "@" in where:
        clone, ref = where.rsplit("@", 1)
        listed = _git(clone, "ls-tree", "-r", "--name-only", ref, "rmw/include")
        names = [name for name in listed.split() if name.endswith(".h")]
        text = _git(clone, "show", *(f"{ref}:{name}" for name in names))
    else:
        wanted = ("rmw", "rcutils", "rosidl_runtime_c")
        paths = [path for name in wanted for path in sorted(Path(where).glob(f"{name}/**/*.h"))]
        text = "\n".join(path.read_text(encoding="utf-8") for path in paths)
    text = re.sub(r"/\*.*?\*/|//[^\n]*", "", text, flags=re.DOTALL)
    text = re.sub(r"^\s*#.*(?:\\\n.*)*", "", text, flags=re.MULTILINE)
    return re.sub(r"\bRMW_PUBLIC_TYPE\b", "", text)


def _git(clone: str, *words: str) -> str:
    done = subprocess.run(["git", "-C", clone, *words], capture_output=True, text=True, check=True)
    return done.stdout


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
