"""States of a training run: what was learned goes on to the bit, and nothing half is believed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest

os.environ.setdefault("HF_HUB_OFFLINE", "1")
torch = pytest.importorskip("torch", reason="training needs gn0[train]")
pytest.importorskip("transformers", reason="training needs gn0[train]")

from gn0.errors import CheckpointError, StorageError  # noqa: E402
from gn0.policies.bae.checkpoint import load_checkpoint  # noqa: E402
from gn0.training.runs.generators import restore_generators  # noqa: E402
from gn0.training.runs.optimiser_state import capture_optimiser, restore_optimiser  # noqa: E402
from gn0.training.runs.recipe_text import describe_recipe  # noqa: E402
from gn0.training.runs.resume_checks import check_resume  # noqa: E402
from gn0.training.runs.state_folder import discard_states_after, find_latest, list_states  # noqa: E402
from gn0.training.runs.training_state import (  # noqa: E402
    load_state,
    measure_state,
    save_state,
)
from gn0_trials.training_kills import (  # noqa: E402
    CORPUS,
    LearnerOfWords,
    WordsRecipe,
    kill_training,
)


@pytest.fixture(scope="module")
def saved(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """States of steps 2 and 4."""
    folder = tmp_path_factory.mktemp("run") / "checkpoints"
    learner = LearnerOfWords()
    for _ in range(2):
        learner.learn(2)
        save_state(folder, learner.state())
    return folder


@pytest.fixture
def folder(saved: Path, tmp_path: Path) -> Path:
    """The same to spoil."""
    return Path(shutil.copytree(saved, tmp_path / "checkpoints"))


def test_a_resumed_run_goes_on_to_the_bit(tmp_path: Path) -> None:
    """Losses, weights, averages and optimiser are those of a run that never stopped."""
    whole = LearnerOfWords()
    whole.learn(3)
    save_state(tmp_path / "run", whole.state(), shard_mb=3)
    theirs = whole.learn(4)
    state = load_state(tmp_path / "run")
    assert (state.counters.step, state.counters.samples) == (3, 6)
    assert state.source == {"part": 3, "row": 17} and state.corpus == CORPUS
    assert torch.equal(state.arrays["head.weight"], torch.arange(6).reshape(2, 3))
    again = LearnerOfWords(state)
    assert again.learn(4) == theirs
    for (name, mine), (_, other) in zip(again.named, whole.named, strict=True):
        assert torch.equal(mine, other), name
        assert torch.equal(again.averaged[name], whole.averaged[name]), name
    mine, other = again.state().optimiser, whole.state().optimiser
    assert mine.groups == other.groups
    assert all(torch.equal(mine.arrays[key], value) for key, value in other.arrays.items())


def test_the_model_of_a_state_is_a_checkpoint_of_its_own(saved: Path) -> None:
    """Stock readers open it, and it is safetensors and JSON all through."""
    latest = find_latest(saved)
    assert latest is not None
    load_checkpoint(latest / "model")
    kinds = {path.suffix for path in latest.rglob("*") if path.is_file()}
    assert kinds <= {".json", ".safetensors", ".txt", ".jinja"}


def test_files_are_of_the_size_asked_for(tmp_path: Path) -> None:
    learner = LearnerOfWords()
    path = save_state(tmp_path, learner.state(), shard_mb=1)
    shards = [file for file in path.rglob("*.safetensors") if file.stat().st_size > 1_100_000]
    widest = learner.model.get_input_embeddings().weight
    assert all(file.stat().st_size < 4 * widest.numel() + 10_000 for file in shards)
    assert len(list(path.glob("averaged-*.safetensors"))) > 3
    assert load_state(path).averaged


def test_the_last_two_are_kept(saved: Path, folder: Path) -> None:
    assert [path.name for path in list_states(folder)] == ["step-000000002", "step-000000004"]
    learner = LearnerOfWords(load_state(folder))
    learner.learn(1)
    save_state(folder, learner.state())
    assert [path.name for path in list_states(folder)] == ["step-000000004", "step-000000005"]
    assert sorted(path.name for path in folder.iterdir()) == ["step-000000004", "step-000000005"]


def test_a_state_of_the_same_step_is_written_over(folder: Path) -> None:
    save_state(folder, LearnerOfWords(load_state(folder)).state())
    assert len(list_states(folder)) == 2
    load_state(folder)


def test_later_steps_are_given_up_by_name_alone(folder: Path) -> None:
    """Who resumes from an earlier state says so before another may take the later one's place."""
    learner = LearnerOfWords(load_state(folder / "step-000000002"))
    learner.learn(1)
    with pytest.raises(StorageError, match="step-000000004 is there, a state of a later step"):
        save_state(folder, learner.state())
    discard_states_after(folder, 2)
    save_state(folder, learner.state())
    assert [path.name for path in list_states(folder)] == ["step-000000002", "step-000000003"]


