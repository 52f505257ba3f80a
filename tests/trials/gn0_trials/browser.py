"""A headless Chromium, driven over its DevTools protocol: open a page, act, wait, look.

No browser-automation package is needed. Waiting is always for a condition inside the page, never
for a length of time; every wait has a limit, so a page that hangs fails by name.
"""

from __future__ import annotations

import base64
import contextlib
import inspect
import io
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from gn0.errors import ConfigError, StorageError
from gn0.geometry import U8

BINARIES = ("chromium", "chromium-browser", "google-chrome-stable", "google-chrome", "chrome")
FLAGS = (
    "--headless=new",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",  # WebGL2 without a GPU
    "--hide-scrollbars",
    "--no-first-run",
    "--disable-extensions",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--mute-audio",
    "--force-color-profile=srgb",
    "--disable-dev-shm-usage",
)
START_SECONDS = 30.0
WAIT_SECONDS = 60.0


def find_browser() -> str | None:
    """The Chromium to use: `$GN0_CHROMIUM`, else the first known name on the path, else None."""
    named = os.environ.get("GN0_CHROMIUM")
    if named:
        return shutil.which(named)
    return next(filter(None, map(shutil.which, BINARIES)), None)


class BrowserPage:
    """One page of a running browser. Made by `open_browser`.

    Attributes:
        console: texts the page wrote to its console, oldest first.
        failures: uncaught exceptions of the page and content-policy violations.
        dialogs: texts of alerts and the like; each is closed at once.
    """

    def __init__(self, socket: Any, session: str = "") -> None:
        self._socket = socket
        self._session = session
        self._number = 0
        self.console: list[str] = []
        self.failures: list[str] = []
        self.dialogs: list[str] = []

    def call(self, method: str, *, wait: float = WAIT_SECONDS, **params: Any) -> dict[str, Any]:
        """A DevTools command and its result.

        Raises:
            StorageError: the browser refuses, does not answer in `wait` [s], or is gone.
        """
        number = self._send(method, params)
        deadline = time.monotonic() + wait
        while True:
            message = self._receive(deadline, method)
            if message.get("id") == number:
                if "error" in message:
                    raise StorageError(
                        f"the browser refuses {method}: {message['error'].get('message')}",
                        remedy="see the Chrome DevTools protocol",
                    )
                return dict(message.get("result", {}))
            self._note(message)

    def _send(self, method: str, params: dict[str, Any]) -> int:
        self._number += 1
        message = {"id": self._number, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        self._socket.send(json.dumps(message))
        return self._number

    def _receive(self, deadline: float, method: str) -> dict[str, Any]:
        from websockets.exceptions import ConnectionClosed

        left = deadline - time.monotonic()
        try:
            if left <= 0:
                raise TimeoutError
            message: dict[str, Any] = json.loads(self._socket.recv(timeout=left))
        except TimeoutError:
            raise StorageError(
                f"the browser did not answer {method} in time", remedy="is the machine overloaded?"
            ) from None
        except ConnectionClosed as error:
            raise StorageError(f"the browser is gone: {error}", remedy="start it again") from None
        return message

    def _note(self, message: dict[str, Any]) -> None:
        method, params = message.get("method"), message.get("params", {})
        if method == "Runtime.consoleAPICalled":
            words = [str(a.get("value", a.get("description", ""))) for a in params["args"]]
            self.console.append(" ".join(words))
        elif method == "Runtime.exceptionThrown":
            details = params["exceptionDetails"]
            thrown = details.get("exception", {}).get("description") or details.get("text")
            self.failures.append(str(thrown))
        elif method == "Log.entryAdded":
            entry = params["entry"]
            if entry.get("source") == "security" or "Content Security" in entry.get("text", ""):
                self.failures.append(entry["text"])
        elif method == "Page.javascriptDialogOpening":
            self.dialogs.append(params["message"])
            self._send("Page.handleJavaScriptDialog", {"accept": True})

    def prepare(self, script: str) -> None:
        """Run a script in every document opened from now on, before the document's own."""
        self.call("Page.addScriptToEvaluateOnNewDocument", source=script)

    def resize(self, width: int, height: int, scale: float = 1.0) -> None:
        """Size of the page [CSS px] and device pixels per CSS pixel."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=scale,
            mobile=False,
        )

    def navigate(self, url: str) -> None:
        """Open a page; returns when the browser has committed to it.

        Raises:
            StorageError: it cannot be reached.
        """
        result = self.call("Page.navigate", url=url)
        if result.get("errorText"):
            raise StorageError(
                f"the browser cannot open it: {result['errorText']}", where=url, remedy="check it"
            )

    def evaluate(self, expression: str, *, wait: float = WAIT_SECONDS) -> Any:
        """The value of a JavaScript expression; a promise is awaited.

        Raises:
            StorageError: it throws, or takes longer than `wait` [s].
        """
        result = self.call(
            "Runtime.evaluate",
            wait=wait,
            expression=expression,
            awaitPromise=True,
            returnByValue=True,
        )
        if "exceptionDetails" in result:
            details = result["exceptionDetails"]
            thrown = details.get("exception", {}).get("description") or details.get("text")
            raise StorageError(f"the page throws: {thrown}", where=expression[:120])
        return result["result"].get("value")

    def wait_for(self, condition: str, *, wait: float = WAIT_SECONDS, what: str = "") -> Any:
        """Wait until a JavaScript expression, or its promise, is truthy; return its value.

        The page itself looks again after every 20 ms of its own time.

        Raises:
            StorageError: not within `wait` [s]; says what was waited for.
        """
        script = f"""new Promise(done => {{
            const end = performance.now() + {1000 * wait:.0f};
            const look = async () => {{
                let value = null;
                try {{ value = await ({condition}); }} catch (error) {{ value = null; }}
                if (value) done([value]);
                else if (performance.now() > end) done(null);
                else setTimeout(look, 20);
            }};
            look();
        }})"""
        found = self.evaluate(script, wait=wait + 30.0)
        if found is None:
            raise StorageError(
                f"waited {wait:g} s in vain for {what or condition[:200]}",
                remedy="look at page.screenshot(), page.console and page.failures",
            )
        return found[0]

    def screenshot(self) -> U8:
        """The page as a picture [H, W, 3]."""
        from PIL import Image

        data = self.call("Page.captureScreenshot", format="png", wait=2 * WAIT_SECONDS)["data"]
        with Image.open(io.BytesIO(base64.b64decode(data))) as picture:
            return np.asarray(picture.convert("RGB"), np.uint8)

    def press(self, key: str, code: str, *, key_code: int = 0) -> None:
        """Press a key and let it go, e.g. key "i" with code "KeyI"."""
        self.hold(key, code, key_code=key_code)
        self.release(key, code, key_code=key_code)

    def hold(self, key: str, code: str, *, key_code: int = 0) -> None:
        """Press a key and keep it down."""
        number = key_code or (ord(key.upper()) if len(key) == 1 else 0)
        self.call(
            "Input.dispatchKeyEvent",
            type="keyDown",
            key=key,
            code=code,
            windowsVirtualKeyCode=number,
            text=key if len(key) == 1 else "",
        )

    def release(self, key: str, code: str, *, key_code: int = 0) -> None:
        """Let a key go."""
        number = key_code or (ord(key.upper()) if len(key) == 1 else 0)
        self.call(
            "Input.dispatchKeyEvent",
            type="keyUp",
            key=key,
            code=code,
            windowsVirtualKeyCode=number,
        )

    def click(self, x: float, y: float) -> None:
        """Click with the left button at a place of the page [CSS px]."""
        place = {"x": x, "y": y}
        self.call("Input.dispatchMouseEvent", type="mouseMoved", **place)
        for kind in ("mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, button="left", clickCount=1, **place)


@contextmanager
def open_browser(
    *, width: int = 960, height: int = 640, binary: str = "", flags: tuple[str, ...] = ()
) -> Iterator[BrowserPage]:
    """A fresh headless Chromium with one empty page; gone, profile and all, at the end.

    Args:
        width: of the page [px].
        height: of the page [px].
        binary: the program; found by `find_browser` when empty.
        flags: further command-line flags.

    Raises:
        ConfigError: no Chromium here.
        StorageError: it does not start.
    """
    program = binary or find_browser()
    if not program:
        raise ConfigError(
            "no Chromium found", remedy="install chromium, or set GN0_CHROMIUM to its path"
        )
    with tempfile.TemporaryDirectory(prefix="gn0-browser-", ignore_cleanup_errors=True) as profile:
        command = [program, *FLAGS, *flags]
        if hasattr(os, "geteuid") and os.geteuid() == 0:
            command.append("--no-sandbox")  # Chromium's sandbox does not work for root
        command += [
            f"--user-data-dir={profile}",
            "--remote-debugging-port=0",
            f"--window-size={width},{height}",
            "about:blank",
        ]
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        try:
            with _connect(_address(Path(profile), process)) as socket:
                whole = BrowserPage(socket)
                target = whole.call("Target.createTarget", url="about:blank")["targetId"]
                session = whole.call("Target.attachToTarget", targetId=target, flatten=True)
                page = BrowserPage(socket, str(session["sessionId"]))
                for domain in ("Page", "Runtime", "Log"):
                    page.call(f"{domain}.enable")
                page.resize(width, height)
                yield page
                with contextlib.suppress(StorageError):
                    page.call("Page.navigate", url="about:blank", wait=5.0)  # drops what it drew
                    whole.call("Browser.close", wait=5.0)
        finally:
            process.terminate()
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def _address(profile: Path, process: subprocess.Popen[bytes]) -> str:
    """Where the browser listens; it writes that into its profile once it does."""
    port_file = profile / "DevToolsActivePort"
    deadline = time.monotonic() + START_SECONDS
    while time.monotonic() < deadline:
        if process.poll() is not None:
            raise StorageError(
                f"the browser ended at once with code {process.returncode}",
                remedy="run it by hand with --headless=new to see why",
            )
        try:
            lines = port_file.read_text().split()
        except OSError:
            lines = []
        if len(lines) == 2:
            return f"ws://127.0.0.1:{int(lines[0])}{lines[1]}"
        time.sleep(0.02)
    raise StorageError("the browser does not start", remedy="is the machine overloaded?")


def _connect(address: str) -> Any:
    from websockets.sync.client import connect

    more: dict[str, Any] = {"max_size": None}
    known = inspect.signature(connect).parameters
    if "proxy" in known:  # since 15; a proxy is of no use here
        more["proxy"] = None
    if "ping_interval" in known:  # a page that draws without a GPU may be silent for long; every
        more["ping_interval"] = None  # command has a limit of its own
    return connect(address, **more)
