"""usage: python -m tools.screenshots [SITE]    docs/pictures/site-* of what `./run docs` made"""

from __future__ import annotations

import sys
import threading
import time
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from tests.support.browser import run_browser
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
            origin = f"http://127.0.0.1:{server.server_port}"
            for view in VIEWS:
                tab = browser.open()
                tab.forget(origin)
                tab.prefer("dark" if view.dark else "light")
                tab.resize(view.width, view.height, mobile=view.width < 600)
                tab.go(f"{origin}/{view.page}")
                time.sleep(view.seconds)
                tab.picture(PICTURES / view.file)
                tab.close()
        server.shutdown()


if __name__ == "__main__":
    main()
