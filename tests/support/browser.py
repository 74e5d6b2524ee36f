"""Headless Chromium, driven by its own debugging protocol over a websocket.

A driver (playwright, selenium) would be tens of megabytes of requirements; what the tests need of
one is here: pages, keys, pictures, the tree that screen readers get.
"""

from __future__ import annotations

import base64
import itertools
import json
import os
import shutil
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import websocket

from .until import until

PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
#: What a headless browser in a container needs, and what keeps it from asking others anything.
WORDS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"),
    *("--no-first-run", "--no-default-browser-check", "--disable-extensions"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    *("--remote-debugging-port=0", "--remote-allow-origins=*", "--force-color-profile=srgb"),
    "--hide-scrollbars",
)
ANSWER = 60.0  # seconds for an answer of the browser
KEYS = {
    "Tab": ("Tab", 9),
    "Enter": ("Enter", 13),
    "Escape": ("Escape", 27),
    "ArrowRight": ("ArrowRight", 39),
    "ArrowLeft": ("ArrowLeft", 37),
    "ArrowDown": ("ArrowDown", 40),
    "ArrowUp": ("ArrowUp", 38),
    "Home": ("Home", 36),
    "End": ("End", 35),
}


def find_program() -> str | None:
    """Return the browser of this machine, None where it has none."""
    return next(filter(None, map(shutil.which, PROGRAMS)), None)


class Browser:
    """A running browser: requests and answers, by session."""

    def __init__(self, address: str, pid: int) -> None:
        self.pid = pid
        self._socket = websocket.create_connection(address, timeout=ANSWER, suppress_origin=True)
        self._numbers = itertools.count(1)
        self._answers: dict[int, dict[str, Any]] = {}
        self._events: dict[str, list[dict[str, Any]]] = {}
        self._news = threading.Condition()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        while True:
            try:
                text = self._socket.recv()
            except (OSError, websocket.WebSocketException):
                return
            if not text:
                return
            message = json.loads(text)
            with self._news:
                if "id" in message:
                    self._answers[message["id"]] = message
                else:
                    self._events.setdefault(message.get("sessionId", ""), []).append(message)
                self._news.notify_all()

    def call(self, method: str, session: str = "", **parameters: Any) -> Any:
        """Ask the browser, and return its answer."""
        number = next(self._numbers)
        message = {"id": number, "method": method, "params": parameters}
        if session:
            message["sessionId"] = session
        self._socket.send(json.dumps(message))
        with self._news:
            assert self._news.wait_for(lambda: number in self._answers, ANSWER), method
            answer = self._answers.pop(number)
        assert "error" not in answer, f"{method}: {answer['error']}"
        return answer["result"]

    def events(self, session: str, method: str) -> list[dict[str, Any]]:
        """Return what has happened in a page."""
        with self._news:
            return [e["params"] for e in self._events.get(session, []) if e["method"] == method]

    def open(self, address: str = "about:blank") -> Tab:
        """Open a page."""
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        attached = self.call("Target.attachToTarget", targetId=target, flatten=True)
        tab = Tab(self, target, attached["sessionId"])
        for domain in ("Page", "Runtime", "Log", "Network", "Accessibility"):
            tab.call(f"{domain}.enable")
        if address != "about:blank":
            tab.go(address)
        return tab

    def close(self) -> None:
        """End the connection."""
        self._socket.close()


