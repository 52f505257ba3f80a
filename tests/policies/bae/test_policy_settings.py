"""`policy.json`: written and read alike, refused where it is odd, and held to its prompt."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest

from gn0.data.answer_form import AnswerForm
from gn0.data.codec import EgoFrame
from gn0.errors import CheckpointError, ConfigError
from gn0.policies.bae.policy_settings import (
    FILE,
    PolicySettings,
    load_policy_settings,
    save_policy_settings,
)
from gn0.policies.bae.prompt_template import FOLDER
from gn0.policies.qwen.layout import PictureSize

MAPS = PolicySettings(
    prompt="short",
    pictures=("rgb", "history", "near", "far"),
    form=AnswerForm(layout="compact"),
)


def test_settings_are_read_as_they_were_written(tmp_path: Path) -> None:
    written = save_policy_settings(tmp_path, MAPS)
    assert load_policy_settings(tmp_path) == written
    assert msgspec.structs.replace(written, prompt_digest="") == MAPS
    template = written.load_template(tmp_path)
    assert template.pictures == MAPS.pictures
    assert template.points == 13
    assert written.sensors(template) == ("rgb", "history", "ego_map", "pose")
    assert written.sizes["history"] == PictureSize(128, 128)  # 16 tiles of 32 px
    assert written.frame == EgoFrame(128, 0.06, 0.65)
    assert written.executed == 3


def test_what_is_switched_off_is_not_asked_for() -> None:
    views = PolicySettings(
        prompt="short", pictures=("rgb",), form=AnswerForm(points=0, layout="compact"),
        without=("heading",),
    )  # fmt: skip
    template = views.load_template()
    assert views.sensors(template) == ("rgb",)
    assert template.points == 0


def test_a_prompt_of_ones_own_lies_beside_the_weights(tmp_path: Path) -> None:
    text = (FOLDER / "short.txt").read_text().replace("heading {", "facing {")
    (tmp_path / "mine.txt").write_text(text)
    own = msgspec.structs.replace(MAPS, prompt=str(tmp_path / "mine.txt"))
    folder = tmp_path / "checkpoint"
    written = save_policy_settings(folder, own)
    assert written.prompt == "mine.txt"
    (tmp_path / "mine.txt").unlink()
    assert load_policy_settings(folder).load_template(folder).name == "mine"
    (folder / "mine.txt").write_text(text.replace("facing", "looking"))
    with pytest.raises(CheckpointError, match="was trained on"):
        written.load_template(folder)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"executed": 9}, "executed"),
        ({"surprise": 1}, "surprise"),
        ({"pictures": ["lidar"]}, "no picture 'lidar'"),
        ({"pictures": ["square_2"]}, "no picture 'square_2'"),
        ({"square": 2}, "square 2 of 2"),
        ({"preset": "huge"}, "no camera preset"),
        ({"prompt": "../mine.txt"}, "not a file in its folder"),
        ({"form": {"actions": 2}}, "3 of 2 actions"),
    ],
)
def test_odd_settings_are_refused_by_file(tmp_path: Path, changes: dict, said: str) -> None:
    save_policy_settings(tmp_path, MAPS)
    found = json.loads((tmp_path / FILE).read_text())
    (tmp_path / FILE).write_text(json.dumps(found | changes))
    with pytest.raises(CheckpointError, match=said) as caught:
        load_policy_settings(tmp_path)
    assert FILE in str(caught.value)


def test_no_settings_and_prompts_of_the_whole_map_are_refused(tmp_path: Path) -> None:
    with pytest.raises(CheckpointError, match=r"no policy\.json"):
        load_policy_settings(tmp_path)
    whole = PolicySettings(
        prompt="planning_maps", pictures=("near", "far"), form=AnswerForm(layout="json")
    )
    with pytest.raises(ConfigError, match="does not leave it open"):
        whole.load_template()
