"""A headless Chromium, driven by its DevTools protocol: real keys, clicks and pixels."""

from __future__ import annotations

import base64
import itertools
import json
import shutil
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

LIMIT_S = 30.0
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--use-angle=swiftshader"),
    *("--enable-unsafe-swiftshader", "--remote-debugging-port=0", "--window-size=1280,720", "--hide-scrollbars"),
    "about:blank",
)
KEYS = {"Enter": 13, "Tab": 9, "Escape": 27, "ArrowUp": 38}
CODES = {" ": ("Space", 32), "/": ("Slash", 191)}


def installed() -> str:
    """The program; empty if there is none."""
    return next(
        (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), ""
    )


class Page:
    """One tab."""

    def __init__(self, socket: ClientConnection) -> None:
        self._socket, self._numbers = socket, itertools.count(1)
        self.problems: list[str] = []
        self._pressed = False
        for domain in ("Page", "Runtime", "Log"):
            self._call(f"{domain}.enable")

    def open(self, url: str) -> None:
        self._call("Page.navigate", url=url)

    def ask(self, expression: str) -> Any:
        """The value of an expression in the page, awaited. Raises AssertionError for an exception there."""
        found = self._call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def wait(self, expression: str, limit_s: float = LIMIT_S) -> Any:
        """The first true value of an expression."""
        end_s = time.monotonic() + limit_s
        while time.monotonic() < end_s:
            with suppress(AssertionError):
                if value := self.ask(expression):
                    return value
            self.ask("new Promise((done) => setTimeout(done, 30))")
        raise AssertionError(f"not within {limit_s} s: {expression}; {self.problems}")

    def type(self, text: str) -> None:
        self._call("Input.insertText", text=text)

    def press(self, key: str, modifiers: int = 0) -> None:
        """A key down and up. `modifiers`: 2 Ctrl, 8 Shift."""
        code, number = (key, KEYS[key]) if key in KEYS else CODES.get(key, (f"Key{key.upper()}", ord(key.upper())))
        given: dict[str, Any] = {"key": key, "code": code, "modifiers": modifiers, "windowsVirtualKeyCode": number}
        if key == "Enter":
            given["text"] = "\r"
        self._call("Input.dispatchKeyEvent", type="keyDown" if key == "Enter" else "rawKeyDown", **given)
        self._call("Input.dispatchKeyEvent", type="keyUp", **given)

    def click(self, selector: str) -> None:
        self.drag(at := self.middle(selector), at)

    def middle(self, selector: str) -> tuple[float, float]:
        """Of an element, which is brought into view."""
        box = self.ask(f"(() => {{ const found = document.querySelector({selector!r}); "
                       "found.scrollIntoView({block: 'nearest'}); const r = found.getBoundingClientRect(); "
                       "return [r.x + r.width / 2, r.y + r.height / 2]; })()")  # fmt: skip
        return box[0], box[1]

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        self.mouse("mouseMoved", start)
        self.mouse("mousePressed", start)
        if start != end:
            self.mouse("mouseMoved", ((start[0] + end[0]) / 2, (start[1] + end[1]) / 2))
            self.mouse("mouseMoved", end)
        self.mouse("mouseReleased", end)

    def mouse(self, kind: str, at: tuple[float, float]) -> None:
        self._pressed = kind == "mousePressed" or (self._pressed and kind != "mouseReleased")
        # A drag names its button in each move, as a mouse does. Without it a capture of the pointer is lost.
        button = "left" if self._pressed or kind == "mouseReleased" else "none"
        given: dict[str, Any] = {"button": button, "buttons": int(self._pressed)}
        self._call("Input.dispatchMouseEvent", type=kind, x=at[0], y=at[1], clickCount=1, **given)

    def resize(self, width: int, height: int) -> None:
        metrics = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self._call("Emulation.setDeviceMetricsOverride", **metrics)

    def screenshot(self, selector: str = "") -> bytes:
        """A PNG of the window, or of one element."""
        clip: dict[str, Any] = {}
        if selector:
            box = self.ask(f"(() => {{ const r = document.querySelector({selector!r}).getBoundingClientRect(); "
                           "return {x: r.x, y: r.y, width: r.width, height: r.height, scale: 1}; })()")  # fmt: skip
            clip = {"clip": box}
        return base64.b64decode(self._call("Page.captureScreenshot", format="png", **clip)["data"])

    def close(self) -> None:
        with suppress(AssertionError):
            self._call("Page.close")
        self._socket.close()

    def _call(self, method: str, **parameters: Any) -> dict[str, Any]:
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=LIMIT_S))
            if answer.get("id") == number:
                assert "error" not in answer, answer["error"]
                return answer["result"]
            if answer.get("method") == "Runtime.exceptionThrown":
                self.problems.append(str(answer["params"]["exceptionDetails"]))


class Browser:
    """Pages of one browser process."""

    def __init__(self, port: int) -> None:
        self._port = port

    def page(self, url: str = "about:blank") -> Page:
        request = urllib.request.Request(f"http://127.0.0.1:{self._port}/json/new?about:blank", method="PUT")
        with urllib.request.urlopen(request, timeout=LIMIT_S) as answer:
            target = json.load(answer)["webSocketDebuggerUrl"]
        made = Page(connect(target, max_size=None, ping_interval=None).__enter__())
        made.open(url)
        return made


@contextmanager
def browser() -> Iterator[Browser]:
    """A browser with a profile of its own, which is removed."""
    profile = Path(tempfile.mkdtemp(prefix="rtc-browser-"))
    process = subprocess.Popen(
        [installed(), *FLAGS[:-1], f"--user-data-dir={profile}", FLAGS[-1]],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    try:
        yield Browser(_port_of(process, profile / "DevToolsActivePort"))
    finally:
        process.terminate()
        try:
            process.wait(LIMIT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        shutil.rmtree(profile, ignore_errors=True)


def _port_of(process: subprocess.Popen[bytes], file: Path) -> int:
    end_s = time.monotonic() + LIMIT_S
    while time.monotonic() < end_s:
        assert process.poll() is None, "the browser has ended"
        with suppress(OSError, ValueError, IndexError):
            return int(file.read_text().splitlines()[0])
        with suppress(subprocess.TimeoutExpired):
            process.wait(0.05)
    raise AssertionError("the browser does not start")
