"""What a user reads is kept as text: errors of every code, `--help` of every verb, prompts.

A changed text is seen in review as a changed file under tests/snapshots/texts. To accept it:

    GN0_SNAPSHOTS=update pytest -n 0 tests/snapshots
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

import gn0
from gn0 import Camera, Episode, Gn0Error, OccupancyGrid, Scene, errors, open_simulator, run_episode
from gn0.bench import build_suite, load_run, load_suite, run_suite
from gn0.cli.main import GROUPS, VERBS, format_error, main, top_help
from gn0.data import BalanceSettings, open_dataset, parse_answer
from gn0.device import open_device
from gn0.device.host import DeviceHost
from gn0.jobs import run_jobs
from gn0.maps import NavigationMap
from gn0.missions import MissionGoal, MissionSettings, load_episodes, load_set
from gn0.missions.language.exchanges import ChatRequest, ExchangeFolder
from gn0.missions.language.models import _Recorded
from gn0.missions.language.prompts import Role, build_messages
from gn0.missions.language.route import STYLES
from gn0.plugins import get_plugin, import_plugins
from gn0.policies import PolicyOracle, PolicyRemote
from gn0.policies.qwen.model import load_numpy_model
from gn0.render import RendererCpu
from gn0.scenes import build_example_scene, import_scene, load_cloud, load_scene, save_scene
from gn0.sim import find_preset
from gn0.storage import safe_join
from gn0.training.runs.loss_guard import check_finite
from gn0_trials.random_qwen import build_random_checkpoint
from gn0_trials.routes import build_simple_route

TEXTS = Path(__file__).parent / "texts"
UPDATE = os.environ.get("GN0_SNAPSHOTS") == "update"
ACCEPT = "if the new text is meant: GN0_SNAPSHOTS=update pytest -n 0 tests/snapshots"


def compare(name: str, text: str) -> None:
    """Hold `text` against tests/snapshots/texts/NAME.txt."""
    text = "\n".join(line.rstrip() for line in text.strip().splitlines()) + "\n"
    file = TEXTS / f"{name}.txt"
    if UPDATE:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, "utf-8")
    assert file.exists(), f"no snapshot {name}; {ACCEPT}"
    assert text == file.read_text("utf-8"), ACCEPT


# --- errors: for each code what a user does wrong, and what they then read


class Place:
    """A folder of the test, and a flat in it that is made when first wanted."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    @property
    def scene(self) -> Scene:
        return build_example_scene(spacing=0.5)

    @property
    def saved(self) -> Path:
        flat = self.folder / "flat"
        if not flat.exists():
            save_scene(self.scene, flat)
        return flat

    def write(self, name: str, text: str) -> Path:
        file = self.folder / name
        file.write_text(text)
        return file

    def damage(self, name: str, old: str, new: str) -> Path:
        """The flat with `old` in one of its files written as `new`."""
        file = self.saved / name
        before = file.read_text()
        assert old in before
        file.write_text(before.replace(old, new, 1))
        return self.saved

    def episode(self, scene: str = "example-flat", x: float = 1.0) -> Episode:
        """A walk from (x, 2.5) to the sofa."""
        mission = MissionGoal(
            goal=(6.3, 1.6), object_id="sofa_0", category="sofa", instruction="Go to the sofa."
        )
        start, path = (x, 2.5, 0.0), ((x, 2.5), (6.3, 1.6))
        return Episode(id="e1", scene_id=scene, mission=mission, start=start, path=path)

    @property
    def suite(self) -> Any:
        return build_suite([self.saved], self.folder / "suite", count=1, minimum_length=1.0)

    def simulator(self, *sensors: str) -> Any:
        return open_simulator(self.scene, sensors=set(sensors))


class PolicyLost:
    name, sensors = "lost", frozenset[str]()

    def reset(self, instruction: str, rng: object) -> None: ...

    def act(self, observation: object) -> Any:
        return "over there"


def fail(payload: dict[str, Any]) -> dict[str, Any]:
    """A unit of work with a fault in it."""
    raise KeyError("weather")


def _step_seven(place: Place) -> Any:
    simulator = place.simulator()
    simulator.reset(place.episode())
    return simulator.step(7)


def _lose_the_map(place: Place) -> Any:
    for file in place.saved.glob("occupancy*"):
        file.unlink()
    return load_scene(place.saved)


def _ask_what_was_not_recorded(place: Place) -> Any:
    request = ChatRequest(model="m", messages=[], temperature=0.0, max_tokens=1, seed=0)
    folder = ExchangeFolder(place.folder / "answers")
    folder.put(request, "Go.")
    messages = build_messages("moving", build_simple_route("left"), "base")
    return _Recorded(folder.folder, "m").ask(messages)


def _split_maze(place: Place) -> Any:
    cells = np.zeros((40, 40), np.uint8)
    cells[:, 20] = 1
    grid = OccupancyGrid(cells, 0.1, (0.0, 0.0))
    return NavigationMap(grid, 0.2).geodesic((1.0, 1.0)).path(3.0, 1.0)


