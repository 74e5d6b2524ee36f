"""The samples: stacks of the forms that Muto's own samples have."""

from __future__ import annotations

from pathlib import Path

FOLDER = Path(__file__).parent / "samples"
#: The samples: a directory, and the file or id of a stack in it.
SAMPLES = {
    "talker-listener": (".", "talker-listener.json"),
    "thing": (".", "thing.json"),
    "race": ("things", "org.example.robots:race"),
    "described": (".", "described.json"),
    "solution": (".", "solution.json"),
    "composed": (".", "composed.json"),
    "nodelets": (".", "nodelets.json"),
    "container": (".", "container.json"),
    "not-carried": (".", "not-carried.json"),
}