def test_the_optimiser_may_stay_behind(folder: Path) -> None:
    whole = find_latest(folder)
    state = load_state(folder)
    path = save_state(folder, state, without_optimiser=True, dtype=torch.bfloat16)
    assert path == whole
    light = load_state(folder)
    assert light.optimiser is None
    facts = {"recipe": state.recipe, "corpus": CORPUS, "device": state.device}
    (note,) = check_resume(light, **facts)
    assert "optimiser was left behind" in note
    with pytest.raises(CheckpointError, match="not to be resumed exactly"):
        check_resume(light, **facts, exact=True)
    weight = next(light.checkpoint.model.parameters())
    assert weight.dtype == torch.bfloat16
    first = next(state.checkpoint.model.parameters()).to(torch.bfloat16)
    assert torch.equal(weight, first)


@pytest.mark.parametrize(
    "name", ["model/model.safetensors", "optimiser.safetensors", "averaged.safetensors",
             "generators.safetensors", "state.json", "model/tokenizer.json"]
)  # fmt: skip
@pytest.mark.parametrize("how", ["cut", "altered", "missing"])
def test_what_is_not_whole_is_refused(folder: Path, name: str, how: str) -> None:
    """The error names the file and the state before."""
    latest = folder / "step-000000004"
    path = latest / name
    data = bytearray(path.read_bytes())
    if how == "cut":
        path.write_bytes(data[: len(data) // 2])
    elif how == "missing":
        path.unlink()
    else:
        place = data.index(CORPUS.encode()) if name == "state.json" else len(data) // 2
        data[place] ^= 1
        path.write_bytes(data)
    with pytest.raises((CheckpointError, StorageError)) as caught:
        load_state(latest)
    assert Path(name).name in str(caught.value)
    if (how, name) != ("missing", "state.json"):  # no state at all
        assert "step-000000002" in caught.value.remedy


def test_a_file_too_many_is_refused(folder: Path) -> None:
    (folder / "step-000000004" / "optimiser-00002-of-00002.safetensors").write_bytes(b"")
    with pytest.raises(CheckpointError, match="not one of its files"):
        load_state(folder)


def test_a_folder_without_a_state_says_so(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match="no state of a training run"):
        load_state(tmp_path)
    assert find_latest(tmp_path / "nowhere") is None


def test_other_recipes_corpora_and_cards(saved: Path) -> None:
    state = load_state(saved)
    facts = {"recipe": state.recipe, "corpus": state.corpus, "device": state.device}
    assert check_resume(state, **facts, exact=True) == ()
    with pytest.raises(CheckpointError, match=r"learned from words at random, this is bad"):
        check_resume(state, **(facts | {"corpus": "bad"}))
    other = describe_recipe(WordsRecipe(rate=2e-3))
    with pytest.raises(CheckpointError, match=r"rate was 0\.001, is 0\.002"):
        check_resume(state, **(facts | {"recipe": other}))
    longer = describe_recipe(WordsRecipe(steps=16))
    assert check_resume(state, **(facts | {"recipe": longer}), free={"steps"}) == (
        "recipe: steps was 8, is 16",
    )
    card = facts | {"device": "Some Card"}
    (note,) = check_resume(state, **card)
    assert "resumed on Some Card" in note
    with pytest.raises(CheckpointError, match="Some Card"):
        check_resume(state, **card, exact=True)
    (note,) = check_resume(replace(state, versions={"torch": "1.0"}), **facts)
    assert "torch 1.0" in note


def test_another_optimiser_is_refused(saved: Path) -> None:
    state = load_state(saved)
    learner = LearnerOfWords()
    sgd = torch.optim.SGD([w for _, w in learner.named], 0.1)
    with pytest.raises(CheckpointError, match="that of AdamW, the optimiser is SGD"):
        restore_optimiser(sgd, state.optimiser, learner.named)
    fewer = torch.optim.AdamW([w for _, w in learner.named[:3]], 0.1)
    with pytest.raises(CheckpointError, match="groups of parameters"):
        restore_optimiser(fewer, state.optimiser, learner.named)
    with pytest.raises(CheckpointError, match="without a name"):
        capture_optimiser(fewer, learner.named[:2])
    arrays = {key: value.reshape(-1)[:1] for key, value in state.optimiser.arrays.items()}
    with pytest.raises(CheckpointError, match="is remembered of"):
        restore_optimiser(learner.optimiser, replace(state.optimiser, arrays=arrays), learner.named)


def test_generators_of_another_number_are_refused(saved: Path) -> None:
    state = load_state(saved)
    with pytest.raises(CheckpointError, match="generators"):
        restore_generators(state.generators)
    lost = restore_generators({"torch_cuda_0": state.generators["torch_cpu"]})
    assert torch.cuda.is_available() or "no card 0 here" in lost[0]


def test_what_json_does_not_hold_is_refused(tmp_path: Path) -> None:
    state = replace(LearnerOfWords().state(), source={"at": object()})
    with pytest.raises(CheckpointError, match="not to be written as JSON"):
        save_state(tmp_path, state)
    assert list(tmp_path.iterdir()) == []


FULL = """
import resource, signal, sys, torch
from dataclasses import replace
from pathlib import Path
from gn0.errors import StorageError
from gn0.training.runs.training_state import load_state, save_state
folder = Path(sys.argv[1])
state = load_state(folder)
counters = type(state.counters)(step=5)
state = replace(state, counters=counters, arrays={"large": torch.zeros(3_000_000)})
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
for limit in map(int, sys.argv[2:]):
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, resource.RLIM_INFINITY))
    try:
        save_state(folder, state)
    except StorageError as error:
        print(error)
"""


def test_no_file_grows_further(folder: Path) -> None:
    """The system refuses in the middle of a file: an error, and the states before stay as they are.

    In config.json, the tokenizer, the model, and the last file, whose 12 MB are cut at 9 MB.
    """
    limits = ("500", "20000", "200000", "9000000")
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(folder), *limits],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count("cannot write") == len(limits), done.stdout
    assert sorted(path.name for path in folder.iterdir()) == ["step-000000002", "step-000000004"]
    load_state(folder)


def test_a_disk_without_room_is_told_beforehand(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    state = load_state(folder)
    usage = shutil.disk_usage(folder)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage._replace(free=1_000_000))
    with pytest.raises(StorageError, match=r"a checkpoint takes .* MB, 1 MB are free"):
        save_state(folder, state)
    load_state(folder)


def test_bytes_are_those_of_the_tensors(saved: Path) -> None:
    """Weights and averages in float32, the moments of those that were trained, and little more."""
    state = load_state(saved)
    arrays = [*state.checkpoint.model.parameters(), *state.averaged.values()]
    numbers = sum(array.numel() for array in [*arrays, *state.optimiser.arrays.values()])
    assert 4 * numbers < measure_state(find_latest(saved)) < 4 * numbers + 500_000


def test_secrets_are_never_written(tmp_path: Path) -> None:
    recipe = describe_recipe(WordsRecipe(hub_token="hf_secret"))
    save_state(tmp_path, replace(LearnerOfWords().state(), recipe=recipe))
    for path in tmp_path.rglob("*"):
        assert path.is_dir() or b"hf_secret" not in path.read_bytes(), path
    assert recipe["shape"] == [2, 6]


@pytest.mark.slow
def test_ten_kills_change_nothing(tmp_path: Path) -> None:
    """kill −9 while it trains and saves: the last state or the one before, and the same bits."""
    tally = kill_training(tmp_path, 10)
    assert tally.broken == () and tally.last == 10
    assert tally.equal and tally.step >= 2


def test_what_lies_beside_a_model_is_kept_with_it(saved: Path, tmp_path: Path) -> None:
    def write(folder: Path) -> None:
        (folder / "prompt.txt").write_text("go", "utf-8")

    path = save_state(tmp_path, load_state(saved), beside=write)
    load_state(path)
    (path / "model" / "prompt.txt").write_text("stop", "utf-8")
    with pytest.raises(CheckpointError, match="2 were written"):
        load_state(path)