EYE = Camera.from_hfov(8, 8, 90.0)
WRONG: dict[str, dict[str, Callable[[Place], Any]]] = {
    "FORMAT": {
        "a PLY file cut off in its header": lambda p: load_cloud(p.write("a.ply", "ply\nformat b")),
        "a text that is named like a splat file": lambda p: load_cloud(p.write("a.splat", "hello")),
        "an unknown field in scene.json": lambda p: load_scene(
            p.damage("scene.json", '"licence"', '"lisence"')
        ),
        "episodes that are not Parquet": lambda p: load_episodes(p.write("e.parquet", "PAR1")),
        "episodes of no known format": lambda p: load_set(p.write("e.csv", "a,b\n1,2\n")),
        "an answer that names no action": lambda p: parse_answer("left, I think"),
    },
    "CONFIG": {
        "a policy that is misspelt": lambda p: get_plugin("policy", "orcale"),
        "a renderer that does not exist": lambda p: get_plugin("renderer", "vulkan"),
        "a plug-in file that does not exist": lambda p: import_plugins(["my_policy.py"]),
        "a camera preset that does not exist": lambda p: find_preset("gn-bench"),
        "a sensor that does not exist": lambda p: p.simulator("rgbd"),
        "a body narrower than nothing": lambda p: NavigationMap(p.scene.grid, -1.0),
        "missions of no kind": lambda p: MissionSettings(missions=()),
    },
    "STORAGE": {
        "a scene folder that does not exist": lambda p: load_scene(p.folder / "nowhere"),
        "a folder that holds no scene": lambda p: load_scene(p.folder),
        "a scene folder without its map": _lose_the_map,
        "a path that leaves its folder": lambda p: safe_join(p.folder, "../secret"),
        "a folder that holds no dataset": lambda p: open_dataset(p.folder),
        "a folder that holds no run": lambda p: load_run(p.folder),
        "a folder that holds no suite": lambda p: load_suite(p.folder),
    },
    "SCENE": {
        "a folder in which no scene is found": lambda p: import_scene(p.folder, p.folder / "out"),
        "a scene that is imported twice": lambda p: import_scene(p.saved, p.folder / "out"),
        "cells of two metres": lambda p: import_scene(p.saved, p.folder / "out", resolution=2.0),
    },
    "EPISODE": {
        "a start in a wall": lambda p: p.simulator().reset(p.episode(x=0.0)),
        "an episode of another scene": lambda p: p.simulator().reset(p.episode("kitchen")),
        "a start that is not a number": lambda p: p.simulator().reset(p.episode(x=float("nan"))),
    },
    "PLAN": {
        "a goal in a wall": lambda p: NavigationMap(p.scene.grid).geodesic((0.0, 0.0)),
        "a goal beyond a wall": _split_maze,
    },
    "RENDER": {
        "a picture of no pixels": lambda p: Camera.from_hfov(0, 10, 90.0),
        "a field of view of half a turn": lambda p: Camera.from_hfov(10, 10, 180.0),
        "an output that does not exist": lambda p: RendererCpu(p.scene.load_cloud()).render(
            EYE, np.eye(4), outputs=("normals",)
        ),
        "a view that is not a number": lambda p: RendererCpu(p.scene.load_cloud()).render(
            EYE, np.full((4, 4), np.nan)
        ),
    },
    "SIM": {
        "a step before the first reset": lambda p: p.simulator().step(1),
        "an action that does not exist": _step_seven,
    },
    "POLICY": {
        "a policy that answers in words": lambda p: run_episode(
            p.simulator(), PolicyLost(), p.episode()
        ),
        "an oracle alone": lambda p: PolicyOracle().act(None),  # type: ignore[arg-type]
        "a policy server that is not there": lambda p: PolicyRemote(
            url="ws://127.0.0.1:9", connect_timeout=0.1
        ).reset(None),  # type: ignore[arg-type]
    },
    "CHECKPOINT": {
        "a folder without a model": lambda p: load_numpy_model(p.folder),
        "weights as a pickle": lambda p: load_numpy_model(_pickled(p.folder)),
    },
    "TRAINING": {
        "a loss that is no number": lambda p: check_finite(
            {"loss": float("nan")}, step=1200, batch="samples 614400 to 614911"
        )
    },
    "LANGUAGE": {"a prompt that was never recorded": _ask_what_was_not_recorded},
    "BENCH": {
        "a time limit of nothing": lambda p: run_suite(
            p.suite, "oracle", p.folder / "run", episode_time_limit=0.0
        ),
        "an episode of no scene of the suite": lambda p: p.suite.scene_folder("kitchen"),
    },
    "DATA": {"shares beyond a hundred percent": lambda p: BalanceSettings(forward=90.0).target},
    "JOB": {
        "a unit of work that fails": lambda p: run_jobs(f"{__name__}:fail", [{}], names=["flat"])
    },
    "DEVICE": {"a device that does not exist": lambda p: open_device("rocm")},
    "DEVICE_MEMORY": {
        "more than a device has": lambda p: DeviceHost(limit=1000).empty(2000, np.float32)
    },
}
COMMANDS: dict[str, list[str]] = {
    "a verb that is misspelt": ["bench", "rn"],
    "no verb": ["fly"],
    "a flag that is misspelt": ["bench", "run", "s", "--out", "o", "--polcy", "oracle"],
    "a flag that is missing": ["bench", "run", "s"],
    "a number that is a word": ["bench", "run", "s", "--out", "o", "--workers", "two"],
    "a number out of bounds": ["bench", "run", "s", "--out", "o", "--videos", "-1"],
    "a suite that does not exist": ["bench", "run", "nowhere", "--out", "o"],
    "a preset that does not exist": ["scene", "visible", "nowhere", "--camera", "gopro"],
}


