"""Parameter files, and what rcl of jazzy reads of them for a node: None if the node ends.

tests/ros2/test_names.py asks rcl again; the unit tests compare our reading with the answers.
"""

from __future__ import annotations

from typing import Any

A = "{ros__parameters: {a: 1}}"
#: The file, and the parameters of /mapper and of /r1/mapper.
MATCHING: list[tuple[str, bool, bool]] = [
    (f"mapper: {A}", True, False),
    (f"/mapper: {A}", True, False),
    (f"/r1/mapper: {A}", False, True),
    (f"r1/mapper: {A}", False, True),
    (f"r1: {{mapper: {A}}}", False, True),
    (f"/r1: {{mapper: {A}}}", False, True),
    (f"/**/mapper: {A}", True, True),
    (f"/*/mapper: {A}", False, True),
    (f"'*': {A}", True, False),
    (f"/*: {A}", True, False),
    (f"/**: {A}", True, True),
    (f"/**: {{mapper: {A}}}", True, True),
    (f"/r1/*: {A}", False, True),
    (f"/r1/**: {A}", False, True),
    (f"/**/r1/mapper: {A}", False, True),
    (f"/mapper/**: {A}", True, False),
    (f"/*/*: {A}", False, True),
    (f"slam: {A}", False, False),
    (f"mapper: {{sub: {A}}}", False, False),
    (f"--- # note\nmapper: {A}", True, False),
]
#: Files with which the node ends, or reads something else than is written.
WRONG = [
    "mapper: {ros__parameters: {a: 1}, b: 2}",
    "mapper:\n  ros__parameters:",
    "ros__parameters: {a: 1}",
    "mapper: {ros__parameters: 1}",
    "mapper: {ros__parameters: [1]}",
    f"map*: {A}",
    f"mapper/: {A}",
    f"//mapper: {A}",
    "/**: {ros__parameters: {a: &x 1, b: *x}}",
]
#: A value, and what rcl reads; ... if the node ends.
VALUES: list[tuple[str, Any]] = [
    ("1", 1),
    ("0x10", 16),
    ("012", 10),
    ("1e5", 100000.0),
    ("yes", True),
    ("'1'", "1"),
    ("1_000", "1_000"),
    ("2020-01-01", "2020-01-01"),
    ("[1, 2]", [1, 2]),
    ("[1.0, 1e5]", [1.0, 1e5]),
    ("[yes, no]", [True, False]),
    ("[a, b]", ["a", "b"]),
    ("['1', '2.5']", ["1", "2.5"]),
    ("", ...),
    ("[1, 2.5]", ...),
    ("[a, 1]", ...),
    ("[1, null]", ...),
    ("[[1], [2]]", ...),
    ("[]", ...),
]
