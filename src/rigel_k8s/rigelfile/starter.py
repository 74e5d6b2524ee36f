"""The Rigelfiles that `rigel init` writes: a talker and a listener, ready to be changed."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.resources import files
from string import Template


def render_starter(words: Mapping[str, str]) -> str:
    """Return the Rigelfile with the words of a generation of ROS."""
    text = (files(__package__) / "starter.Rigelfile").read_text("utf-8")
    return Template(text).substitute(words)
