"""Print the size of each house, of golden files and of the documentation; fail above a limit.

usage: python -m tools.budget    a part of ./run lint

The limits are in pyproject.toml, [tool.rigel.budget]. To raise one is a commit of its own that says
why. Beside today's size stands that of the last tag, so that growth is a number in each review.
"""

from __future__ import annotations

import subprocess
import sys
import tarfile
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from io import BytesIO
from pathlib import Path, PurePosixPath

if sys.version_info >= (3, 11):
    import tomllib
else:  # a dependency of pytest
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
#: What counts as source; the page of `rigel ui` is measured by its own tests.
SOURCE = {".py", ".sh", ".c", ".h"}


def measure(files: Iterable[tuple[str, bytes]]) -> Counter[str]:
    """Return the sizes of (path, content): lines, and for the documentation words and pages."""
    sizes: Counter[str] = Counter()
    for name, content in files:
        path = PurePosixPath(name)
        if path.parts[0] == "src" and path.suffix in SOURCE:
            for key in (path.parts[1], "src"):
                sizes[key] += content.count(b"\n")
        elif path.parts[0] == "tests" and "golden" in path.parts and path.suffix == ".yaml":
            sizes["golden"] += content.count(b"\n")
        elif path.parts[0] == "docs" and path.suffix == ".md":
            sizes["words"] += len(content.split())
            sizes["pages"] += 1
    return sizes


def read_tree() -> Iterator[tuple[str, bytes]]:
    """Yield the files that git tracks, as they are now."""
    for name in git("ls-files", "-z").decode().rstrip("\0").split("\0"):
        if (ROOT / name).is_file():
            yield name, (ROOT / name).read_bytes()


def read_tag(tag: str) -> Iterator[tuple[str, bytes]]:
    """Yield the files of a tag."""
    with tarfile.open(fileobj=BytesIO(git("archive", tag))) as archive:
        for member in archive:
            content = archive.extractfile(member)
            if content is not None:
                yield member.name, content.read()


def find_tag() -> str:
    """Return the last tag before this commit, "" without one."""
    found = subprocess.run(
        ["git", "describe", "--tags", "--abbrev=0"], cwd=ROOT, capture_output=True, text=True
    )
    return found.stdout.strip()


def git(*words: str) -> bytes:
    """Return what git prints."""
    return subprocess.run(["git", *words], cwd=ROOT, check=True, capture_output=True).stdout


def compare(
    limits: Mapping[str, int], now: Mapping[str, int], before: Mapping[str, int], tag: str
) -> tuple[list[str], list[str]]:
    """Return the table, and what is over its limit."""
    rows: list[tuple[str, ...]] = [("", *([tag] if tag else []), "now", "limit")]
    for name, limit in limits.items():
        then = [f"{before.get(name, 0):,}"] if tag else []
        rows.append((name, *then, f"{now.get(name, 0):,}", f"{limit:,}"))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    table = [
        "  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]) for row in rows
    ]
    over = [
        f"{name}: {now[name]:,} is over the limit of {limit:,}: make something else unnecessary,"
        " or raise [tool.rigel.budget] in a commit that says why"
        for name, limit in limits.items()
        if now.get(name, 0) > limit
    ]
    return table, over


def main() -> int:
    """Print the table; return 1 if something is too large."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
    tag = find_tag()
    table, over = compare(
        settings["tool"]["rigel"]["budget"],
        measure(read_tree()),
        measure(read_tag(tag)) if tag else {},
        tag,
    )
    sys.stdout.write("\n".join(table) + "\n")
    sys.stderr.write("".join(f"error: {line}\n" for line in over))
    return bool(over)


if __name__ == "__main__":
    raise SystemExit(main())
