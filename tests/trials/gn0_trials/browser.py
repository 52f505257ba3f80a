"""A headless Chromium of this machine, driven by Playwright: open a page, act, wait, look.

Playwright downloads nothing here: it drives the browser on the path. Waiting is always for a
condition inside the page, never for a length of time; every wait has a limit, so a page that hangs
fails by name.
"""

from __future__ import annotations

import io
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

import numpy as np

from gn0.errors import ConfigError, StorageError
from gn0.geometry import U8

if TYPE_CHECKING:
    from playwright.sync_api import ConsoleMessage, Dialog, Page

BINARIES = ("chromium", "chromium-browser", "google-chrome-stable", "google-chrome", "chrome")
FLAGS = (
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",  # WebGL2 without a GPU
    "--force-color-profile=srgb",
)
WAIT_SECONDS = 60.0


def find_browser() -> str | None:
    """The Chromium to use: `$GN0_CHROMIUM`, else the first known name on the path, else None."""
    named = os.environ.get("GN0_CHROMIUM")
    if named:
        return shutil.which(named)
    return next(filter(None, map(shutil.which, BINARIES)), None)


def why_no_browser() -> str:
    """What is missing to drive a browser here; "" where nothing is."""
    if find_spec("playwright") is None:
        return "Playwright is not installed: pip install -e '.[dev]'"
    if find_browser() is None:
        return "no Chromium on this machine: install chromium, or set GN0_CHROMIUM to its path"
    return ""


class BrowserPage:
    """One page of a running browser. Made by `open_browser`.

    Attributes:
        console: texts the page wrote to its console, oldest first.
        failures: uncaught exceptions of the page and content-policy violations.
        dialogs: texts of alerts and the like; each is closed at once.
    """

    def __init__(self, page: Page) -> None:
        self._page = page
        self.console: list[str] = []
        self.failures: list[str] = []
        self.dialogs: list[str] = []
        page.set_default_timeout(1e3 * WAIT_SECONDS)
        page.on("console", self._hear)
        page.on("pageerror", lambda error: self.failures.append(str(error)))
        page.on("dialog", self._close)

    def _hear(self, message: ConsoleMessage) -> None:
        if message.type == "error" and "Content Security" in message.text:
            self.failures.append(message.text)
        self.console.append(message.text)

    def _close(self, dialog: Dialog) -> None:
        self.dialogs.append(dialog.message)
        dialog.accept()

    def prepare(self, script: str) -> None:
        """Run a script in every document opened from now on, before the document's own."""
        self._page.add_init_script(script)

    def navigate(self, url: str) -> None:
        """Open a page; returns when the browser has committed to it.

        Raises:
            StorageError: it cannot be reached.
        """
        from playwright.sync_api import Error

        try:
            self._page.goto(url, wait_until="commit")
        except Error as error:
            raise StorageError(
                f"the browser cannot open it: {error.message}", where=url, remedy="check it"
            ) from None

    def evaluate(self, expression: str) -> Any:
        """The value of a JavaScript expression; a promise is awaited.

        Raises:
            StorageError: it throws.
        """
        from playwright.sync_api import Error

        try:
            return self._page.evaluate(expression)
        except Error as error:
            raise StorageError(
                f"the page throws: {error.message}", where=expression[:120]
            ) from None

    def wait_for(self, condition: str, *, wait: float = WAIT_SECONDS, what: str = "") -> Any:
        """Wait until a JavaScript expression, or its promise, is truthy; return its value.

        The page itself looks again after every 20 ms of its own time.

        Raises:
            StorageError: not within `wait` [s]; says what was waited for.
        """
        from playwright.sync_api import TimeoutError as WaitedInVainError

        look = f"""seen => {{
            const ask = async () => {{
                seen.busy = true;
                try {{
                    const value = await ({condition});
                    if (value) seen.found = [value];
                }} catch (error) {{ }}
                seen.busy = false;
            }};
            if (!seen.found && !seen.busy) ask();
            return seen.found;
        }}"""
        seen = self._page.evaluate_handle("({})")  # a promise is asked once at a time
        try:
            found = self._page.wait_for_function(look, arg=seen, timeout=1e3 * wait, polling=20)
        except WaitedInVainError:
            raise StorageError(
                f"waited {wait:g} s in vain for {what or condition[:200]}",
                remedy="look at page.screenshot(), page.console and page.failures",
            ) from None
        return found.json_value()[0]

    def screenshot(self) -> U8:
        """The page as a picture [H, W, 3]."""
        from PIL import Image

        data = self._page.screenshot(timeout=2e3 * WAIT_SECONDS)
        with Image.open(io.BytesIO(data)) as picture:
            return np.asarray(picture.convert("RGB"), np.uint8)

    def press(self, code: str) -> None:
        """Press a key and let it go, e.g. "KeyI", "Space" or "ArrowRight"."""
        self._page.keyboard.press(code)

    def hold(self, code: str) -> None:
        """Press a key and keep it down."""
        self._page.keyboard.down(code)

    def release(self, code: str) -> None:
        """Let a key go."""
        self._page.keyboard.up(code)

    def click(self, x: float, y: float) -> None:
        """Click with the left button at a place of the page [CSS px]."""
        self._page.mouse.click(x, y)


@contextmanager
def open_browser(
    *, width: int = 960, height: int = 640, flags: tuple[str, ...] = ()
) -> Iterator[BrowserPage]:
    """A fresh headless Chromium with one empty page; gone, profile and all, at the end.

    Args:
        width: of the page [px].
        height: of the page [px].
        flags: further command-line flags.

    Raises:
        ConfigError: no Playwright or no Chromium here.
    """
    if missing := why_no_browser():
        what, _, remedy = missing.partition(": ")
        raise ConfigError(what, remedy=remedy)
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        # Chromium's own sandbox does not work for root; Playwright leaves it off unless asked
        browser = playwright.chromium.launch(executable_path=find_browser(), args=[*FLAGS, *flags])
        try:
            yield BrowserPage(browser.new_page(viewport={"width": width, "height": height}))
        finally:
            browser.close()
