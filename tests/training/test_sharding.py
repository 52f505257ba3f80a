"""A model in parts on several processes: one's numbers, half of the memory, whole files."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("torch")
pytest.importorskip("transformers")

import msgspec
import torch
from torch.testing import assert_close

from gn0.cli.main import main
from gn0.data.answer_form import AnswerForm
from gn0.errors import ConfigError
from gn0.maps.navigation import NavigationMap
from gn0.missions.goal import sample_goal_episodes
from gn0.policies.bae.checkpoint import load_checkpoint
from gn0.policies.bae.policy_settings import PolicySettings
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.suites.suite import save_suite
from gn0.training.processes import ALONE
from gn0.training.recipe import RECIPES, Speed, parse_speed
from gn0.training.runs.training_state import TrainingState, load_state
from gn0.training.sft import SftJob
from gn0.training.sharding import is_sharded, lay_like, open_mesh, own_part

TOGETHER = ["-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2", "-m"]


def _run(*words: str, count: int = 2) -> tuple[int, str]:
    start = TOGETHER if count > 1 else ["-m"]
    done = subprocess.run(
        [sys.executable, *start, *words],
        env=os.environ | {"OMP_NUM_THREADS": "1"}, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    return done.returncode, done.stdout + done.stderr


def _learn(folder: Path, samples: int, what: str = "fsdp", count: int = 2, dies_at: int = -1):
    words = [str(folder), str(samples), str(dies_at), what]
    return _run("gn0_trials.training_together", *words, count=count)


def _losses(folder: Path) -> list[float]:
    lines = (folder / "metrics.jsonl").read_text().splitlines()
    return [json.loads(line)["loss"] for line in lines]


def _list_arrays(state: TrainingState) -> dict[str, torch.Tensor]:
    assert state.optimiser is not None
    parts = {"averaged": state.averaged, "optimiser": state.optimiser.arrays, "other": state.arrays}
    found = {f"{kind}/{name}": own for kind, some in parts.items() for name, own in some.items()}
    return found | dict(state.checkpoint.model.named_parameters())


def _compare(one: Path, two: Path, close: float) -> None:
    first, second = (load_state(path / "checkpoints") for path in (one, two))
    assert first.counters.step == second.counters.step
    theirs = _list_arrays(second)
    assert _list_arrays(first).keys() == theirs.keys()
    for name, own in _list_arrays(first).items():
        assert_close(theirs[name], own, atol=close, rtol=0, msg=name)


@pytest.mark.slow
def test_parts_learn_what_one_process_and_what_whole_copies_do(tmp_path) -> None:
    for name, what, count in (("one", "", 1), ("whole", "", 2), ("parts", "fsdp", 2)):
        code, said = _learn(tmp_path / name, 16, what, count)
        assert code == 0, said
    for name in ("one", "whole"):
        assert _losses(tmp_path / "parts") == pytest.approx(_losses(tmp_path / name), abs=1e-5)
        _compare(tmp_path / name, tmp_path / "parts", 1e-5)
    whole = json.loads((tmp_path / "one" / "held.json").read_text())[0]
    assert whole["optimiser"] == 2 * whole["weights"] == 2 * whole["averaged"] > 0
    held = json.loads((tmp_path / "parts" / "held.json").read_text())
    for name, numbers in whole.items():
        assert sum(one[name] for one in held) == numbers
        assert max(one[name] for one in held) < 0.51 * numbers


@pytest.mark.slow
def test_parts_learn_several_inputs_though_the_tower_is_idle_in_some_steps(tmp_path) -> None:
    assert _learn(tmp_path / "one", 24, "inputs", 1)[0] == 0
    code, said = _learn(tmp_path / "parts", 24, "inputs,fsdp")
    assert code == 0, said
    assert _losses(tmp_path / "parts") == pytest.approx(_losses(tmp_path / "one"), abs=1e-5)
    _compare(tmp_path / "one", tmp_path / "parts", 1e-5)


@pytest.mark.slow
def test_a_killed_run_goes_on_to_the_same_numbers_in_parts_and_alone(tmp_path) -> None:
    code, said = _learn(tmp_path / "whole", 24)
    assert code == 0, said
    assert _learn(tmp_path / "parts", 24, dies_at=12)[0] != 0
    assert load_state(tmp_path / "parts" / "checkpoints").counters.step == 2
    code, said = _learn(tmp_path / "parts", 24)
    assert code == 0, said
    assert _losses(tmp_path / "parts") == _losses(tmp_path / "whole")
    _compare(tmp_path / "whole", tmp_path / "parts", 0.0)
    code, said = _learn(tmp_path / "whole", 32)
    assert code == 0, said
    code, said = _learn(tmp_path / "parts", 32, "", count=1)  # a state is whole: one goes on, too
    assert code == 0, said
    assert _losses(tmp_path / "parts") == pytest.approx(_losses(tmp_path / "whole"), abs=1e-5)
    _compare(tmp_path / "whole", tmp_path / "parts", 1e-5)


@pytest.mark.slow
def test_the_verb_in_parts_examines_and_writes_what_whole_copies_would(
    tmp_path, own_cache, monkeypatch
) -> None:
    if not shutil.which("g++"):
        pytest.skip("the host emulation needs g++")
    monkeypatch.setenv("GN0_CACHE", str(own_cache))
    save_scene(build_example_scene(), tmp_path / "flat")
    scene = load_scene(tmp_path / "flat")
    episodes = sample_goal_episodes(scene, NavigationMap(scene.grid, 0.2), 6, 0)
    suite = save_suite(tmp_path / "suite", [scene], episodes, name="flat", max_steps=12).folder
    flags = [
        "--split", "all", "--held-out", "test", "--size", "nano", "--batch", "4", "--agents", "4",
        "--kept", "80", "--report", "1", "--examine", "1", "--examined", "2", "--asked", "8",
        "--samples", "8", "--device", "host",
    ]  # fmt: skip
    for name, more in (("whole", []), ("parts", ["--fsdp"])):
        out = ["--out", str(tmp_path / name), *more]
        code, said = _run("--", "gn0", "train", "sft", str(suite), *flags, *out)
        assert code == 0, said
    whole, parts = (
        [json.loads(line) for line in (tmp_path / name / "metrics.jsonl").read_text().splitlines()]
        for name in ("whole", "parts")
    )
    assert len(whole) == len(parts) == 2
    for one, other in zip(whole, parts, strict=True):
        assert one.keys() == other.keys() >= {"first_action", "entropy", "SR"}
        for name in one.keys() - {"seconds", "samples_per_second"}:
            wanted = None if one[name] is None else pytest.approx(one[name], rel=1e-5, abs=1e-5)
            assert other[name] == wanted, name
    written = [load_checkpoint(tmp_path / name / "policy") for name in ("whole", "parts")]
    theirs = dict(written[1].model.named_parameters())
    for name, own in written[0].model.named_parameters():
        assert_close(theirs[name], own, rtol=2**-7, atol=1e-5, msg=name)  # bfloat16's last bit
    option = f"checkpoint={tmp_path / 'parts' / 'policy'}"
    bench = [
        "bench",
        "run",
        str(suite),
        "--policy",
        "bae",
        "--policy-option",
        option,
        "--no-report",
    ]
    assert main([*bench, "--episodes", "1", "--out", str(tmp_path / "bench")]) == 0


def test_what_is_not_sharded_is_left_as_it_is() -> None:
    layer, array = torch.nn.Linear(2, 3), torch.ones(3, 2)
    assert not is_sharded(layer)
    assert own_part(layer.weight) is layer.weight
    assert lay_like(array, layer.weight) is array


def test_one_process_has_nobody_to_share_with() -> None:
    with pytest.raises(ConfigError, match="weights of one process") as caught:
        open_mesh(ALONE, torch.device("cpu"))
    assert "torchrun" in str(caught.value)


@pytest.mark.parametrize("words", [["whole"], ["tuned"], ["joined"], ["beside", "narrow"]])
def test_what_needs_whole_weights_does_not_go_with_parts(words: list[str]) -> None:
    with pytest.raises(ConfigError, match="block by block"):
        parse_speed(words, fsdp=True)
    assert parse_speed(["narrow"], fsdp=True) == Speed(narrow=True, fsdp=True)


def test_adapters_are_refused() -> None:
    settings = PolicySettings(prompt="short", pictures=("near",), form=AnswerForm())
    more: dict[str, Any] = {"settings": settings, "start": "model", "speed": Speed(fsdp=True)}
    recipe = msgspec.structs.replace(RECIPES["pretrained"], lora=4)
    with pytest.raises(ConfigError, match="adapters of a model whose weights lie in parts"):
        SftJob(suites=("suite",), recipe=recipe, **more)


def test_agents_do_not_act_with_parts() -> None:
    from gn0.training.dagger import DaggerJob
    from gn0.training.dagger_live import DaggerLiveJob

    more: dict[str, Any] = {"suites": ("suite",), "start": "policy", "speed": Speed(fsdp=True)}
    for job in (DaggerJob, DaggerLiveJob):
        with pytest.raises(ConfigError, match="agents that act"):
            job(**more)
    assert DaggerJob(source="dataset", **more).speed.fsdp
