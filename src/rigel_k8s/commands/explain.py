"""What the words of `rigel` and of kubectl mean, where there is more to say than a message does."""

from __future__ import annotations

import re
from difflib import get_close_matches

import attrs

from rigel_k8s.app.deploying.guests import load_guests
from rigel_k8s.errors import UserError
from rigel_k8s.kinds import KUBECTL, PODS
from rigel_k8s.release.rollout.causes import CAUSES

LINK = re.compile(r"\[([^]]*)\]\(([^)]*)\)")


@attrs.frozen
class Explanation:
    """What a word means.

    Attributes:
        group: where the word is printed.
        cause, remedy: plain text; the remedy is "" where the message has it.
        found_by: where preflight's answer comes from.
    """

    kind: str
    group: str
    cause: str
    remedy: str = ""
    found_by: str = ""


def list_kinds() -> list[Explanation]:
    """Return all, in the order of docs/errors.md; a kind of two groups is there twice."""
    of_pods = (("not ready", {**CAUSES, **PODS}), ("kubectl get pods", KUBECTL))
    explanations = [
        Explanation(name, group, strip_links(kind.cause), strip_links(kind.remedy))
        for group, kinds in of_pods
        for name, kind in kinds.items()
    ]
    found = [kind for guest in load_guests() for kind in guest.kinds()]
    return explanations + [
        Explanation(name, "network", strip_links(cause), found_by=strip_links(by))
        for name, cause, by in found
    ]


def strip_links(markdown: str) -> str:
    """Return a text without its links, which a terminal cannot follow."""
    return LINK.sub(r"\1", markdown)


def explain(kind: str) -> list[Explanation]:
    """Return what a word means in each group that has it.

    Raises:
        UserError: nothing is to be said beyond the message.
    """
    name = kind.strip().strip("[]")
    known = list_kinds()
    if explanations := [one for one in known if one.kind == name]:
        return explanations
    close = get_close_matches(name, {one.kind for one in known}, n=1)
    meant = f', did you mean "{close[0]}"?' if close else ""
    raise UserError(
        f'no explanation of "{name}"{meant}',
        hint="the message before a word in brackets says what is wrong, where, and what to do;"
        " `rigel explain` lists the words that have more to explain",
    )
