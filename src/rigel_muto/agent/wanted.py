"""What must run after a command, and its present state; pure.

The record is a contract with later versions of the agent: its format has a number.
"""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Mapping
from contextlib import suppress
from typing import Any, Literal

import attrs

from rigel_k8s.errors import UserError
from rigel_k8s.release.revisions import UNREADABLE, decompress
from rigel_muto.agent.commands import Command, Kill

#: starting, stopping: a command is being carried out. failed: what must run is not ready, or could
#: not be deployed. active is only used if all is ready.
State = Literal["idle", "starting", "active", "failed", "stopping", "killed"]

FORMAT = 1
#: Identities of commands that are remembered, to recognize duplicates.
MOST_IDENTITIES = 200
#: Bytes of a record: a Secret holds a mebibyte, a third more in base64.
LARGEST = 700_000


@attrs.frozen(kw_only=True)
class Wanted:
    """What must run: a stack by its text or its id, or Symphony's components; or nothing."""

    stack_id: str = ""
    stack: str | None = None
    components: Mapping[str, str] = attrs.field(factory=dict)

    @property
    def is_nothing(self) -> bool:
        return not (self.stack_id or self.stack is not None or self.components)

    @property
    def label(self) -> str:
        """The id of the stack; of components their names."""
        return self.stack_id or ", ".join(self.components)

    @property
    def text(self) -> str | None:
        """The text of the stack; None if only its id is known. Components are one solution."""
        return join(self.components) if self.components else self.stack


NOTHING = Wanted()


@attrs.frozen(kw_only=True)
class Record:
    """The last command that was accepted, and its result.

    Attributes:
        number: how many commands were accepted before and with it.
        identity: its own; identities: those of the accepted commands, the newest last.
        label: the id under which the twin has the stack; after a kill, the one that ran.
        is_there: it runs, or may still become ready: the cluster is checked from time to time.
        revision: the release's revision that it is; 0 while that is unknown.
        cause: why it failed.
    """

    number: int = 0
    identity: str = ""
    wanted: Wanted = NOTHING
    label: str = ""
    state: State = "idle"
    is_there: bool = False
    revision: int = 0
    cause: str = ""
    identities: tuple[str, ...] = ()

    @property
    def is_open(self) -> bool:
        """Whether a command is being carried out, perhaps by an agent that has ended."""
        return self.state in ("starting", "stopping")

    def accept(self, wanted: Wanted, identity: str) -> Record:
        """Return the record of a new command."""
        known = [*self.identities, *filter(None, [identity])]
        return Record(
            number=self.number + 1,
            identity=identity,
            wanted=wanted,
            label=self.label if wanted.is_nothing else wanted.label,
            state="stopping" if wanted.is_nothing else "starting",
            identities=tuple(known[-MOST_IDENTITIES:]),
        )


def apply_command(command: Command, now: Wanted) -> Wanted:
    """Return what must run after a command; what must run now, if the command changes nothing."""
    if not isinstance(command, Kill):
        if command.components:
            return Wanted(components={**now.components, **command.components})
        return Wanted(stack=command.stack, stack_id=command.stack_id)
    if command.components:
        if not set(command.components) & set(now.components):
            return now
        left = {n: text for n, text in now.components.items() if n not in command.components}
        return Wanted(components=left)
    return now if command.stack_id not in ("", now.stack_id) else NOTHING


def encode(record: Record) -> str:
    """Return a record as a Secret contains it.

    Raises:
        UserError: it is too large.
    """
    text = json.dumps({"format": FORMAT, **attrs.asdict(record)}, sort_keys=True)
    packed = gzip.compress(text.encode(), mtime=0)
    if len(packed) > LARGEST:
        raise UserError(
            f"this stack has {len(packed)} bytes after compression, and a Secret keeps {LARGEST}",
            hint="split it, or put it into the Ditto and send its id",
        )
    return base64.b64encode(packed).decode()


def decode(data: str) -> Record:
    """Return the record of a Secret's data.

    Raises:
        UserError: another version of this tool wrote it, or someone has changed it.
    """
    why = "is damaged"
    with suppress(*UNREADABLE):
        content: dict[str, Any] = json.loads(decompress(base64.b64decode(data)))
        if (found := content.pop("format", None)) == FORMAT:
            content["identities"] = tuple(content["identities"])
            return Record(wanted=Wanted(**content.pop("wanted")), **content)
        why = f"has the format {found}, and this version reads {FORMAT}"
    hint = "use the version of rigel-k8s that wrote it, or delete the Secret"
    raise UserError(f"the agent's record {why}", hint=hint)


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