def _pickled(folder: Path) -> Path:
    """A checkpoint whose weights are a pickle."""
    build_random_checkpoint(folder)
    (folder / "model.safetensors").rename(folder / "pytorch_model.bin")
    return folder


def _codes() -> list[str]:
    found = [kind for kind in vars(errors).values() if isinstance(kind, type)]
    return sorted({k.code for k in found if issubclass(k, Gn0Error)} - {Gn0Error.code})


@pytest.mark.parametrize("code", _codes())
def test_an_error_reads_as_it_did(
    code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if code == "DEVICE_MEMORY" and shutil.which("g++") is None:
        pytest.skip("the host emulation needs g++")
    monkeypatch.chdir(tmp_path)
    told = []
    for number, (what, do) in enumerate(WRONG[code].items()):
        folder = tmp_path / str(number)
        folder.mkdir()
        with pytest.raises(Gn0Error) as caught:
            do(Place(folder))
        assert caught.value.code == code, f"{what}: {caught.value}"
        text = format_error(caught.value).replace(str(folder), "FOLDER")
        told.append(f"# {what}\n{_lasting(text)}\n")
    compare(f"errors/{code}", "\n".join(told))


def _lasting(text: str) -> str:
    """The text without lists of names, which grow, and lines of a trace, which move."""
    text = re.sub(r"known: (\w+, )+\w+", "known: …", text)
    return re.sub(r'(?m)^\s*File "[^"]*", line \d+.*\n(^    .*\n)*', "  …\n", text)


def test_a_wrong_command_is_told_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    told = []
    for what, command in COMMANDS.items():
        try:
            code: Any = main(command)
        except SystemExit as left:
            code = left.code
        said = capsys.readouterr()
        told.append(
            f"# {what}\n$ gn0 {' '.join(command)}\n{_lasting(said.out + said.err)}exit {code}\n"
        )
    compare("errors/command", "\n".join(told))


# --- help


@pytest.mark.parametrize("verb", ["", *GROUPS, *VERBS])
def test_help_reads_as_it_did(
    verb: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    try:
        main([*verb.split(), "--help"])
    except SystemExit as left:
        assert left.code == 0
    text = capsys.readouterr().out
    assert verb in VERBS or text.strip() == top_help(verb).strip()
    compare(f"help/gn0 {verb}".strip().replace(" ", "_"), text)


# --- prompts


@pytest.mark.parametrize("role", get_args(Role))
def test_a_prompt_reads_as_it_did(role: Role) -> None:
    """As it reads for a route; a changed word needs a new `VERSION` in the module of prompts."""
    route, told = build_simple_route("left", "around"), []
    for style in STYLES:
        for message in build_messages(role, route, style, text="Go an end.", movement="Go on."):
            told.append(f"# {style}, {message['role']}\n{message['content']}\n")
    compare(f"prompts/{role}", "\n".join(told))


def test_no_snapshot_is_left_over() -> None:
    names = {f"errors/{code}" for code in _codes()} | {"errors/command"}
    names |= {f"help/gn0 {verb}".strip().replace(" ", "_") for verb in ["", *GROUPS, *VERBS]}
    names |= {f"prompts/{role}" for role in get_args(Role)}
    found = {str(f.relative_to(TEXTS).with_suffix("")) for f in TEXTS.rglob("*.txt")}
    assert found == names


def test_a_choice_lists_its_words_in_one_order_everywhere() -> None:
    """Python keeps one `Literal[...] | None` for two of the same words in other orders, so whoever
    is imported first would decide what a help text reads."""
    orders: dict[frozenset[str], set[tuple[str, ...]]] = {}
    for path in (Path(gn0.__file__).parent).rglob("*.py"):
        for words in re.findall(r"Literal\[([^\]]+)\]", path.read_text(encoding="utf-8")):
            order = tuple(re.findall(r"[^\s,]+", words))
            orders.setdefault(frozenset(order), set()).add(order)
    assert len(orders) > 50
    assert not [found for found in orders.values() if len(found) > 1]
