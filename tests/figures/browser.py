"""Chromium without a screen, led through a pipe (Chrome DevTools Protocol): no driver, no network."""

import base64
import fcntl
import json
import os
import shutil
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any, Self

import pytest
from PIL import Image

PIXELS = 0.5
"""Of the screen per pixel of the page along both sides: the processor draws each of them."""

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")


def find_browser() -> str:
    """Path of the browser; the test is skipped where there is none."""
    found = next((path for name in NAMES if (path := shutil.which(name))), None)
    if found is None:
        pytest.skip(f"no browser: none of {', '.join(NAMES)} is installed")
    return found


class Browser:
    """A page in a browser; what it logs and what goes wrong in it is kept in `errors`."""

    def __init__(self, profile: Path, size: tuple[int, int] = (900, 600)) -> None:
        to_browser, from_us = os.pipe()
        from_browser, to_us = os.pipe()

        def at_three_and_four() -> None:
            # the pipes may be numbers 3 and 4 themselves, and not to be inherited
            ends = [fcntl.fcntl(end, fcntl.F_DUPFD, 10) for end in (to_browser, to_us)]
            os.dup2(ends[0], 3)
            os.dup2(ends[1], 4)

        self._process = subprocess.Popen(
            [
                find_browser(), "--headless=new", "--no-sandbox", "--remote-debugging-pipe", "--use-gl=angle",
                "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-first-run",
                "--disable-background-networking", "--hide-scrollbars", f"--user-data-dir={profile}",
                f"--window-size={size[0]},{size[1]}", "about:blank",
            ],
            preexec_fn=at_three_and_four, close_fds=False,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        os.close(to_browser)
        os.close(to_us)
        self._out, self._in = os.fdopen(from_us, "wb", 0), os.fdopen(from_browser, "rb", 0)
        self._number, self._session, self._rest = 0, None, b""
        self.errors: list[str] = []
        (page,) = [t for t in self.call("Target.getTargets")["targetInfos"] if t["type"] == "page"]
        self._session = self.call("Target.attachToTarget", targetId=page["targetId"], flatten=True)[
            "sessionId"
        ]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.requests: list[str] = []
        self.size = size
        self.set_pixels(PIXELS)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.wait()
        self._out.close()
        self._in.close()

    def _message(self) -> dict[str, Any]:
        while b"\0" not in self._rest:
            part = self._in.read(1 << 16)
            assert part, "the browser has ended"
            self._rest += part
        text, self._rest = self._rest.split(b"\0", 1)
        return json.loads(text)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Result of a command; events before it are kept."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        self._out.write(
            json.dumps(message | ({"sessionId": self._session} if self._session else {})).encode() + b"\0"
        )
        while True:
            found = self._message()
            if found.get("id") == self._number:
                assert "error" not in found, found
                return found["result"]
            match found.get("method"):
                case "Runtime.exceptionThrown":
                    details = found["params"]["exceptionDetails"]
                    self.errors.append(str(details.get("exception", details).get("description", details)))
                case "Runtime.consoleAPICalled":
                    self.errors.append(str([each.get("value") for each in found["params"]["args"]]))
                case "Log.entryAdded":
                    self.errors.append(found["params"]["entry"]["text"])
                case "Network.requestWillBeSent":
                    self.requests.append(found["params"]["request"]["url"])

    def run(self, script: str) -> Any:
        """Value of an expression in the page."""
        found = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def wait(self, condition: str, seconds: float = 60.0) -> None:
        """Until an expression is true."""
        stop = time.monotonic() + seconds
        while not self.run(condition):
            assert time.monotonic() < stop, f"not within {seconds} s: {condition}; {self.errors}"
            time.sleep(0.1)

    def set_pixels(self, each: float) -> None:
        """Pixels of the screen per pixel of the page, until the next page."""
        width, height = self.size
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=each,
            mobile=False,
        )

    @contextmanager
    def empty_page(self) -> Iterator[Self]:
        """The browser without page and errors; to start one takes three seconds of a processor."""
        self.set_pixels(PIXELS)
        self.call("Page.navigate", url="about:blank")
        self.wait("location.href === 'about:blank'")
        self.errors.clear()
        self.requests.clear()
        yield self

    def open(self, path: Path, tail: str = "") -> None:
        """Load a page from disk."""
        self.call("Page.navigate", url=path.as_uri() + tail)

    def click(self, x: float, y: float, count: int = 1) -> None:
        """Press and release the left button."""
        for kind in ("mousePressed", "mouseReleased"):
            self.call(
                "Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=count
            )

    def screenshot(self, path: Path) -> None:
        """Save what the page shows, at the size of the page."""
        data = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        with Image.open(BytesIO(data)) as shown:
            size = [round(side / PIXELS) for side in shown.size]
            shown.resize(size, Image.Resampling.NEAREST).save(path)
