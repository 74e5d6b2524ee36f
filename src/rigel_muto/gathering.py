"""A stack with those that it refers to, in the order in which they are laid over each other."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from rigel_k8s.rigelfile.limits import LONGEST_CHAIN
from rigel_k8s.rigelfile.source import YamlNode
from rigel_muto.library import NotFound
from rigel_muto.remarks import Remark, Unreadable, error
from rigel_muto.stack import Stack, text_at


class Gathering:
    """Collects stacks, each once; those that one refers to come before it.

    Args:
        find: returns the stack of an id, or raises NotFound or Unreadable.
    """

    def __init__(self, find: Callable[[str], Stack]) -> None:
        self.remarks: list[Remark] = []
        self.stacks: list[Stack] = []
        self._find = find
        self._open: list[Stack] = []

    def add(self, stack: Stack) -> None:
        """Add a stack and all that it refers to; what is wrong becomes a remark."""
        if any(known is stack for known in self.stacks):
            return
        self._open.append(stack)
        for part in stack.parts:
            self.add(part)
        for reference in stack.references:
            self._follow(reference)
        self._open.pop()
        self.remarks += stack.remarks
        self.stacks.append(stack)

    def _follow(self, reference: YamlNode) -> None:
        identifier = text_at(reference.value, "thingId") or text_at(reference.value, "stackId")
        if not identifier:
            message = "a reference to a stack needs a thingId"
            self.remarks.append(error(reference, message, "missing-key"))
            return
        if chain := list(self._list_chain(identifier)):
            message = f"this stack refers to itself: {' -> '.join([*chain, identifier])}"
            self.remarks.append(error(reference, message, "stack-cycle"))
            return
        if len(self._open) > LONGEST_CHAIN:
            message = f"more than {LONGEST_CHAIN} stacks refer to each other"
            self.remarks.append(error(reference, message, "too-large"))
            return
        try:
            self.add(self._find(identifier))
        except NotFound as fault:
            self.remarks.append(error(reference, str(fault), "unknown-stack"))
        except Unreadable as fault:
            self.remarks.append(fault.remark)

    def _list_chain(self, identifier: str) -> Iterator[str]:
        """Yield the open stacks from the one of an id on; nothing where it is not open."""
        inside = False
        for stack in self._open:
            if identifier in stack.ids:
                inside = True
                yield identifier
            elif inside:
                yield stack.label
