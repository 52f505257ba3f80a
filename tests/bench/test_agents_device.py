"""Agents of a run on a device: the files of one at a time; on the host emulation of a GPU."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from gn0.bench import runner
from gn0.bench.runner import run_suite
from gn0.suites.scene_drawing import find_agents_card
from gn0.suites.suite import Suite, load_suite

pytestmark = [
    pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++"),
    pytest.mark.usefixtures("workers_here"),
]
SAME = ("results.jsonl", "trajectories.jsonl", "summary.json")


def outputs(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in SAME}


@pytest.fixture(autouse=True)
def still_code() -> Iterator[None]:
    """Pretend that nobody edits the package while these tests stop and resume runs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "code_version", lambda: "1.0+still")
        yield


@pytest.mark.parametrize(
    "policy", ["random", "wall_follower", pytest.param("explorer", marks=pytest.mark.slow)]
)
def test_agents_on_a_device_give_the_bytes_of_one(
    flats_suite: Suite, tmp_path: Path, policy: str, begun: list[str]
) -> None:
    """Two groups, one a flat, of fewer agents than episodes."""
    few = {"max_episodes": 7} if policy == "explorer" else {}
    run_suite(flats_suite, policy, tmp_path / "1", agents=1, **few)
    assert not begun
    for agents in (4,) if policy == "explorer" else (2, 7):
        run_suite(flats_suite, policy, tmp_path / str(agents), agents=agents, **few)
        assert outputs(tmp_path / str(agents)) == outputs(tmp_path / "1")
    assert set(begun) == {e.id for e in flats_suite.episodes[: few.get("max_episodes")]}
    about = json.loads((tmp_path / "4" if few else tmp_path / "7").joinpath("run.json").read_text())
    assert about["sessions"][0]["card"] == "host emulation"
    assert "on_device" not in about["settings"]


def test_a_run_goes_on_from_the_device_to_the_cpu_and_back(
    flats_suite: Suite, tmp_path: Path, begun: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    run_suite(flats_suite, "wall_follower", tmp_path / "whole")

    class CutError(Exception):
        pass

    def stop_at(number: int):  # type: ignore[no-untyped-def]
        def stop(stage: str, done: int, total: int) -> None:
            if stage == "episodes" and done == number:
                raise CutError

        return stop

    cut = tmp_path / "cut"
    with pytest.raises(CutError):
        run_suite(flats_suite, "wall_follower", cut, agents=5, progress=stop_at(3))
    assert begun
    monkeypatch.setenv("GN0_DEVICE", "none")
    with pytest.raises(CutError):
        run_suite(flats_suite, "wall_follower", cut, agents=3, progress=stop_at(6))
    monkeypatch.setenv("GN0_DEVICE", "host")
    begun.clear()
    run_suite(flats_suite, "wall_follower", cut, agents=7)
    assert begun and outputs(cut) == outputs(tmp_path / "whole")


def test_an_episode_that_cannot_begin_is_invalid_as_ever(
    flats_suite: Suite, tmp_path: Path, begun: list[str]
) -> None:
    lost = msgspec.structs.replace(flats_suite.episodes[0], start=(-90.0, 0.0, 0.0))
    suite = Suite(flats_suite.folder, flats_suite.about, (lost, *flats_suite.episodes[1:6]))
    run_suite(suite, "random", tmp_path / "1")
    run_suite(suite, "random", tmp_path / "4", agents=4)
    assert outputs(tmp_path / "4") == outputs(tmp_path / "1")
    assert len(begun) == 5 and b'"status":"invalid"' in outputs(tmp_path / "1")["results.jsonl"]


def test_what_no_device_keeps_stays_on_the_cpu_and_it_is_said(
    flats_suite: Suite, tmp_path: Path, begun: list[str]
) -> None:
    told: list[str] = []
    few = {"max_episodes": 2, "tell": told.append}
    run_suite(flats_suite, "oracle", tmp_path / "oracle", agents=4, **few)  # type: ignore[arg-type]
    assert not begun and any("run one at a time" in line for line in told)


def test_where_agents_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """On the card that draws; those that see nothing only where somebody names a card."""

    def find(asked: str, backend: str, **more: object) -> str | None:
        chosen = {"agents": 4, "workers": 1, "executor": "process"} | more
        return find_agents_card(asked, backend, **chosen)  # type: ignore[arg-type]

    monkeypatch.setenv("GN0_DEVICE", "host")
    assert find("auto", "cuda") == find("auto", "auto") == "host emulation"
    assert find("cuda", "cuda-visible") == find("cuda", "auto") == "host emulation"
    assert find("auto", "cuda", workers=2, executor="ray") == "host emulation"
    assert find("cpu", "cpu") is find("cpu", "auto") is None
    assert find("auto", "cuda", agents=1) is find("auto", "cuda", workers=2) is None
    monkeypatch.setenv("GN0_DEVICE", "none")
    assert find("auto", "auto") is find("cuda", "auto") is None
    monkeypatch.delenv("GN0_DEVICE")
    assert find("auto", "auto") is None


@pytest.fixture(scope="module")
def small_suite(flats_suite: Suite, tmp_path_factory: pytest.TempPathFactory) -> Suite:
    """The flats seen through a camera of 48x36."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(Path(__file__).parent / "plugin"))
        import seeing_policies  # noqa: F401  (knows the camera)

        folder = tmp_path_factory.mktemp("small") / "suite"
        shutil.copytree(flats_suite.folder, folder)
        suite = load_suite(folder)
        return Suite(
            suite.folder, msgspec.structs.replace(suite.about, camera="small"), suite.episodes
        )


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Unix sockets")
def test_agents_that_see_go_the_way_of_one(
    small_suite: Suite, tmp_path: Path, begun: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Pictures of the CUDA renderer: drawn by the drawing process for one, beside many agents."""
    monkeypatch.syspath_prepend(str(Path(__file__).parent / "plugin"))
    settings = {"plugin_modules": ("seeing_policies",), "max_episodes": 7}
    run_suite(small_suite, "seeing", tmp_path / "1", **settings)  # type: ignore[arg-type]
    assert not begun
    run_suite(small_suite, "seeing", tmp_path / "7", agents=7, **settings)  # type: ignore[arg-type]
    assert len(begun) == 7 and outputs(tmp_path / "7") == outputs(tmp_path / "1")
    about = json.loads((tmp_path / "7" / "run.json").read_text())
    assert about["settings"]["backend"] == "cuda"
    assert about["sessions"][0]["card"] == "host emulation"
