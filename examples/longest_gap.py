#!/usr/bin/env python3
"""Print the longest time without a message, of what `rigel logs listener --timestamps` prints.

usage: longest_gap.py [WORD]    of lines with this word alone, such as the name of a talker
"""

import itertools
import re
import sys
from datetime import datetime


def main() -> None:
    """Read log lines, print one line."""
    word = re.escape("".join(sys.argv[1:2]))
    stamp = re.compile(rf"^(\S+?)\.(\d+)Z .*I heard.*{word}")
    found = [match.groups() for match in map(stamp.match, sys.stdin) if match]
    times = [
        datetime.fromisoformat(second).timestamp() + float(f"0.{rest}") for second, rest in found
    ]
    gaps = [after - before for before, after in itertools.pairwise(times)]
    if not gaps:
        sys.exit("fewer than two messages arrived")
    usual = sorted(gaps)[len(gaps) // 2]
    print(
        f"{len(times)} messages, usually one every {usual:.2f} s;"
        f" the longest time without one: {max(gaps):.2f} s"
        " (an update adds about 0.1 s; a busy machine needs longer)"
    )


if __name__ == "__main__":
    main()
