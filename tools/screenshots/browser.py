"""Chromium without a window: a page at a width, in light or dark colors, as a picture.

Commands of its debugging protocol go over a pipe: no port is opened, and no library is needed.
"""

from __future__ import annotations

import base64
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
#: Seconds that a page may take, and a command.
PATIENCE = 30.0
#: Of a hundred: text stays sharp, and a page is a third of what PNG makes of it.
QUALITY = 85


class Browser:
    """One page of a running browser."""

    def __init__(self, commands: int, answers: int) -> None:
        self._commands = commands
        self._answers = answers
        self._rest = b""
        self._number = 0
        self._session: str | None = None
        self._events: list[dict[str, Any]] = []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        self.call("Page.enable")

    def open(self, address: str, *, width: int, height: int, dark: bool = False) -> None:
        """Load a page into a window of a size in CSS pixels, and wait until it is complete."""
        self.call("Page.navigate", url="about:blank")  # the page before would notice what follows
        scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        still = {"name": "prefers-reduced-motion", "value": "reduce"}
        self.call("Emulation.setEmulatedMedia", features=[scheme, still])
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=width < 600,
        )
        # The colors that a reader chose are kept, and would be those of the next page.
        origin = "/".join(address.split("/")[:3])
        self.call("Storage.clearDataForOrigin", origin=origin, storageTypes="all")
        self._events.clear()
        self.call("Page.navigate", url=address)
        self._wait_for("Page.loadEventFired")

    def picture(self) -> bytes:
        """Return what is in the window, as WebP."""
        found = self.call("Page.captureScreenshot", format="webp", quality=QUALITY)
        return base64.b64decode(found["data"])

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a command and return its answer."""
        self._number += 1
        message: dict[str, Any] = {"id": self._number, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._commands, json.dumps(message).encode() + b"\0")
        while True:
            answer = self._receive()
            if answer.get("id") == self._number:
                break
            self._events.append(answer)
        if "error" in answer:
            raise RuntimeError(f"{method}: {answer['error']['message']}")
        result: dict[str, Any] = answer["result"]
        return result

    def _wait_for(self, event: str) -> None:
        deadline = time.monotonic() + PATIENCE
        while not any(one.get("method") == event for one in self._events):
            if time.monotonic() > deadline:
                raise TimeoutError(f"no {event} in {PATIENCE:.0f} s")
            self._events.append(self._receive())

    def _receive(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            part = os.read(self._answers, 1 << 20)
            if not part:
                raise RuntimeError("the browser has ended")
            self._rest += part
        message, _, self._rest = self._rest.partition(b"\0")
        answer: dict[str, Any] = json.loads(message)
        return answer


@contextmanager
def run_browser() -> Iterator[Browser]:
    """Run a browser with a profile of its own."""
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        raise SystemExit(f"none of these is installed: {', '.join(PROGRAMS)}")
    # Processes of Chromium's may write for a moment after it has ended.
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        words = [program, "--headless", "--remote-debugging-pipe", f"--user-data-dir={profile}"]
        words += ["--disable-gpu", "--hide-scrollbars", "--no-first-run"]
        if os.geteuid() == 0:
            words.append("--no-sandbox")  # Chromium's does not work for root
        theirs, commands = os.pipe()
        answers, back = os.pipe()
        with subprocess.Popen(
            # The protocol is read from descriptor 3 and written to 4.
            ["bash", "-c", f'exec 3<&{theirs} 4>&{back}; exec "$@"', "bash", *words],
            pass_fds=(theirs, back),
            stderr=subprocess.DEVNULL,
        ) as child:
            os.close(theirs)
            os.close(back)
            try:
                yield Browser(commands, answers)
            finally:
                child.terminate()
                child.wait(PATIENCE)
                os.close(commands)
                os.close(answers)
