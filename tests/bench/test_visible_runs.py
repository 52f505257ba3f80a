"""Runs with visible sets: only when asked for, and then named wherever a run is named."""

from __future__ import annotations

import pytest

from gn0.bench.runner import run_suite
from gn0.cli.bench_run import Args
from gn0.errors import BenchError
from gn0.render.renderer import VISIBLE

pytestmark = pytest.mark.usefixtures("workers_here")


def test_scored_runs_use_all_splats_unless_told(flats_suite, tmp_path, monkeypatch) -> None:
    monkeypatch.setenv("GN0_CACHE", str(tmp_path / "cache"))
    out = tmp_path / "run"
    plain = run_suite(flats_suite, "random", out, max_episodes=1)
    assert "pictures" not in dict(plain.protocol)
    assert not Args(suite="s", out="o").visible_sets
    with pytest.raises(BenchError, match="another config"):
        run_suite(flats_suite, "random", out, max_episodes=1, backend=VISIBLE)


@pytest.mark.slow
def test_a_run_with_visible_sets_says_so(flats_suite, tmp_path, monkeypatch) -> None:
    """In its protocol card; its pictures really come from sets, found on the way and kept."""
    monkeypatch.setenv("GN0_CACHE", str(tmp_path / "cache"))
    module = tmp_path / "peeking_plugin.py"
    module.write_text(
        "from gn0.plugins import register\n"
        "from gn0.sim.state import Action\n"
        "class PolicyPeeking:\n"
        "    name, sensors = 'peeking', frozenset({'depth'})\n"
        "    def reset(self, instruction, rng): self.left = 2\n"
        "    def act(self, seen):\n"
        "        assert seen.depth is not None\n"
        "        self.left -= 1\n"
        "        return Action.LEFT if self.left >= 0 else Action.STOP\n"
        "register('policy', 'peeking', PolicyPeeking)\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    run = run_suite(
        flats_suite, "peeking", tmp_path / "run", max_episodes=1,
        backend=VISIBLE, plugin_modules=("peeking_plugin",),
    )  # fmt: skip
    assert not run.failed
    assert "visible sets" in dict(run.protocol)["pictures"]
    assert list((tmp_path / "cache" / "visible").rglob("*.set"))
