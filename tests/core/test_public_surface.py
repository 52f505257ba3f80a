"""What users import: typed, shallow, all of it there, and nothing else in what we show them."""

from __future__ import annotations

import importlib.util
import json
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import gn0

ROOT = Path(__file__).resolve().parents[2]
SRC = ROOT / "src" / "gn0"
NAMESPACES = ["gn0", *sorted(f"gn0.{stub.parent.name}" for stub in SRC.glob("*/__init__.pyi"))]
IMPORT = re.compile(r"^\s*(?:from (gn0(?:\.\w+)*) import|import (gn0(?:\.\w+)*)\b(?!\w))", re.M)
FENCE = re.compile(r"^```python[^\n]*\n(.*?)^```", re.M | re.S)
# the tools of this checkout, not a user's code
OURS = {"docs/draw_api.py", "docs/draw_people.py", "docs/refresh_pictures.py"}

USERS_FILE = """
from pathlib import Path

from gn0 import Action, Gn0Error, Observation, load_scene, open_simulator, run_episode
from gn0.bench import EpisodeMetrics, compute_metrics
from gn0.maps import NavigationMap
from gn0.missions import Episode, sample_goal_episodes
from gn0.policies import PolicyOracle
from gn0.scenes import build_example_scene, save_scene


class Timid:
    def reset(self, episode_info: object) -> None: ...

    def act(self, observation: Observation) -> Action:
        return Action.FORWARD if observation.step < 3 else Action.STOP


def walk(folder: Path) -> EpisodeMetrics:
    try:
        scene = load_scene(folder)
    except Gn0Error:
        scene = build_example_scene()
        save_scene(scene, folder)
    simulator = open_simulator(scene, preset="gn_bench", sensors={"ranges"})
    navigation: NavigationMap = simulator.navigation
    episode: Episode = sample_goal_episodes(scene, navigation, count=1, seed=0)[0]
    trajectory = run_episode(simulator, PolicyOracle(), episode)
    return compute_metrics(trajectory, episode, navigation.geodesic(episode.goal).distance)


reveal_type(load_scene)
reveal_type(open_simulator)
reveal_type(walk(Path("flat")).success)
"""


EXTRA = {"gn0.training": "torch"}  # rooms whose names need an extra, and how it shows


@pytest.mark.parametrize("name", NAMESPACES)
def test_every_public_name_is_there(name: str) -> None:
    if name in EXTRA:
        pytest.importorskip(EXTRA[name])
    module = import_module(name)
    assert module.__all__ == sorted(module.__all__)
    for key in module.__all__:
        assert getattr(module, key) is not None
        assert not key.startswith("_") and key in dir(module)
        # a module of that name would take the name's place once it is imported
        taken = name != "gn0" and importlib.util.find_spec(f"{name}.{key}") is not None
        assert not taken, f"{name}.{key} is a module, too"
    with pytest.raises(AttributeError, match="nothing_of_ours"):
        _ = module.nothing_of_ours


def test_the_surface_is_shallow() -> None:
    core = [name for name in NAMESPACES if name not in EXTRA]
    assert len(core) <= 14, core
    public = {key for name in core for key in import_module(name).__all__}
    assert len(public) < 270  # each is a promise; people brought a room of their own
    assert all(len(import_module(name).__all__) < 30 for name in EXTRA)
    assert gn0.load_scene is gn0.scenes.load_scene


def test_the_root_loads_nothing_before_it_is_asked() -> None:
    code = "import sys; before = set(sys.modules); import gn0; print(*(set(sys.modules) - before))"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()
    assert {name for name in loaded if name.startswith("gn0")} == {"gn0", "gn0.namespace"}
    assert not {"numpy", "msgspec", "typing", "pathlib"} & set(loaded)


def _shown_code() -> list[tuple[str, str]]:
    shown = []
    for page in [
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
        *sorted((ROOT / "docs").glob("*.md")),
    ]:
        shown += [(str(page.relative_to(ROOT)), code) for code in FENCE.findall(page.read_text())]
    for file in sorted([*(ROOT / "examples").glob("*.py"), *(ROOT / "docs").glob("*.py")]):
        shown.append((str(file.relative_to(ROOT)), file.read_text()))
    for book in sorted((ROOT / "examples").glob("*.ipynb")):
        cells = json.loads(book.read_text())["cells"]
        code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
        shown.append((str(book.relative_to(ROOT)), code))
    return shown


def test_what_we_show_imports_only_what_is_public() -> None:
    deep = [
        f"{where}: {module}"
        for where, code in _shown_code()
        if where not in OURS
        for match in IMPORT.finditer(code)
        if (module := match[1] or match[2]) not in NAMESPACES
    ]
    assert not deep, deep


# strings of configuration: the module that registers the Gymnasium ids, and the entry-point group
KEPT = {"gn0.sim.env", "gn0.plugins"}


def test_what_we_write_names_nothing_private() -> None:
    named = {
        f"{page.name}: {name}"
        for page in (ROOT / "docs").glob("*.md")
        if page.name != "figures.md"  # details of what was measured
        for name in re.findall(r"\bgn0(?:\.[a-zA-Z]\w*)+", page.read_text())
        if name not in NAMESPACES and name not in KEPT and not _is_public(name)
    }
    assert not named, named


def _is_public(name: str) -> bool:
    room, _, key = name.rpartition(".")
    return room in NAMESPACES and key in import_module(room).__all__


@pytest.mark.slow
def test_a_users_file_is_typed_all_through(tmp_path: Path) -> None:
    """With mypy as strict as it gets, from outside, against the package as it is installed."""
    file = tmp_path / "mine.py"
    file.write_text(USERS_FILE)
    done = subprocess.run(
        [sys.executable, "-m", "mypy", "--strict", "--follow-imports=silent", "--config-file=",
         "--cache-dir", str(tmp_path / "cache"), str(file)],
        cwd=tmp_path, env={"MYPYPATH": str(SRC.parent), "PATH": ""}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    assert "Any" not in re.sub(r"Mapping\[.*?\]", "", done.stdout), done.stdout
    assert re.search(r'Revealed type is "(builtins\.)?bool"', done.stdout), done.stdout


def test_the_reference_is_drawn_from_the_docstrings_of_now() -> None:
    spec = importlib.util.spec_from_file_location("draw_api", ROOT / "docs" / "draw_api.py")
    assert spec is not None and spec.loader is not None
    drawn = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(drawn)
    pages = drawn.pages()
    old = {page.name: page.read_text() for page in (ROOT / "docs" / "api").glob("*.md")}
    stale = sorted(name for name in pages.keys() | old.keys() if pages.get(name) != old.get(name))
    assert not stale, f"{stale}: run python docs/draw_api.py"
