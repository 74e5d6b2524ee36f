"""The proof: the tests on a cluster of `./run test`, one for each promise of the README.

The list is a table for readers, in docs/what-was-run.md. `./run test --all` has the other tests.
"""

from __future__ import annotations

import re
from pathlib import Path

TABLE = Path(__file__).parents[1] / "docs" / "what-was-run.md"
#: The id of a test without its parameters -> what it proves.
PROOF = {
    nodeid: promise
    for promise, nodeid in re.findall(r"^\| (.+) \| `(tests/.+::.+)` \|$", TABLE.read_text(), re.M)
}


def is_proof(nodeid: str) -> bool:
    """Return whether a test is part of the proof, with any parameters."""
    return nodeid.partition("[")[0] in PROOF
