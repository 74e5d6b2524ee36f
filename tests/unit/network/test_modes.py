"""The registry of modes: complete, and asked for what used to be lists of names."""

from __future__ import annotations

import typing

import attrs
import pytest

from rigel_k8s.network.checks import index_readers
from rigel_k8s.network.modes import MODES, mode_of
from rigel_k8s.network.options import ModeName, Network


def test_each_mode_of_the_grammar_is_there() -> None:
    """A word that the Rigelfile accepts has a module, and each module has its word."""
    assert list(MODES) == list(typing.get_args(ModeName))
    assert [mode.name for mode in MODES.values()] == list(MODES)


@pytest.mark.parametrize("name", MODES)
def test_a_mode_reads_only_options_that_there_are(name: str) -> None:
    """A key that is misspelt in a mode would never be reported as foreign to others."""
    assert MODES[name].keys <= {field.name for field in attrs.fields(Network)}


def test_options_of_all_modes_are_read_by_all() -> None:
    """`mode` and `domain_id` belong to no mode alone; every other option belongs to some."""
    assert {f.name for f in attrs.fields(Network)} - index_readers().keys() == {"mode", "domain_id"}


def test_no_network_is_mode_none() -> None:
    """Whoever has no `network` is wired as with `network: none`."""
    assert mode_of(None) is MODES["none"]


def test_only_what_multus_attaches_is_attached() -> None:
    """Readiness waits for the second interface, and Multus is installed, in these modes alone."""
    assert [m.name for m in MODES.values() if m.attached] == ["macvlan", "attachment"]
