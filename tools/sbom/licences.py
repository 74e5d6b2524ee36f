"""The text of a licence -> its SPDX identifier, for the well-known ones.

A licence is recognized by a sentence that only it has. A text without any of them is unknown.
"""

from __future__ import annotations

import re
from pathlib import Path

from tools.sbom.parts import UNKNOWN

#: SPDX identifier -> what its text has: words in lower case, with single spaces between them.
_SENTENCES = {
    "AGPL-3.0-only": "gnu affero general public license version 3 19 november 2007",
    "GPL-3.0-only": "gnu general public license version 3 29 june 2007",
    "GPL-2.0-only": "gnu general public license version 2 june 1991",
    "LGPL-3.0-only": "gnu lesser general public license version 3 29 june 2007",
    "LGPL-2.1-only": "gnu lesser general public license version 2 1 february 1999",
    "MPL-2.0": "mozilla public license version 2 0 1 definitions",
    "Apache-2.0": "apache license version 2 0",
    "MIT": "permission is hereby granted free of charge to any person obtaining a copy",
    "ISC": "permission to use copy modify and or distribute this software for any purpose",
    "Unlicense": "this is free and unencumbered software released into the public domain",
    "CC0-1.0": "cc0 1 0 universal",
    "CC-BY-4.0": "creative commons attribution 4 0 international",
    "EPL-2.0": "eclipse public license v 2 0",
    "Zlib": "this software is provided as is without any express or implied warranty in no event",
}
_BSD = "redistribution and use in source and binary forms"
_ENDORSE = re.compile(r"(used|use) to endorse or promote products")
_NAMES = re.compile(r"(UN)?(LICEN[CS]E|COPYING)([-_.].*)?", re.IGNORECASE)


def recognize(text: str) -> str:
    """Return the SPDX expression of a licence's text, UNKNOWN if no well-known one matches."""
    words = " ".join(re.findall(r"[a-z0-9]+", text.lower()))
    found = [name for name, sentence in _SENTENCES.items() if sentence in words]
    if _BSD in words:
        found.append("BSD-3-Clause" if _ENDORSE.search(words) else "BSD-2-Clause")
    return " AND ".join(sorted(found)) or UNKNOWN


def recognize_directory(directory: Path) -> str:
    """Return the SPDX expression of a directory's licence files, UNKNOWN if it has none."""
    if not directory.is_dir():
        return UNKNOWN
    files = [path for path in directory.iterdir() if path.is_file() and _NAMES.fullmatch(path.name)]
    names = {
        name
        for path in files
        for name in recognize(path.read_text("utf-8", "replace")).split(" AND ")
    }
    if len(names) > 1:
        names.discard(UNKNOWN)
    return " AND ".join(sorted(names)) or UNKNOWN
