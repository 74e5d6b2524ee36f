"""What commands may use; everything else is refused. Pure."""

from __future__ import annotations

import re
from collections.abc import Iterable
from fnmatch import fnmatchcase

import attrs

from rigel_k8s.errors import UserError
from rigel_muto.agent.wanted import Wanted

_ID = re.compile(r"[\w.:+@-]+", re.ASCII)


@attrs.frozen
class Allowance:
    """The lists of one agent; `*` in a pattern stands for any text.

    Attributes:
        stacks: patterns of the ids that a command may name.
        images: patterns of the images that a deploy may use.
        whole_stacks: a command may contain its stack. Its id is then only the sender's claim, so
            that `stacks` does not apply.
    """

    stacks: tuple[str, ...] = ("*",)
    images: tuple[str, ...] = ("*",)
    whole_stacks: bool = False

    def check_stack(self, wanted: Wanted) -> None:
        """Refuse a stack that commands may not use.

        Raises:
            UserError: with what is allowed.
        """
        if wanted.text is not None:
            if not self.whole_stacks:
                raise UserError(
                    "a command must not bring a whole stack to this agent",
                    hint="send the id of a stack, or allow it with `whole_stacks: true`",
                )
            return
        if not _ID.fullmatch(wanted.stack_id):
            raise UserError(f'"{wanted.stack_id}" is not the id of a stack')
        if not matches(wanted.stack_id, self.stacks):
            raise UserError(
                f'the stack "{wanted.stack_id}" is not allowed: stacks: {", ".join(self.stacks)}'
            )

    def check_images(self, images: Iterable[str]) -> None:
        """Refuse images that commands may not deploy. Raises as check_stack."""
        for image in images:
            if not matches(image, self.images):
                raise UserError(
                    f'the image "{image}" is not allowed: images: {", ".join(self.images)}'
                )


def matches(text: str, patterns: Iterable[str]) -> bool:
    """Return whether any pattern allows a text."""
    return any(fnmatchcase(text, pattern) for pattern in patterns)
