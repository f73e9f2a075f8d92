"""The system's Chromium without a screen, driven through its DevTools protocol."""

import base64
import io
import itertools
import json
import re
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest
from PIL import Image

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--remote-debugging-port=0",
    "--disable-background-networking",
    "--disable-component-update",
    "--no-first-run",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--hide-scrollbars",
)


class Page:
    """A page of the browser."""

    def __init__(self, socket: Any) -> None:
        self._socket, self._numbers = socket, itertools.count(1)
        self.requests: list[str] = []
        for domain in ("Page", "Runtime", "Network"):
            self.call(f"{domain}.enable")

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": params}))
        while True:
            message = json.loads(self._socket.recv(timeout=120))
            if message.get("method") == "Network.requestWillBeSent":
                self.requests.append(message["params"]["request"]["url"])
            if message.get("id") == number:
                assert "error" not in message, message
                return message["result"]

    def open(self, url: str) -> None:
        self.call("Page.navigate", url=url)
        self.wait("document.body && document.readyState == 'complete'")

    def evaluate(self, expression: str) -> Any:
        result = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        assert "exceptionDetails" not in result, result
        return result["result"].get("value")

    def wait(self, expression: str, seconds: float = 180) -> Any:
        """Until an expression is true; its value."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            if value := self.evaluate(expression):
                return value
            time.sleep(0.2)
        raise AssertionError(f"not within {seconds} s: {expression}")

    def png(self) -> bytes:
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def picture(self) -> np.ndarray:
        """The page as it looks: uint8 [H, W, 3]."""
        with Image.open(io.BytesIO(self.png())) as image:
            return np.asarray(image.convert("RGB"))

    def click(self, x: float, y: float) -> None:
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            pressed = {"button": "left", "clickCount": 1} if kind != "mouseMoved" else {}
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **pressed)
            time.sleep(0.1)

    def click_text(self, text: str, selector: str = "button") -> None:
        """Click the element that a selector finds and that reads so."""
        self.click_first(selector, f"e => e.textContent.trim() == '{text}'")

    def click_first(self, selector: str, where: str = "e => true") -> None:
        """Click the middle of the first element that a selector finds, once that stands still."""
        middle = "(r => [r.x + r.width / 2, r.y + r.height / 2])(e.getBoundingClientRect())"
        find = f"[...document.querySelectorAll('{selector}')].find({where})"
        before, place = None, [0.0, 0.0]
        while place != before:  # a menu that opens moves
            before, place = place, self.wait(f"(e => e ? {middle} : null)({find})")
            time.sleep(0.3)
        self.click(*place)


@contextmanager
def browser(size: tuple[int, int] = (1200, 800)) -> Iterator[Page]:
    """A page in a browser of its own. The test is skipped where there is none."""
    connect = pytest.importorskip(
        "websockets.sync.client", reason="needs pip install viser"
    ).connect
    program = next(filter(None, map(shutil.which, NAMES)), None)
    if program is None:
        pytest.skip("no Chromium here (Debian: apt install chromium)")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [
            program,
            *FLAGS,
            f"--user-data-dir={profile}",
            f"--window-size={size[0]},{size[1]}",
        ]
        process = subprocess.Popen([*command, "about:blank"], stderr=subprocess.PIPE, text=True)
        try:
            assert process.stderr is not None
            lines = iter(process.stderr.readline, "")
            port = next(m[1] for line in lines if (m := re.search(r"127\.0\.0\.1:(\d+)/", line)))
            yield Page(connect(_page_of(port), max_size=None))
        finally:
            process.terminate()
            process.communicate(timeout=20)


def _page_of(port: str) -> str:
    from urllib.request import urlopen

    with urlopen(f"http://127.0.0.1:{port}/json") as answer:
        targets = json.load(answer)
    return next(t["webSocketDebuggerUrl"] for t in targets if t["type"] == "page")
