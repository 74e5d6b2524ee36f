"""Take the pictures of docs/ui.md from a running `rigel ui`, light and dark.

usage: python -m tools.screenshots ADDRESS [NODE [TOPIC]]    they are chosen on the page

ADDRESS is what `rigel ui` prints. The pictures are of a real release: deploy one that has something
to show, such as a node that crashes. A topic shows its rate if a page was open for some minutes.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from urllib.parse import urlencode

from tests.support.browser import run_browser

PICTURES = Path(__file__).parents[1] / "docs" / "pictures"
SIZE = (1400, 900)
QUIET = 3.0  # seconds: the ROS graph and some lines of the log have come


def main(address: str, node: str = "", topic: str = "") -> None:
    """Write both pictures."""
    with run_browser() as browser:
        tab = browser.open()
        tab.resize(*SIZE)
        tab.go(f"{address}#{urlencode({'node': node, 'topic': topic})}")
        tab.wait("document.querySelector('.topic')", "the ROS graph")
        for scheme in ("light", "dark"):
            tab.prefer(scheme)
            time.sleep(QUIET)
            tab.picture(PICTURES / f"ui-{scheme}.png")


if __name__ == "__main__":
    if len(sys.argv) not in (2, 3, 4):
        sys.stderr.write(__doc__ or "")
        sys.exit(2)
    main(*sys.argv[1:])
