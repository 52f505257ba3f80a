"""What a dataset says of its answers, and what `gn0 data prompt` shows of a sample."""

from __future__ import annotations

import msgspec
import pytest

from gn0.cli.main import main
from gn0.config import decode_json
from gn0.data.build import build_dataset
from gn0.data.codec import parse_answer
from gn0.data.dataset import open_dataset
from gn0.data.settings import BuildSettings, TokenSettings
from gn0.errors import ConfigError, FormatError
from gn0.policies.bae.prompt_fields import render_prompt, sample_answer, sample_state
from gn0.policies.bae.prompt_template import load_prompt


def test_a_dataset_says_its_order_and_older_ones_are_read_as_before(
    data_suite, labels_only, settings_of, tmp_path
) -> None:
    """Files that say nothing mean what was written then; the numbers are the same in both."""
    about = (labels_only.folder / "dataset.json").read_text()
    assert '"order"' not in about
    assert labels_only.about.settings.tokens.answer_order == "actions_first"
    assert TokenSettings(order="actions_first") == TokenSettings()
    assert b"order" not in msgspec.json.encode(BuildSettings())
    settings = msgspec.structs.replace(settings_of("none"), tokens=TokenSettings(order="paper"))
    other = build_dataset(data_suite, tmp_path / "d", settings)
    assert open_dataset(tmp_path / "d").about.settings.tokens.answer_order == "paper"
    assert [p.labels for p in other.about.parts] == [p.labels for p in labels_only.about.parts]
    assert [p.file for p in other.about.parts] == [p.file for p in labels_only.about.parts]
    with pytest.raises(FormatError):
        decode_json('{"order": "vlnce"}', TokenSettings)


def test_a_sample_is_asked_from_where_its_agent_stands(labels_only) -> None:
    template = load_prompt("short", pictures=("bev", "occupancy"), points=13)
    form = template.form()
    for name in labels_only.sampled:
        rows = labels_only.rows(name)
        for step in range(len(rows)):
            state = sample_state(labels_only, name, step)
            answer = sample_answer(labels_only, name, step, form)
            assert state.current == tuple(rows.pixels[step, 0].tolist()) == answer.tokens[0]
            assert answer.actions == tuple(rows.actions[step].tolist())
            assert form.read(form.write(answer), state.current) == answer
            assert (state.last_action is None) == (step == 0)
            if step:
                assert state.last_action == rows.executed[step - 1]
        assert labels_only.episode(name).instruction in render_prompt(template, state).text
    for step in (-1, len(rows)):
        with pytest.raises(ConfigError, match="no step"):
            sample_state(labels_only, name, step)


def test_the_verb_prints_pictures_prompt_and_answer(labels_only, capsys, tmp_path) -> None:
    folder = str(labels_only.folder)
    assert main(["data", "prompt", folder, "--prompt", "paper_planning"]) == 0
    text = capsys.readouterr().out
    assert text.splitlines()[0].endswith("step 0; pictures: rgb, history, bev, occupancy")
    answer = parse_answer(text.split("--- answer\n")[1], points=13, order="actions_first")
    assert f"CURRENT_PIXEL (normalized): (<{answer.tokens[0][0]}>,<" in text
    told = ["data", "prompt", folder, "--prompt", "short", "--answer-order", "paper"]
    told += ["--pictures", "bev", "--points", "13", "--step", "1", "--without", "heading"]
    assert main(told) == 0
    text = capsys.readouterr().out
    short = text.split("--- answer\n")[1]
    found = parse_answer(short, points=12, order="paper", layout="compact")
    assert found.tokens and "heading" not in text and "last <" in text
    mine = tmp_path / "mine.txt"
    mine.write_text("task: PLANNING\npictures: rgb\npoints: 0\nlayout: json\n---\n{WHERE}\n")
    assert main(["data", "prompt", folder, "--prompt", str(mine)]) == 2
    assert "line 6: no field 'WHERE'" in capsys.readouterr().err
    assert main(["data", "prompt", folder, "--prompt", "paper_planning", "--step", "999"]) == 2
    assert "no step 999" in capsys.readouterr().err
