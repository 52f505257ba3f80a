"""DAgger with agents on a device: the files of one at a time; on the host emulation of a GPU."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest

from gn0.cli.main import main
from gn0.data.collect import build_dagger
from gn0.data.dataset import open_dataset
from gn0.data.settings import BuildSettings, DaggerSettings, PictureSettings
from gn0.errors import DataError
from gn0.suites.suite import Suite

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")
FilesOf = Callable[[Path], dict[str, bytes]]


def settings_of(policy: str, pictures: PictureSettings | None = None, **more: object):  # type: ignore[no-untyped-def]
    drive: dict[str, object] = {"policy": policy, "beta": 0.3, "max_steps": 40, **more}
    pictures = pictures or PictureSettings(layout="none")
    return BuildSettings(chunk=3, pictures=pictures, dagger=DaggerSettings(**drive))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "policy", ["random", "wall_follower", pytest.param("explorer", marks=pytest.mark.slow)]
)
def test_agents_on_a_device_write_the_bytes_of_one(
    data_suite: Suite, tmp_path: Path, policy: str, begun: list[str], files_of: FilesOf
) -> None:
    """Two parts, so two groups; of fewer agents than episodes, and of more."""
    build_dagger(data_suite, tmp_path / "1", settings_of(policy))
    assert not begun
    for agents in (2, 7):
        build_dagger(data_suite, tmp_path / str(agents), settings_of(policy), agents=agents)
        assert files_of(tmp_path / str(agents)) == files_of(tmp_path / "1")
    assert set(begun) == {episode.id for episode in data_suite.episodes}


_CHILD = """
import sys
from gn0.suites.suite import load_suite
from gn0.data.collect import build_dagger
from gn0.data.settings import BuildSettings, DaggerSettings, PictureSettings
settings = BuildSettings(chunk=3, pictures=PictureSettings(layout="none"), dagger=DaggerSettings(
    policy="wall_follower", max_steps=40, beta=0.3))
build_dagger(load_suite(sys.argv[1]), sys.argv[2], settings, agents=7)
"""


def test_a_collection_that_is_killed_goes_on_to_the_same_bytes(
    data_suite: Suite, tmp_path: Path, begun: list[str], files_of: FilesOf
) -> None:
    out, settings = tmp_path / "broken", settings_of("wall_follower")
    process = subprocess.Popen([sys.executable, "-c", _CHILD, str(data_suite.folder), str(out)])
    until = time.monotonic() + 120
    while process.poll() is None and time.monotonic() < until:
        journal = out / "journal.jsonl"
        if journal.exists() and journal.stat().st_size:
            os.kill(process.pid, signal.SIGKILL)
            break
        time.sleep(0.001)
    process.wait()
    build_dagger(data_suite, out, settings, agents=2)
    build_dagger(data_suite, tmp_path / "1", settings)
    assert files_of(out) == files_of(tmp_path / "1")


def test_a_policy_that_sees_stays_with_the_renderer_of_the_dataset(
    data_suite: Suite, tmp_path: Path, begun: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """A dataset whose pictures the CPU draws is not gone on with by a card's."""
    bench = Path(__file__).parents[1] / "bench" / "plugin" / "seeing_policies.py"
    suite = shutil.copytree(data_suite.folder, tmp_path / "suite")
    command = ["data", "dagger", str(suite), "--policy", "seeing", "--plugin", str(bench)]
    command += ["--max-steps", "1", "--agents", "2", "--out", str(tmp_path / "out")]
    assert main(command) == 0 and not begun
    assert open_dataset(tmp_path / "out").about.settings.pictures.drawn_by == "cpu"
    assert main([*command, "--backend", "cuda"]) == 2
    assert "another dataset: settings.pictures.backend" in capsys.readouterr().err
    with pytest.raises(DataError, match="another dataset"):
        other = PictureSettings(layout="none", backend="cuda")
        about = open_dataset(tmp_path / "out").about.settings
        build_dagger(data_suite, tmp_path / "out", msgspec.structs.replace(about, pictures=other))


@pytest.mark.slow
def test_agents_that_see_go_the_way_of_one(
    data_suite: Suite,
    tmp_path: Path,
    begun: list[str],
    files_of: FilesOf,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.syspath_prepend(str(Path(__file__).parents[1] / "bench" / "plugin"))
    import seeing_policies  # noqa: F401  (knows the camera)

    about = msgspec.structs.replace(data_suite.about, camera="small")
    suite = Suite(data_suite.folder, about, data_suite.episodes)
    drawn = PictureSettings(layout="none", backend="cuda")
    settings = settings_of("seeing", drawn, plugins=("seeing_policies",), max_steps=5)
    build_dagger(suite, tmp_path / "1", settings)
    assert not begun
    build_dagger(suite, tmp_path / "7", settings, agents=7)
    assert set(begun) == {episode.id for episode in suite.episodes}
    assert files_of(tmp_path / "7") == files_of(tmp_path / "1")
