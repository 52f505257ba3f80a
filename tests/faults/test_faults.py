"""The list of faults fits the code: each is where it says, changes something, and still parses."""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

from gn0_figures.board import FigureContext, FigureSkipped
from gn0_figures.proof import FIGURES

HERE = Path(__file__).resolve().parent


def beside(name: str) -> ModuleType:
    """A script of this folder as a module."""
    if name not in sys.modules:
        spec = importlib.util.spec_from_file_location(name, HERE / f"{name}.py")
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        spec.loader.exec_module(module)
    return sys.modules[name]


fault_list = beside("fault_list")
FAULTS = fault_list.load_faults()


def test_the_list_is_as_long_as_promised_and_half_of_it_is_drawn() -> None:
    names = [fault.name for fault in FAULTS]
    assert len(set(names)) == len(names)
    real = [fault for fault in FAULTS if not fault.equivalent]
    assert len(real) >= 150
    drawn = [fault for fault in FAULTS if fault.origin == "drawn"]
    hand = [fault for fault in FAULTS if fault.origin == "hand"]
    assert len(drawn) >= 80 and len(drawn) >= 0.4 * len(drawn + hand)


@pytest.mark.parametrize(
    ("room", "least"),
    {"exports": 20, "viewer": 20, "command_line": 20, "moving_parts": 10, "procedural": 20}.items(),
)
def test_a_room_has_a_list_of_its_own(room: str, least: int) -> None:
    own = [fault for fault in FAULTS if fault.origin == room]
    assert len(own) >= least
    assert len({fault.file for fault in own}) >= least / 3, "faults of a few files alone"


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_every_fault_still_applies(fault) -> None:  # type: ignore[no-untyped-def]
    """When the code around it changed: the message says how to mend the list."""
    source = (fault_list.ROOT / fault.file).read_text()
    new = fault.changed(source)
    if fault.file.endswith(".py"):
        compile(new, fault.file, "exec")


def test_a_fault_whose_place_is_gone_says_so() -> None:
    fault = fault_list.Fault("gone", "a.py", "f", "return 2", "return 3")
    with pytest.raises(fault_list.StaleFaultError, match="0 times 'return 2' in f of"):
        fault.changed("def f():\n    return 1\n")
    with pytest.raises(fault_list.StaleFaultError, match="no function g"):
        fault_list.Fault("gone", "a.py", "g", "a", "b").changed("def f():\n    return 1\n")
    same = fault_list.Fault("same", "a.py", "f", "return 1", "return  1")
    with pytest.raises(fault_list.StaleFaultError, match="changes nothing"):
        same.changed("def f():\n    return 1\n")
    assert (
        fault_list.Fault("two", "a.py", "g", "1", "3")
        .changed("def f():\n    return 1\n\n\n@d\ndef g():\n    return 1\n")
        .endswith("def g():\n    return 3\n")
    )


@pytest.mark.slow
def test_a_fault_is_tried_in_a_copy_and_its_verdict_holds_until_something_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A tree of one module and one test: one fault is noticed, one is not, one hangs nobody."""
    code = {
        "src/gn0/__init__.py": "",
        "src/gn0/a.py": "def f(x):\n    if x > 3:\n        return 1\n    return 2\n",
        "tests/test_a.py": "from gn0.a import f\n\n\ndef test_f():\n    assert f(9) == 1\n",
        "pyproject.toml": "[tool.pytest.ini_options]\nmarkers = ['slow', 'browser']\n",
    }
    for name, text in code.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    subprocess.run(["git", "init", "-q", tmp_path], check=True)
    monkeypatch.syspath_prepend(str(HERE))
    run = beside("run_faults")
    monkeypatch.setattr(run, "ROOT", tmp_path)
    faults = [
        fault_list.Fault("noticed", "src/gn0/a.py", "f", "return 1", "return 3"),
        fault_list.Fault("missed", "src/gn0/a.py", "f", "x > 3", "x > 4"),
    ]
    journal = run.Journal(tmp_path / "out/journal.jsonl")
    run.work(faults, journal, tmp_path / "out", 1, 60.0)
    verdicts = {name: (row["verdict"], row["by"]) for name, row in journal.rows.items()}
    assert verdicts == {
        "noticed": ("killed", "tests/test_a.py::test_f"),
        "missed": ("survived", ""),
    }
    assert (tmp_path / "src/gn0/a.py").read_text() == code["src/gn0/a.py"]
    assert (tmp_path / "out/lane0/tree/src/gn0/a.py").read_text() == code["src/gn0/a.py"]
    assert run.report(faults, journal, [], tmp_path / "out") == 0.5
    assert "survived: missed" in capsys.readouterr().out
    assert all(run.Journal(journal.path).holds(fault) for fault in faults)
    (tmp_path / "tests/test_a.py").write_text(code["tests/test_a.py"] + "    assert f(4) == 1\n")
    assert not any(run.Journal(journal.path).holds(fault) for fault in faults)


def test_the_board_takes_what_the_command_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(str(HERE))
    monkeypatch.chdir(tmp_path)
    measure = next(f.measure for f in FIGURES if f.id == "trust.faults")
    with pytest.raises(FigureSkipped, match="make faults"):
        measure(FigureContext(data=None, work=tmp_path))
    row = {"name": "faults killed", "value": 91.0, "unit": "%", "passed": True}
    beside("run_faults").write_figures(tmp_path / "out/faults", "trust.faults", "Faults", [row])
    assert [r.value for r in measure(FigureContext(data=None, work=tmp_path))] == [91.0]


@pytest.mark.slow
def test_the_tests_named_after_a_module_come_first() -> None:
    imports = beside("fault_tests").TestMap(fault_list.ROOT)
    found = imports.tests_of("src/gn0/missions/similarity.py", "_find_similar", {})
    assert found[0] == "tests/missions/test_similarity.py"
    assert imports.tests_of("src/gn0/maps/ray.py", "trace_cells", {})[0] == "tests/maps/test_ray.py"
    kernels = imports.stale_kernels("src/gn0/maps/ray.py", "trace_cells")
    assert {"gn0.maps.ray", "gn0.maps.pose_astar", "gn0.maps.way_kernels"} <= kernels
    assert not imports.stale_kernels("src/gn0/storage.py", "write_atomic")
    card = imports.tests_of("src/gn0/render/cuda/kernels/parts.cu", "", {})
    assert any(name.startswith("tests/render/") for name in card[:3])
