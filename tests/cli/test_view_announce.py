"""What `gn0 view` says when its page is up."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from gn0.cli.view import Args, announce


@pytest.mark.parametrize(("asked", "got"), [(8080, 8080), (8080, 8081), (0, 8123)])
def test_a_port_that_was_taken_is_said_and_only_then(
    asked: int, got: int, capsys: pytest.CaptureFixture[str]
) -> None:
    live = SimpleNamespace(port=got, url=f"http://127.0.0.1:{got}")
    announce(Args(paths=("x",), port=asked, check=True), live)  # type: ignore[arg-type]
    said = capsys.readouterr().out
    assert ("is taken" in said) is (asked != 0 and asked != got)
    assert f"open {live.url}" in said and "Ctrl-C" not in said
