"""usage: python -m tools.screenshots [SITE]    docs/pictures/site-* of what `./run docs` made"""

from __future__ import annotations

import sys
import threading
import time
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from tools.screenshots.browser import run_browser
from tools.screenshots.views import PICTURES, VIEWS

ROOT = Path(__file__).parents[2]


class Quiet(SimpleHTTPRequestHandler):
    """Serves files without printing what is fetched."""

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing."""


def main() -> None:
    """Take all pictures."""
    site = Path(sys.argv[1]) if sys.argv[1:] else ROOT / "site"
    if not (site / "index.html").is_file():
        raise SystemExit(f"{site} is not a site: run `./run docs` first")
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Quiet, directory=str(site))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with run_browser() as browser:
            for view in VIEWS:
                address = f"http://127.0.0.1:{server.server_port}/{view.page}"
                browser.open(address, width=view.width, height=view.height, dark=view.dark)
                time.sleep(view.seconds)
                (PICTURES / view.file).write_bytes(browser.picture())
        server.shutdown()


if __name__ == "__main__":
    main()
