"""A page in headless Chromium that stays open: what it says, pictures of it, a hand on its mouse.

It speaks the DevTools protocol, https://chromedevtools.github.io/devtools-protocol.
"""

from __future__ import annotations

import base64
import io
import json
import subprocess
import time
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from websockets.sync.client import connect

from mbocp.view.movie import browser_command

WAIT = 60.0  # [s]


class OpenPage:
    """A page; use it in a `with` block."""

    def __init__(self, address: str, profile: Path, size: tuple[int, int]) -> None:
        command = browser_command(profile, "--remote-debugging-port=0", "about:blank", size=size)
        self._browser = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        self._number, self._events = 0, []
        try:
            self._socket = connect(_socket_of_first_page(profile), max_size=None)
            for domain in ("Runtime", "Log", "Page"):
                self.call(f"{domain}.enable")
            self.resize(size)
            self.call("Page.navigate", url=address)
        except BaseException:
            self._end()
            raise

    def __enter__(self) -> OpenPage:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()
        self._end()

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Result of a command of the protocol; events that come meanwhile are kept."""
        self._number += 1
        self._socket.send(json.dumps({"id": self._number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=WAIT))
            if message.get("id") == self._number:
                assert "error" not in message, message
                return message["result"]
            self._events.append(message)

    def resize(self, size: tuple[int, int]) -> None:
        """Give the window a width and a height [pixel]."""
        width, height = size
        shape = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.call("Emulation.setDeviceMetricsOverride", **shape)

    def value(self, expression: str) -> Any:
        """Of a JavaScript expression."""
        return self.call("Runtime.evaluate", expression=expression, returnByValue=True)["result"].get("value")

    def picture(self) -> np.ndarray:
        """What is seen now, shape (height, width, 3)."""
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(io.BytesIO(data)).convert("RGB"), dtype=float)

    def drag(self, start: np.ndarray, end: np.ndarray, *, steps: int = 10) -> None:
        """Press the left button at a pixel, move in steps to another, let go."""
        self._mouse("mouseMoved", start)
        time.sleep(0.3)  # the page finds out what is below the pointer frame by frame
        self._mouse("mousePressed", start, button="left", clickCount=1)
        for k in range(1, steps + 1):
            self._mouse("mouseMoved", start + (end - start) * k / steps, button="left", buttons=1)
            time.sleep(0.05)
        self._mouse("mouseReleased", end, button="left", clickCount=1)

    def errors(self) -> list[str]:
        """Errors on the page's console, and exceptions of its scripts."""
        self.value("0")  # all before it has come by then
        return [said for event in self._events if (said := _error_in(event))]

    def _mouse(self, kind: str, at: np.ndarray, **more: Any) -> None:
        self.call("Input.dispatchMouseEvent", type=kind, x=float(at[0]), y=float(at[1]), **more)

    def _end(self) -> None:
        self._browser.terminate()
        self._browser.wait(WAIT)


def _socket_of_first_page(profile: Path) -> str:
    """Address of the protocol for the page that the browser begins with."""
    from urllib.request import urlopen

    file, end = profile / "DevToolsActivePort", time.monotonic() + WAIT
    while not (file.exists() and file.read_text().count("\n")):
        assert time.monotonic() < end, "the browser did not start"
        time.sleep(0.05)
    port = int(file.read_text().splitlines()[0])
    with urlopen(f"http://127.0.0.1:{port}/json") as answer:
        return next(page["webSocketDebuggerUrl"] for page in json.load(answer) if page["type"] == "page")


def _error_in(event: dict[str, Any]) -> str:
    kind, told = event["method"], event["params"]
    if kind == "Runtime.exceptionThrown":
        return json.dumps(told["exceptionDetails"])
    if kind == "Runtime.consoleAPICalled" and told["type"] in ("error", "assert"):
        return json.dumps(told["args"])
    if kind == "Log.entryAdded" and told["entry"]["level"] == "error":
        return json.dumps(told["entry"])
    return ""
