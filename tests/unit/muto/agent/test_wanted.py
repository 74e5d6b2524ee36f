"""What must run after a command, and how it is remembered."""

from __future__ import annotations

import base64
import gzip
import json
import random

import pytest

from rigel_k8s.errors import UserError
from rigel_muto.agent.commands import Command, Deploy, Kill
from rigel_muto.agent.wanted import (
    MOST_IDENTITIES,
    NOTHING,
    Record,
    Wanted,
    apply_command,
    decode,
    encode,
)

BOTH = Wanted(components={"one": "1", "two": "2"})
STACK = Wanted(stack_id="org:a")


@pytest.mark.parametrize(
    ("now", "command", "then"),
    [
        (NOTHING, Deploy(stack_id="org:a"), STACK),
        (BOTH, Deploy(stack="{}", stack_id="org:b"), Wanted(stack="{}", stack_id="org:b")),
        (STACK, Deploy(components={"one": "1"}), Wanted(components={"one": "1"})),
        (BOTH, Deploy(components={"one": "3"}), Wanted(components={"one": "3", "two": "2"})),
        (BOTH, Kill(components=("one", "other")), Wanted(components={"two": "2"})),
        (BOTH, Kill(components=("one", "two")), NOTHING),
        (BOTH, Kill(components=("other",)), BOTH),
        (STACK, Kill(components=("one",)), STACK),
        (STACK, Kill(stack_id="org:a"), NOTHING),
        (STACK, Kill(stack_id="org:b"), STACK),
        (STACK, Kill(), NOTHING),
        (BOTH, Kill(), NOTHING),
    ],
)
def test_what_must_run_after_a_command(now: Wanted, command: Command, then: Wanted) -> None:
    assert apply_command(command, now) == then


def test_a_record_is_read_as_it_was_written() -> None:
    record = Record(identities=("0",)).accept(Wanted(stack='{"ü": 1}', stack_id="org:a"), "1")
    assert decode(encode(record)) == record
    assert record.is_open
    killed = record.accept(NOTHING, "")
    assert (killed.number, killed.label, killed.state) == (2, "org:a", "stopping")
    assert killed.identities == ("0", "1")


def test_old_identities_are_forgotten() -> None:
    record = Record()
    for number in range(MOST_IDENTITIES + 1):
        record = record.accept(STACK, str(number))
    assert record.identities[0] == "1"


def test_a_stack_that_no_secret_can_hold_is_an_error() -> None:
    noise = base64.b64encode(random.Random(1).randbytes(2**20)).decode()
    with pytest.raises(UserError, match="a Secret keeps"):
        encode(Record().accept(Wanted(stack=noise), ""))


def test_the_record_of_another_version_is_refused() -> None:
    data = base64.b64encode(gzip.compress(json.dumps({"format": 2}).encode())).decode()
    with pytest.raises(UserError, match="format 2"):
        decode(data)


@pytest.mark.parametrize(
    "text",
    ["", "[]", "{", '{"format": 1}', '{"format": 1, "wanted": {"x": 1}, "identities": []}'],
)
def test_a_record_that_someone_has_changed_is_refused(text: str) -> None:
    """With a way out, for whoever reads the agent's log."""
    for data in (text, base64.b64encode(gzip.compress(text.encode())).decode()):
        with pytest.raises(UserError, match="the agent's record is damaged") as caught:
            decode(data)
        assert "delete the Secret" in str(caught.value.hint)
