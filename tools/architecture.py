"""Draw docs/architecture.svg: the packages and their imports, from the code.

usage: python -m tools.architecture    write the picture (a test fails if it is out of date)

Each row is a layer of the import-linter contract in pyproject.toml. An arrow leads from a package
to one that it imports; one that a chain of others implies is left out. The picture has a light and
a dark form, chosen by the reader's browser.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path

if sys.version_info >= (3, 11):
    import tomllib
else:  # a dependency of pytest
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PICTURE = ROOT / "docs" / "architecture.svg"

#: A short description of each package.
WORDS = {
    "cli": "arguments, printing",
    "commands": "what a command does",
    "compat": "Rigel 0.3",
    "jobs": "runner and job types",
    "app": "one ROS application",
    "observability": "exporter, readers of logs and metrics",
    "network": "modes: how pods find each other",
    "rigel_graph": "live graph, pictures",
    "rigel_import": "launch and Compose files",
    "rigel_build": "images of applications",
    "rigel_stack": "logs, metrics, dashboards",
    "rigel_ui": "a live page in the browser",
    "rigel_multus": "second networks",
    "rigel_muto": "stacks of Eclipse Muto",
    "rigel_lab": "local cluster, base images",
    "images": "registries",
    "release": "plan, apply, wait, record",
    "rigelfile": "text with places, options",
    "rigel_exporter": "program in its own image",
    "rigel_gate": "in front of roscore",
    "kube": "HTTP to the cluster",
    "rigel_inpod": "scripts in the pods",
    "rigel_rmw": "inside of ROS 2 nodes",
    "objects": "Kubernetes vocabulary",
    "system": "files, programs, connections",
}

BOX, HEIGHT, GAP, ROW, MARGIN = 180, 46, 20, 84, 24
STYLE = """
    text { font: 14px system-ui, sans-serif; fill: #1f2328; text-anchor: middle }
    .words { font-size: 11px; fill: #59636e }
    rect { fill: #f6f8fa; stroke: #8b949e; rx: 7 }
    path { fill: none; stroke: #8b949e; opacity: .55 }
    marker path { fill: #8b949e; opacity: 1 }
    @media (prefers-color-scheme: dark) {
      text { fill: #e6edf3 } .words { fill: #9198a1 }
      rect { fill: #161b22; stroke: #6e7681 } path { stroke: #8b949e }
    }
"""


def layers() -> list[list[str]]:
    """Return the packages of each layer, from the top, as import-linter's contract has them."""
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    contracts = tomllib.loads(text)["tool"]["importlinter"]["contracts"]
    rows = next(one["layers"] for one in contracts if one["type"] == "layers")
    names = [[one.strip().removeprefix("rigel_k8s.") for one in row.split("|")] for row in rows]
    return [row for row in ([n for n in some if n in WORDS] for some in names) if row]


def package_of(module: str) -> str:
    """Return the package that a dotted module name is in, "" for one that is not drawn."""
    first, _, rest = module.partition(".")
    name = rest.split(".")[0] if first == "rigel_k8s" else first
    return name if name in WORDS else ""


def find_imports(file: Path) -> Iterator[str]:
    """Yield the modules that a file imports by their full names."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def arrows() -> set[tuple[str, str]]:
    """Return (package, package that it imports), each once."""
    found: set[tuple[str, str]] = set()
    for file in sorted((ROOT / "src").rglob("*.py")):
        if "files" in file.parts:
            continue
        importer = package_of(".".join(file.relative_to(ROOT / "src").with_suffix("").parts))
        found |= {(importer, package_of(name)) for name in find_imports(file)}
    return {(a, b) for a, b in found if a and b and a != b}


def reduce_pairs(pairs: set[tuple[str, str]]) -> set[tuple[str, str]]:
    """Return the arrows that no chain of other arrows implies."""
    below: dict[str, set[str]] = {}
    for a, b in pairs:
        below.setdefault(a, set()).add(b)

    def reach(name: str) -> set[str]:
        direct = below.get(name, set())
        return direct.union(*(reach(other) for other in direct))

    return {(a, b) for a, b in pairs if not any(b in reach(c) for c in below[a] if c != b)}


def width_of(row: Sequence[str]) -> int:
    """Return the width of a layer's boxes."""
    return len(row) * BOX + (len(row) - 1) * GAP


def places(rows: Sequence[Sequence[str]]) -> dict[str, tuple[float, float]]:
    """Return the middle of each box's upper edge."""
    found: dict[str, tuple[float, float]] = {}
    middle = max(map(width_of, rows)) / 2 + MARGIN
    for number, row in enumerate(rows):
        for index, name in enumerate(row):
            left = middle - width_of(row) / 2 + index * (BOX + GAP)
            found[name] = (left + BOX / 2, MARGIN + number * ROW)
    return found


def draw(rows: Sequence[Sequence[str]], pairs: set[tuple[str, str]]) -> str:
    """Return the picture as SVG."""
    at = places(rows)
    width = 2 * MARGIN + max(map(width_of, rows))
    height = 2 * MARGIN + (len(rows) - 1) * ROW + HEIGHT
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img">',
            "  <title>The packages of rigel-k8s and their imports</title>",
            f"  <style>{STYLE}  </style>",
            '  <defs><marker id="tip" viewBox="0 0 6 6" refX="5" refY="3" markerWidth="7"'
            ' markerHeight="7" orient="auto"><path d="M0 0 L6 3 L0 6 z"/></marker></defs>',
            *(arrow(at[a], at[b], width / 2) for a, b in sorted(pairs) if a in at and b in at),
            *(box(name, *middle) for name, middle in at.items()),
            "</svg>",
            "",
        ]
    )


def arrow(start: tuple[float, float], end: tuple[float, float], middle: float) -> str:
    """Return one arrow; one over several layers bends aside, away from the middle."""
    (x1, y1), (x2, y2) = start, end
    y1 += HEIGHT
    aside = 0 if y2 - y1 < ROW else (1 if x1 + x2 >= 2 * middle else -1) * (y2 - y1) * 0.22
    bend = f"{x1 + aside:.0f} {y1 + (y2 - y1) / 2:.0f} {x2 + aside:.0f} {y1 + (y2 - y1) / 2:.0f}"
    return f'  <path d="M{x1:.0f} {y1} C{bend} {x2:.0f} {y2}" marker-end="url(#tip)"/>'


def box(name: str, x: float, y: float) -> str:
    """Return one package."""
    return (
        f'  <rect x="{x - BOX / 2:.0f}" y="{y}" width="{BOX}" height="{HEIGHT}"/>'
        f'<text x="{x:.0f}" y="{y + 20}">{escape(name)}</text>'
        f'<text class="words" x="{x:.0f}" y="{y + 36}">{escape(WORDS[name])}</text>'
    )


def picture() -> str:
    """Return the picture of the current code."""
    return draw(layers(), reduce_pairs(arrows()))


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