class Tab:
    """A page."""

    def __init__(self, browser: Browser, target: str, session: str) -> None:
        self.browser, self.target, self.session = browser, target, session

    def call(self, method: str, **parameters: Any) -> Any:
        return self.browser.call(method, self.session, **parameters)

    def go(self, address: str) -> None:
        """Go to an address."""
        self.call("Page.navigate", url=address)
        until(lambda: self.read("document.readyState") == "complete", f"{address} to load", 60)

    def read(self, expression: str) -> Any:
        """Return the value of an expression in the page."""
        answer = self.call(
            "Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait(self, expression: str, what: str, seconds: float = 60.0) -> None:
        """Wait until an expression is true. It fails with what the page shows."""
        end = time.monotonic() + seconds
        while not self.read(f"Boolean({expression})"):
            if time.monotonic() > end:
                raise AssertionError(f"no {what} after {seconds} s:\n{self.text()}")
            time.sleep(0.05)

    def text(self) -> str:
        """Return what the page shows."""
        return str(self.read("document.body.innerText"))

    def press(self, *keys: str) -> None:
        """Press keys, one after the other; `Shift+Tab` goes back."""
        for key in keys:
            shift = key.startswith("Shift+")
            name, code = KEYS[key.removeprefix("Shift+")]
            common = {"key": name, "code": name, "windowsVirtualKeyCode": code}
            text = {"text": "\r"} if name == "Enter" else {}
            modifiers = 8 if shift else 0
            self.call(
                "Input.dispatchKeyEvent", type="keyDown", modifiers=modifiers, **common, **text
            )
            self.call("Input.dispatchKeyEvent", type="keyUp", modifiers=modifiers, **common)

    def type(self, text: str) -> None:
        """Type a text into what has the focus."""
        self.call("Input.insertText", text=text)

    def resize(self, width: int, height: int, *, mobile: bool = False) -> None:
        """Give the page another size, in CSS pixels."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width, height=height, deviceScaleFactor=1, mobile=mobile,
        )  # fmt: skip

    def prefer(self, scheme: str) -> None:
        """Prefer light or dark colors."""
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self.call("Emulation.setEmulatedMedia", features=features)

    def forget(self, origin: str) -> None:
        """Delete what a site has stored in the browser, such as colors that were chosen."""
        self.call("Storage.clearDataForOrigin", origin=origin, storageTypes="all")

    def show(self) -> None:
        """Bring the page to the front; the others are hidden then."""
        self.call("Page.bringToFront")

    def picture(self, path: Path, *, whole: bool = False) -> None:
        """Write a picture of the page; the file's suffix is its format: png or webp."""
        form: dict[str, Any] = {"format": path.suffix.removeprefix(".")}
        if path.suffix == ".webp":
            form["quality"] = 85  # text stays sharp, and a page is a third of its PNG
        answer = self.call("Page.captureScreenshot", captureBeyondViewport=whole, **form)
        path.write_bytes(base64.b64decode(answer["data"]))

    def tree(self) -> list[dict[str, Any]]:
        """Return what a screen reader gets: role, name and more of each part."""
        nodes: list[dict[str, Any]] = self.call("Accessibility.getFullAXTree")["nodes"]
        return [
            {"role": n["role"]["value"], "name": (n.get("name") or {}).get("value", "")}
            for n in nodes
            if not n.get("ignored") and "role" in n
        ]

    def requests(self) -> list[str]:
        """Return the addresses that the page has asked."""
        sent = self.browser.events(self.session, "Network.requestWillBeSent")
        return [event["request"]["url"] for event in sent]

    def complaints(self) -> list[str]:
        """Return what the page's console has as errors and warnings, and uncaught errors."""
        entries = self.browser.events(self.session, "Log.entryAdded")
        thrown = self.browser.events(self.session, "Runtime.exceptionThrown")
        return [
            *(e["entry"]["text"] for e in entries if e["entry"]["level"] in ("error", "warning")),
            *(e["exceptionDetails"]["exception"]["description"] for e in thrown),
        ]

    def close(self) -> None:
        """Close the page."""
        self.browser.call("Target.closeTarget", targetId=self.target)


@contextmanager
def run_browser() -> Iterator[Browser]:
    """Run a browser with a profile of its own."""
    program = find_program()
    assert program, "Chromium is not installed: ./run setup"
    with tempfile.TemporaryDirectory(prefix="rigel-chromium-", ignore_cleanup_errors=True) as home:
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        variables = {**os.environ, "HOME": home}
        process = subprocess.Popen(
            [program, *WORDS, f"--user-data-dir={home}/profile", "about:blank"],
            env=variables, start_new_session=True, **quiet,  # type: ignore[call-overload]
        )  # fmt: skip
        try:
            file = Path(home) / "profile" / "DevToolsActivePort"
            until(lambda: file.exists() and file.read_text().count("\n") >= 1, "Chromium", 60)
            port, path = file.read_text().splitlines()[:2]
            browser = Browser(f"ws://127.0.0.1:{port}{path}", process.pid)
            yield browser
            browser.call("Browser.close")
            browser.close()
            process.wait(60)
        finally:
            if process.poll() is None:
                os.killpg(process.pid, 9)
                process.wait(60)
