"""Names as each generation of ROS reads them: a node's, and both sides of a remapping.

The forms are those of rcl (its lexer of remapping rules) and of rosgraph.names; tests compare them
with both. What one generation accepts may end a node of the other.
"""

from __future__ import annotations

import re

import attrs

from rigel_k8s.option_text import has_template

#: rmw: characters of a node's name; a topic may have two more.
LONGEST = 245
#: rcl: a word, in which `__` is not allowed.
WORD = r"_?[A-Za-z](?:_?[A-Za-z0-9])*_?"
PATH = rf"{WORD}(?:/{WORD})*"


OWN_NAME = (re.compile("__(node|name|ns)"), "set `name` or `namespace` of the node")


@attrs.frozen
class Form:
    """The form of a name."""

    pattern: re.Pattern[str]
    expects: str


@attrs.frozen
class Names:
    """The names of a generation.

    Attributes:
        title: what messages call it.
        node: a node's name or namespace, with or without a path.
        source: what a remapping replaces; target: by what.
        hints: what a name of another form probably is.
    """

    title: str
    node: Form
    source: Form
    target: Form
    hints: tuple[tuple[re.Pattern[str], str], ...]

    def explain(self, form: Form, text: str) -> str | None:
        """Return why a text is not a name of a form; None if it is, or waits for data."""
        if has_template(text):
            return None
        if len(text) > LONGEST:
            return f"it is too long: at most {LONGEST} characters"
        if form.pattern.fullmatch(text):
            return None
        for pattern, hint in self.hints:
            if pattern.search(text) and (form != self.node or "~" not in text):
                return f'"{text}" is not a name of {self.title}: {hint}'
        return f'"{text}" is not {form.expects}'


NAMES_2 = Names(
    title="ROS 2",
    node=Form(
        re.compile(rf"/?{PATH}|/"), "a ROS 2 name: letters, digits, _ and /, no digit after a /"
    ),
    source=Form(
        re.compile(rf"(?:{WORD}:)?(?:rostopic://|rosservice://)?(?:~/|/)?{PATH}"),
        "what ROS 2 can remap: NAME, /NAME, ~/NAME or NODE:NAME",
    ),
    target=Form(re.compile(rf"(?:~/|/)?{PATH}"), "a name of ROS 2: NAME, /NAME or ~/NAME"),
    hints=(
        OWN_NAME,
        (re.compile(r"~(?!/)\w"), "a private name is written ~/NAME"),
        (re.compile(r"__"), 'ROS refuses "__" in it'),
    ),
)
#: rosgraph.names.NAME_LEGAL_CHARS_P, without "" and "//"; "/" and "~" are not what one remaps.
NAMES_1 = Names(
    title="ROS 1",
    node=Form(
        re.compile(r"/?[A-Za-z]\w*(?:/[A-Za-z]\w*)*|/", re.ASCII),
        "a ROS 1 name: letters, digits, _ and /, a letter after each /",
    ),
    source=Form(
        re.compile(r"(?:[~/]|~/|(?=[A-Za-z]))\w+(?:/\w+)*/?", re.ASCII),
        "what ROS 1 can remap: NAME, /NAME or ~NAME",
    ),
    target=Form(
        re.compile(r"(?:[~/]|~/|(?=[A-Za-z]))\w+(?:/\w+)*/?", re.ASCII),
        "a name of ROS 1: NAME, /NAME or ~NAME",
    ),
    hints=(OWN_NAME, (re.compile(":"), "only ROS 2 has NODE:NAME and rostopic://")),
)
