"""Files beside a Rigelfile that its options name: each is read once, and judged at each use."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import TypeAlias, TypeVar

from rigel_k8s.errors import UserError
from rigel_k8s.option_text import has_template
from rigel_k8s.problems import Path as OptionPath
from rigel_k8s.problems import Problem
from rigel_k8s.system.trust import Untrusted

T = TypeVar("T")
#: The path of the option, the file's path as written, and its content or what is wrong with it.
Use: TypeAlias = tuple[OptionPath, str, T | UserError]


def read_each(
    named: Iterable[tuple[OptionPath, str]],
    read: Callable[[str], T],
    size: Callable[[T], int],
    most: int,
    excess: UserError,
) -> Iterator[Use[T]]:
    """Yield each use of files; the one with which there are too many is the last.

    Args:
        named: (path of the option, path as written), as often as it is used.
        read: returns a file's content; raises UserError.
        size: of a content, which counts at each use; `most` of all together.
        excess: the result of a use that is too much.
    """
    found: dict[str, T | UserError] = {}
    total = 0
    for path, name in named:
        if name not in found:
            try:
                found[name] = read(name)
            except UserError as error:
                found[name] = error
        result = found[name]
        total += 0 if isinstance(result, UserError) else size(result)
        if total > most:
            yield path, name, excess
            return
        yield path, name, result


def collect(
    uses: Iterable[Use[T]], what: str, option: Callable[[OptionPath], OptionPath]
) -> dict[str, T]:
    """Return the contents by their paths as written. Raises UserError for the first without one.

    Args:
        what: how messages of the files begin, which is left out.
        option: returns what of an option's path the error begins with instead.
    """
    contents = {}
    for path, name, result in uses:
        if isinstance(result, UserError):
            text = f"{'.'.join(map(str, option(path)))}: {result.message.removeprefix(what)}"
            raise type(result)(text, hint=result.hint) from result
        contents[name] = result
    return contents


def explain(uses: Iterable[Use[T]], what: str, kind: str) -> Iterator[Problem]:
    """Yield what `collect` would refuse, as problems of a kind; a path with a template waits."""
    for path, name, result in uses:
        if isinstance(result, UserError) and not has_template(name):
            found = "untrusted" if isinstance(result, Untrusted) else kind
            message = result.message.removeprefix(what)
            yield Problem(path, "; ".join(filter(None, (message, result.hint))), found)
