"""Symphony's components, of which each is a stack, as one stack: all of them are one release."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping


def join(components: Mapping[str, str]) -> str:
    """Return the text of a Symphony solution that contains the texts of stacks, by name."""
    listed = [
        {
            "name": name,
            "properties": {"type": "stack", "data": base64.b64encode(text.encode()).decode()},
        }
        for name, text in components.items()
    ]
    return json.dumps({"spec": {"components": listed}})
