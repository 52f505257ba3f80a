"""The driver of a browser: it acts, waits for conditions, and says what went wrong."""

from __future__ import annotations

import pytest

from gn0.errors import ConfigError, StorageError
from gn0_trials import browser
from gn0_trials.browser import find_browser, open_browser, why_no_browser

PAGE = """data:text/html,<title>t</title><button onclick="this.textContent='pressed'">b</button>
<script>console.log('hello', 3); alert('stop'); setTimeout(() => { throw new Error('oops') });
document.addEventListener('keydown', event => { window.key = event.code });</script>"""


@pytest.mark.browser
@pytest.mark.skipif(bool(why_no_browser()), reason=why_no_browser())
def test_a_page_is_driven():
    with open_browser(width=320, height=200) as page:
        page.prepare("window.early = 1")
        page.navigate(PAGE.replace("\n", ""))
        page.wait_for("window.early && document.querySelector('button')")
        x, y = page.evaluate(
            "(b => [b.x + b.width / 2, b.y + b.height / 2])"
            "(document.querySelector('button').getBoundingClientRect())"
        )
        page.click(x, y)
        assert page.wait_for("document.querySelector('button').textContent === 'pressed'") is True
        page.press("KeyI")
        assert page.wait_for("Promise.resolve(window.key)") == "KeyI"
        assert page.screenshot().shape == (200, 320, 3)
        assert "hello 3" in page.console
        assert page.dialogs == ["stop"]
        assert any("oops" in text for text in page.failures)
        with pytest.raises(StorageError, match="in vain for the moon"):
            page.wait_for("false", wait=0.1, what="the moon")
        with pytest.raises(StorageError, match="throws"):
            page.evaluate("nowhere.to.be.found")
        with pytest.raises(StorageError, match="cannot open"):
            page.navigate("http://127.0.0.1:9/")


def test_without_a_browser_the_error_says_what_to_do(monkeypatch):
    monkeypatch.setenv("GN0_CHROMIUM", "/no/such/browser")
    monkeypatch.setattr(browser, "find_spec", lambda name: name)  # as if Playwright were here
    assert find_browser() is None
    with pytest.raises(ConfigError, match="no Chromium") as caught, open_browser():
        pass
    assert "GN0_CHROMIUM" in caught.value.remedy
    monkeypatch.setattr(browser, "find_spec", lambda name: None)
    with pytest.raises(ConfigError, match="Playwright") as caught, open_browser():
        pass
    assert "pip install" in caught.value.remedy
