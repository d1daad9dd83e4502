"""A headless Chromium for tests, driven over a pipe by the DevTools protocol with the standard library alone.

Debian: apt-get install chromium. Without it the tests are skipped with a reason; with CI=true that is a failure.
"""

import base64
import fcntl
import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import cv2
import numpy as np
import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader", "--no-first-run", "--disable-extensions", "--disable-background-networking",
    "--disable-component-update", "--hide-scrollbars", "--remote-debugging-pipe",
)  # fmt: skip
PATIENCE_S = 60


def find_chromium() -> str:
    """Return the browser of this machine; skip the test, or fail where everything must be tested, without one."""
    found = next(filter(None, map(shutil.which, NAMES)), None)
    if found is None:
        missing = f"no browser: none of {', '.join(NAMES)} is installed (apt-get install chromium)"
        if os.environ.get("CI") == "true":
            pytest.fail(missing)
        pytest.skip(missing)
    return found


@contextmanager
def running(size: tuple[int, int]) -> Iterator["Chromium"]:
    """Yield a browser with one empty page of a size (width, height), and end it."""
    with tempfile.TemporaryDirectory(prefix="chromium-", ignore_cleanup_errors=True) as folder:
        process, commands, answers = _start([find_chromium(), *FLAGS, f"--user-data-dir={folder}", "about:blank"])
        try:
            yield Chromium(commands, answers, size)
        finally:
            process.kill()
            process.wait(PATIENCE_S)
            commands.close()
            answers.close()


def _start(command: list[str]) -> tuple[subprocess.Popen[bytes], BinaryIO, BinaryIO]:
    """Return a running browser, which reads commands from its descriptor 3 and writes answers to 4."""
    (its_input, commands), (answers, its_output) = os.pipe(), os.pipe()
    # Out of the way of 3 and 4 themselves, which the pipes may have been given.
    theirs = [fcntl.fcntl(descriptor, fcntl.F_DUPFD_CLOEXEC, 10) for descriptor in (its_input, its_output)]

    def connect() -> None:
        for descriptor, number in zip(theirs, (3, 4), strict=True):
            os.dup2(descriptor, number)

    nowhere = subprocess.DEVNULL
    process = subprocess.Popen(
        command,
        preexec_fn=connect,  # noqa: PLW1509 - it calls dup2 and nothing else
        # Not pass_fds=(3, 4): it fails where these were files of fonts, which matplotlib closes in a forked process.
        close_fds=False,
        stdout=nowhere,
        stderr=nowhere,
    )
    for descriptor in (*theirs, its_input, its_output):
        os.close(descriptor)
    return process, os.fdopen(commands, "wb", buffering=0), os.fdopen(answers, "rb", buffering=0)


class Chromium:
    """The page of a running browser. complaints: what it said in its console, failed at, or asked the network for."""

    def __init__(self, commands: BinaryIO, answers: BinaryIO, size: tuple[int, int]) -> None:
        self.commands, self.answers = commands, answers
        self.waiting = b""
        self.number = 0
        self.complaints: list[str] = []
        self.loaded = False
        self.session: str | None = None
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.call(f"{domain}.enable")
        self.resize(*size)

    def resize(self, width: int, height: int) -> None:
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)

    def open(self, path: Path) -> None:
        """Open a file and wait until it is loaded; what an earlier page complained of is forgotten."""
        self.loaded = False
        self.complaints.clear()
        self.call("Page.navigate", url=path.resolve().as_uri())
        while not self.loaded:
            self._listen()

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Return the answer to a command of the protocol."""
        self.number += 1
        message = {"id": self.number, "method": method, "params": parameters}
        if self.session is not None:
            message["sessionId"] = self.session
        self.commands.write(json.dumps(message).encode() + b"\0")
        while True:
            answer = self._listen()
            if answer.get("id") == self.number:
                assert "error" not in answer, answer["error"]
                return answer["result"]

    def evaluate(self, expression: str) -> Any:
        """Return the value of a JavaScript expression; a promise is waited for."""
        answer = self.call("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait_until_drawn(self) -> None:
        """Wait until what was asked for has been drawn."""
        self.evaluate("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done())))")

    def screenshot(self) -> np.ndarray:
        """Return what is to be seen, (H, W, 3), red, green, blue."""
        self.wait_until_drawn()
        content = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)[:, :, ::-1]

    def mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        held = {"mousePressed": 1, "mouseMoved": more.pop("held", 0), "mouseReleased": 0, "mouseWheel": 0}[kind]
        button = "none" if kind in {"mouseMoved", "mouseWheel"} and not held else "left"
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button=button, buttons=held, **more)

    def click(self, x: float, y: float) -> None:
        self.mouse("mousePressed", x, y, clickCount=1)
        self.mouse("mouseReleased", x, y, clickCount=1)

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        self.mouse("mousePressed", *start, clickCount=1)
        for share in (0.25, 0.5, 0.75, 1.0):
            x, y = (a + share * (b - a) for a, b in zip(start, end, strict=True))
            self.mouse("mouseMoved", x, y, held=1)
        self.mouse("mouseReleased", *end, clickCount=1)

    def key(self, name: str) -> None:
        for kind in ("keyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, key=name, text=name if len(name) == 1 else "")

    def _listen(self) -> dict[str, Any]:
        """Return the next message; complaints of the page and its requests over the network are kept."""
        while b"\0" not in self.waiting:
            content = self.answers.read(1 << 16)
            assert content, "the browser has gone"
            self.waiting += content
        first, self.waiting = self.waiting.split(b"\0", 1)
        message = json.loads(first)
        method, said = message.get("method", ""), message.get("params", {})
        if method == "Page.loadEventFired":
            self.loaded = True
        elif method == "Runtime.exceptionThrown":
            self.complaints.append(said["exceptionDetails"]["text"])
        elif method == "Runtime.consoleAPICalled" and said["type"] in {"error", "warning", "assert"}:
            self.complaints.append(f"console.{said['type']}: {said['args']}")
        elif method == "Log.entryAdded" and said["entry"]["level"] in {"error", "warning"}:
            self.complaints.append(said["entry"]["text"])
        elif method == "Network.requestWillBeSent" and not said["request"]["url"].startswith(("file:", "data:")):
            self.complaints.append(f"asks for {said['request']['url']}")
        return message
