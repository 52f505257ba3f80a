"""A packed policy answers as the run's own, rounded to bf16, with torch and without."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("transformers")

from gn0.data.answer_form import AnswerForm  # noqa: E402
from gn0.errors import (  # noqa: E402
    CheckpointError,
    ConfigError,
    FormatError,
    PolicyError,
    StorageError,
    TrainingError,
)
from gn0.geometry import Pose2D  # noqa: E402
from gn0.policies.bae.policy_bae import PolicyBae, digest_checkpoint  # noqa: E402
from gn0.policies.bae.policy_settings import PolicySettings, join_inputs  # noqa: E402
from gn0.policies.qwen.weights import open_weights  # noqa: E402
from gn0.sim.ego_map import EgoSquare, MapView  # noqa: E402
from gn0.sim.state import Observation  # noqa: E402
from gn0.training.exams.walks import Walk  # noqa: E402
from gn0.training.exams.walks_folder import WalksAbout, open_walks  # noqa: E402
from gn0.training.packing import pack_policy  # noqa: E402
from gn0.training.pupil import build_pupil, load_pupil  # noqa: E402
from gn0.training.runs.model_card import build_card  # noqa: E402
from gn0.training.runs.run_folder import open_run  # noqa: E402
from gn0.training.runs.stage_chain import list_stages, read_stages, write_stages  # noqa: E402
from gn0.training.study.walks_table import build_walks_table  # noqa: E402

SETTINGS = PolicySettings(
    prompt="short",
    pictures=("near", "far"),
    form=AnswerForm(layout="compact"),
    view=MapView((EgoSquare(32, 0.24), EgoSquare(32, 0.6))),
)


def make_run(folder: Path, pupil, **recipe) -> None:
    """A run as training leaves it, its policy in float32."""
    with open_run(
        folder, stage="sft", recipe={"seed": 3, "size": "nano", **recipe},
        hashes={"corpus": "c0ffee"}, device="cpu", versions={"torch": "2"},
        command=["train", "sft", "/home/somebody/suite", "--held-out", ""],
    ) as run:  # fmt: skip
        run.report(5, {"samples": 20.0, "seconds": 90.0, "loss": 1.5})
        pupil.save(folder / "policy", dtype=torch.float32)
        run.finish(5, {"SR": 0.25})


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    pupil = build_pupil("nano", SETTINGS, ["go to the sofa"], seed=2)
    with torch.no_grad():
        for weight in pupil.model.parameters():  # of some size, as if trained
            weight.add_(0.08 * torch.randn(weight.shape, generator=torch.manual_seed(1)))
    first, second = (tmp_path_factory.mktemp("runs") / name for name in ("first", "second"))
    make_run(first, pupil, suites=["/home/somebody/flats"])
    make_run(second, pupil, start=str(first / "policy"), suites=["/home/somebody/offices"])
    return second


def answer(folder: Path, backend: str) -> list[bytes]:
    policy = PolicyBae(str(folder), backend=backend)
    stream = np.random.default_rng(0)
    said = []
    for _ in range(6):
        policy.reset_batch([0], ["go to the sofa"], [stream])
        picture = stream.integers(0, 256, (32, 64, 3), dtype=np.uint8)
        pose = Pose2D(*stream.uniform(-3, 3, 3))
        policy.act_batch([0], [Observation(0, 0.0, "", pose=pose, more={"ego_map": picture})])
        told = policy.last_said(0)
        assert told is not None
        said.append(told.answer.tobytes())
    return said


def test_it_answers_as_the_rounded_one_with_torch_and_without(run: Path, tmp_path: Path) -> None:
    packed = pack_policy(run, tmp_path / "packed", shard_mb=2)
    shards = sorted(packed.folder.glob("*.safetensors"))
    assert len(shards) > 1 and all(shard.stat().st_size <= 2_000_000 for shard in shards)
    assert packed.size == sum(file.stat().st_size for file in packed.folder.iterdir())
    before, after = open_weights(run / "policy"), open_weights(packed.folder)
    assert set(before) == set(after)
    for name in before:
        rounded = torch.from_numpy(before[name].copy()).bfloat16().float().numpy()
        np.testing.assert_array_equal(after[name], rounded)
    one, other = answer(packed.folder, "torch"), answer(packed.folder, "numpy")
    assert one == other and len(set(one)) > 1
    assert json.loads((packed.folder / "config.json").read_text())["dtype"] == "bfloat16"


def test_the_card_tells_the_whole_chain_and_no_place(run: Path, tmp_path: Path) -> None:
    packed = pack_policy(run, tmp_path / "packed", tables="| SR | 25 |\n| --- | --- |")
    card = (packed.folder / "README.md").read_text("utf-8")
    assert card.startswith("---\nlicense: apache-2.0\n")
    for told in ("# packed", "…/flats", "…/offices", "c0ffee", "20 in 5 steps", "1.5 min",
                 "| SR | 0.25 |", "| SR | 25 |", "Apache-2.0", "near, far"):  # fmt: skip
        assert told in card, told
    assert "| answers are drawn | never" in card
    drawn = pack_policy(run, tmp_path / "drawn", draw_after=6)
    own = (drawn.folder / "README.md").read_text("utf-8")
    assert "drawn | after 6 actions" in own and "In these walks answers were never drawn." in own
    assert "In these walks" not in card
    assert load_pupil(drawn.folder).settings.draw_after == 6
    assert card.count("gn0 train sft …/suite --held-out ''") == 2  # a line a stage
    assert "somebody" not in card


def test_another_input_may_be_the_default_of_what_is_shipped(tmp_path: Path) -> None:
    views = PolicySettings(
        prompt="short", pictures=("rgb",), form=AnswerForm(layout="compact", points=0)
    )
    both = join_inputs({"views": views, "maps": SETTINGS})
    make_run(tmp_path / "run", build_pupil("nano", both, ["go to the sofa"], seed=2))
    before = tmp_path / "run" / "policy"
    with pytest.raises(ConfigError, match="no inputs 'sound'"):
        pack_policy(tmp_path / "run", tmp_path / "packed", default="sound")
    packed = pack_policy(tmp_path / "run", tmp_path / "packed", default="maps").folder
    settings = load_pupil(packed).settings
    assert (settings.input, list(settings.inputs)) == ("maps", ["views"])
    assert settings.pictures == ("near", "far") and settings.inputs["views"].pictures == ("rgb",)
    card = (packed / "README.md").read_text("utf-8")
    assert "input `maps`, the default | near, far; 13 points |" in card
    assert "what has no input in its name is of `views`" in card
    for name in ("views", "maps"):  # the same weights are asked the same
        assert settings.choose(name) == load_pupil(before).settings.choose(name)
    blind = PolicyBae(str(packed), backend="numpy", inputs="views")
    blind.reset_batch([0], ["go to the sofa"], [np.random.default_rng(0)])
    odd = Observation(0, 0.0, "", pose=Pose2D(0, 0, 0), rgb=np.zeros((9, 9, 3), np.uint8))
    with pytest.raises(PolicyError) as found:
        blind.act_batch([0], [odd])
    assert "inputs=maps needs no camera" in str(found.value.remedy)


def test_a_policy_that_travels_alone_takes_its_stages_along(run: Path, tmp_path: Path) -> None:
    """Its runs stay behind; whoever goes on from it elsewhere tells them again."""
    packed = pack_policy(run, tmp_path / "packed").folder
    again = pack_policy(packed, tmp_path / "again").folder
    third = tmp_path / "third"
    make_run(third, load_pupil(again), start=str(again), suites=["/home/somebody/houses"])
    card = (pack_policy(third, tmp_path / "shipped").folder / "README.md").read_text("utf-8")
    after = card[card.index("Stages before it") :]
    assert 0 < after.index("…/offices; 20 samples in 5 steps") < after.index("…/flats; 20 samples")
    assert card.count("gn0 train sft …/suite --held-out ''") == 3 and "somebody" not in card
    assert [one.stage for one in read_stages(tmp_path / "shipped")] == ["sft"] * 3


def test_a_run_tells_what_it_went_on_from_when_that_is_gone(run: Path, tmp_path: Path) -> None:
    """What it began from stayed on another machine, or another policy lies there by now."""
    start, third = tmp_path / "start", tmp_path / "third"
    start.symlink_to(pack_policy(run, tmp_path / "packed").folder)
    make_run(third, load_pupil(start), start=str(start), suites=["/home/somebody/houses"])
    write_stages(third / "policy", list_stages(third))  # as the end of training does
    start.unlink()
    for there in (None, third / "policy"):
        if there:
            start.symlink_to(there)
        shipped = pack_policy(third, tmp_path / "shipped", overwrite=True).folder
        told = [one.told.split(";")[0] for one in read_stages(shipped)]
        assert told == ["…/flats", "…/offices", "…/houses"]
        assert "…/flats; 20 samples" in (shipped / "README.md").read_text("utf-8")


@pytest.mark.parametrize("damaged", ["[", '[{"stage": 1}]', '{"a": []}', "[" * 100_000])
def test_stages_that_cannot_be_read_are_told(run: Path, tmp_path: Path, damaged: str) -> None:
    packed = pack_policy(run, tmp_path / "packed").folder
    (packed / "stages.json").write_text(damaged)
    with pytest.raises(FormatError, match="no list of stages") as caught:
        pack_policy(packed, tmp_path / "again")
    assert "stages.json" in caught.value.file


def test_the_card_has_a_row_of_walks_for_each_kind_of_missions(run: Path) -> None:
    found = {"episodes": 12, "SR": 0.25, "NE": 2.154, "cut_short": 0.5, "entropy": 0.25}
    found |= {"episodes_goal": 4, "SR_goal": 0.5, "NE_goal": 1.0, "SR_1m_goal": 0.125}
    card = build_card(run, load_pupil(run / "policy").settings, results=found)
    assert "| all | 12 | 25.0 | – | – | – | – | 2.15 | – | – | 50.0 |" in card
    assert "| goal | 4 | 50.0 | – | – | – | 12.5 | 1.00 | – | – | – |" in card
    assert "| entropy | 0.25 |" in card and "SR_goal" not in card


def test_what_is_too_large_or_no_policy_is_refused(run: Path, tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"takes \d+\.\d MB, at most 2 are shipped"):
        pack_policy(run, tmp_path / "packed", limit_mb=2)
    assert not (tmp_path / "packed").exists()
    with pytest.raises(CheckpointError, match="no such checkpoint"):
        pack_policy(tmp_path / "gone", tmp_path / "packed")
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes").touch()
    with pytest.raises(StorageError, match="something else"):
        pack_policy(run, tmp_path / "mine", overwrite=True)


def test_the_card_has_a_table_of_walks_of_this_very_policy(run: Path, tmp_path: Path) -> None:
    """A row all, a kind and a tier, with the interval over homes; of a control one row alone."""

    def walk(number: int) -> Walk:
        went = dict.fromkeys(("success", "success_straight", "success_near"), number % 4 > 0)
        shares = dict.fromkeys(("spl", "spl_straight", "spl_near"), 0.5)
        return Walk(
            episode=f"e{number}", scene=f"home-{number // 8}", path=f"p{number}",
            kind=("goal", "instruction/detailed")[number % 2], tier="", steps=20, stopped=True,
            length=5.0, shortest=4.0, left=1.0, left_straight=1.0, least=1.0, **went, **shares,
            oracle=True, forwards=10, cut_short=1, decisions=7,
        )  # fmt: skip

    own = digest_checkpoint(run / "policy")
    walks = [walk(number) for number in range(64)]
    for control in ("none", "shuffled"):
        about = WalksAbout(
            suite="flats", suite_hash="c0ffee", splits=("val_unseen",), episodes=64,
            episodes_hash="", left_out=0, checkpoint="", weights=own, control=control, executed=3,
            confirm_stop=False, agents=64, dtype="bfloat16", device="a card", version="0",
        )  # fmt: skip
        with open_walks(tmp_path / control, about) as kept:
            kept.add(walks)
            kept.finish([walk.episode for walk in walks])
    folders = [tmp_path / "none", tmp_path / "shuffled"]
    card = (pack_policy(run, tmp_path / "packed", walks=folders).folder / "README.md").read_text()
    rows = [line for line in card.splitlines() if line.startswith("| flats")]
    assert [row.split(" | ")[1] for row in rows] == ["all", "goal", "instruction/detailed", "all"]
    assert "64 | 8 | 75.0 [" in rows[0] and "shuffled" in rows[3]
    assert "| 32 | 8 | 50.0 [" in rows[1] and "| 32 | 8 | 100.0 [" in rows[2]
    with pytest.raises(TrainingError, match="walks of another policy"):
        build_walks_table(folders, "00ff")


def test_no_interval_of_a_card_is_below_nought_or_above_a_hundred(tmp_path: Path) -> None:
    rows = []
    for won in (1, 39):
        about = WalksAbout(
            suite="house", suite_hash="c0ffee", splits=(), episodes=40, episodes_hash="",
            left_out=0, checkpoint="", weights="00", control="none", executed=3,
            confirm_stop=False, agents=40, dtype="bfloat16", device="a card", version="0",
        )  # fmt: skip
        walks = [
            Walk(
                episode=f"e{number}", scene="home", path=f"p{number}", kind="goal", tier="",
                steps=20, stopped=True, success=number < won, success_straight=False,
                success_near=False, spl=0.0, spl_straight=0.0, spl_near=0.0, length=5.0,
                shortest=4.0, left=1.0, left_straight=1.0, least=1.0, oracle=True, forwards=10,
                cut_short=1, decisions=7,
            )
            for number in range(40)
        ]  # fmt: skip
        with open_walks(tmp_path / str(won), about) as kept:
            kept.add(walks)
            kept.finish([walk.episode for walk in walks])
        table = build_walks_table([tmp_path / str(won)])
        rows += [line for line in table.splitlines() if line.startswith("| house")][:1]
    assert "| 40 | 1 | 2.5 [0.0 to " in rows[0]
    assert "| 40 | 1 | 97.5 [" in rows[1] and " to 100.0]" in rows[1]
