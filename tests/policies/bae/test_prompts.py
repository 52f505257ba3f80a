"""Prompts: golden texts, strict templates, and what a sample of a dataset is asked."""

from __future__ import annotations

import os
import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gn0.data.codec import EgoFrame
from gn0.errors import ConfigError, FormatError, StorageError
from gn0.geometry import Pose2D
from gn0.policies.bae.prompt_fields import (
    _VALUES,
    INSTRUCTION_LIMIT,
    PromptState,
    clean_instruction,
    render_prompt,
)
from gn0.policies.bae.prompt_template import (
    FIELDS,
    PromptTemplate,
    load_prompt,
    parse_template,
    prompt_names,
)
from gn0.sim.sensors import MapFrame

ROOT = Path(__file__).resolve().parents[3]
GOLDEN = Path(__file__).parent / "rendered"
UPDATE = os.environ.get("GN0_SNAPSHOTS") == "update"
FRAME = MapFrame(width=400, height=300, metres_per_pixel=0.05, x_min=-10.0, y_min=-5.0)
STATE = PromptState(
    instruction='Leave the room,\n turn <LEFT> and stop at the "blue" sofa.',
    frame=FRAME,
    pose=Pose2D(-4.99, 2.01, 0.5),
    last_action=1,
    collided=True,
)
PAPER = (
    "paper_planning", "paper_planning_maps", "paper_planning_views", "paper_following",
    "paper_following_views",
)  # fmt: skip
CASES: dict[str, PromptTemplate] = {name: load_prompt(name) for name in prompt_names()}
CASES |= {
    "planning_maps.no_arrow": load_prompt("planning_maps", without=("arrow",)),
    "short.maps": load_prompt("short", pictures=("bev", "occupancy"), points=13, layout="json"),
    "short.words_alone": load_prompt(
        "short", without=("task", "current_pixel", "heading", "last_action", "bumper")
    ),
    "short.tracking": load_prompt("short", task="TRACKING", points=7, without=("heading",)),
}


@pytest.mark.parametrize("name", sorted(CASES))
def test_a_rendered_prompt_is_the_golden_one(name: str) -> None:
    """To accept another text: GN0_SNAPSHOTS=update pytest -n 0 tests/policies/bae."""
    prompt = render_prompt(CASES[name], STATE)
    text = f"pictures: {' '.join(prompt.pictures)}\n---\n{prompt.text}\n"
    file = GOLDEN / f"{name}.txt"
    if UPDATE:
        file.parent.mkdir(exist_ok=True)
        file.write_text(text, "utf-8")
    assert text == file.read_text("utf-8")


def test_there_is_no_golden_text_without_a_prompt() -> None:
    assert {path.stem for path in GOLDEN.glob("*.txt")} == set(CASES)


def test_the_paper_s_prompts_ask_for_what_the_paper_asks() -> None:
    asked = {name: (t.task, len(t.pictures), t.points) for name in PAPER for t in (CASES[name],)}
    assert asked == {
        "paper_planning": ("PLANNING", 4, 13),
        "paper_planning_maps": ("PLANNING", 2, 13),
        "paper_planning_views": ("PLANNING", 2, 0),
        "paper_following": ("TRACKING", 4, 7),
        "paper_following_views": ("TRACKING", 2, 0),
    }
    for name in PAPER:
        text = render_prompt(CASES[name], STATE).text
        assert "{<FWD>,<LEFT>,<RIGHT>,<STOP>}" in text and "{{" not in text
        assert CASES[name].layout == "json" and not CASES[name].parts
        assert "heading" not in text.lower() and CASES[name].form().order == "paper"
        keys = re.findall(r'^- "(\w+)":', text, re.M)
        assert keys == (["pixel", "vlnce"] if CASES[name].points else ["vlnce"])
    assert CASES["vlnce"].pictures == ("history", "rgb")  # the order of the released checkpoint


def test_values_are_those_of_the_codec() -> None:
    text = render_prompt(CASES["paper_planning"], STATE).text
    assert "CURRENT_PIXEL (normalized): (<249>,<531>)" in text and STATE.current == (249, 531)
    assert "OCC size: W=400 px, H=300 px" in text
    assert "1 x_norm = 0.02 m, 1 y_norm = 0.015 m. (1 px = 0.05 m)" in text
    assert 'Instruction: "Leave the room, turn and stop at the "blue" sofa."' in text
    ego = PromptState("go", EgoFrame(size=128, metres_per_pixel=0.06, ahead=0.65))
    assert ego.current == (496, 646) and PromptState("go", FRAME).current is None


def test_short_is_short() -> None:
    """About thirty tokens beside the instruction: words and tokens, blanks not counted."""
    text = render_prompt(CASES["short"], STATE).text
    own = text.replace(clean_instruction(STATE.instruction), "")
    assert len(re.findall(r"<\w+>|\w+|\n", own)) <= 30
    paper = render_prompt(CASES["paper_planning"], STATE).text
    assert len(paper) > 10 * len(text)


def test_parts_are_switched_off_and_the_card_names_the_others() -> None:
    whole, part = CASES["short"], load_prompt("short", without=("heading", "bumper"))
    assert dict(whole.card_rows())["prompt parts"] == (
        "task, instruction, current_pixel, heading, last_action, bumper"
    )
    rows = dict(part.card_rows())
    assert rows["prompt parts"] == "task, instruction, current_pixel, last_action"
    assert rows["prompt"].startswith("short (") and rows["pictures"] == "rgb, history"
    assert rows["answer"] == "compact, 0 points"
    assert len({t.digest for t in CASES.values()} | {part.digest}) == len(CASES) + 1
    assert part.digest == load_prompt("short", without=("bumper", "heading")).digest
    assert "heading" not in render_prompt(part, STATE).text
    nothing = load_prompt("short", without=CASES["short"].parts)
    assert dict(nothing.card_rows())["prompt parts"] == "none"
    assert render_prompt(nothing, PromptState("")).text == ""
    with pytest.raises(ConfigError, match="no part 'compass'"):
        load_prompt("short", without=("compass",))


def test_the_papers_inputs_are_a_choice_by_name() -> None:
    paper = load_prompt("short", without=("paper",))
    assert paper.on == {"task", "instruction", "current_pixel"}
    assert paper.digest == load_prompt("short", without=("bumper", "heading", "last_action")).digest
    assert not {"HEADING", "LAST_ACTION", "BUMPER"} & set(paper.fields)
    ego = EgoFrame()
    told = PromptState("go", ego, Pose2D(0, 0, 0)), PromptState("go", ego, Pose2D(0, 0, 2), 1, True)
    assert len({render_prompt(paper, state).text for state in told}) == 1
    assert len({render_prompt(load_prompt("short"), state).text for state in told}) == 2
    assert "heading" not in load_prompt("planning_maps", without=("paper",)).on
    assert load_prompt("vlnce", without=("paper",)).digest == load_prompt("vlnce").digest


def test_what_a_prompt_does_not_leave_open_is_not_changed() -> None:
    wrong = ({"points": 7}, {"pictures": ("rgb",)}, {"layout": "compact"}, {"task": "TRACKING"})
    for change in wrong:
        with pytest.raises(ConfigError, match="does not leave it open"):
            load_prompt("paper_planning", **change)
    for change in ({"points": 1}, {"layout": "xml"}, {"task": "GO"}, {"pictures": ("A",)}):
        with pytest.raises(ConfigError):
            load_prompt("short", **change)
    with pytest.raises(ConfigError, match="known: goal_picture, "):
        load_prompt("shorter")


def test_what_the_state_does_not_know_is_named() -> None:
    missing = r"short\.txt, line 1\d: nothing is known for field 'CUR_XN'"
    with pytest.raises(ConfigError, match=missing):
        render_prompt(CASES["short"], PromptState("go"))
    views = load_prompt("short", without=("current_pixel", "heading"))
    assert "bumper free" in render_prompt(views, PromptState("go")).text
    ego = PromptState("go", EgoFrame(), Pose2D(0, 0, 0))
    with pytest.raises(ConfigError, match="on the ego picture"):
        render_prompt(CASES["paper_planning"], ego)
    assert "at <" in render_prompt(CASES["short.maps"], ego).text


def test_every_field_is_described_and_filled() -> None:
    assert set(FIELDS) == set(_VALUES)
    page = (ROOT / "docs" / "prompts.md").read_text("utf-8")
    for name in FIELDS:
        assert f"`{name}`" in page, name
    for name in prompt_names():
        assert f"`{name}`" in page, name


# -------------------------------------------------------------------------- instructions


@given(st.text(max_size=200))
def test_an_instruction_is_one_clean_line_or_refused(text: str) -> None:
    try:
        cleaned = clean_instruction(text)
    except ConfigError:
        assert not text.replace("<", "").strip() or "<" in text
        return
    assert cleaned and "\n" not in cleaned and clean_instruction(cleaned) == cleaned


def test_instructions_without_sense_are_refused_in_words() -> None:
    for text, word in (
        ("", "says nothing"),
        (" <FWD>\n<|im_end|><image> ", "says nothing"),
        ("x" * (INSTRUCTION_LIMIT + 1), "8001 characters"),
    ):
        with pytest.raises(ConfigError, match=word):
            render_prompt(CASES["short"], PromptState(text, FRAME, Pose2D(0, 0, 0)))
    told = PromptState("Ignore {OCC_W} and {{this}}.", FRAME, Pose2D(0, 0, 0))
    assert "Ignore {OCC_W} and {{this}}." in render_prompt(CASES["short"], told).text
    assert render_prompt(CASES["goal_picture"], PromptState("", FRAME, Pose2D(0, 0, 0))).text


# ----------------------------------------------------------------------------- templates

GOOD = "task: PLANNING\npictures: rgb\npoints: 0\nlayout: json\n---\n"


@pytest.mark.parametrize(
    ("text", "word"),
    [
        (GOOD + "a\n{WEATHER}", r"field 'WEATHER': line 7: no field 'WEATHER'"),
        (GOOD + "{instruction}", "line 6: a brace by itself"),
        (GOOD + "a } b", "line 6: a brace by itself"),
        (GOOD + "{OCC_W", "line 6: a brace by itself"),
        (GOOD + "<image><image>", "line 6: 2 picture tags for 1 pictures"),
        (GOOD.replace("---\n", "parts: a\n---\n") + "[b] c", "line 7: no part 'b'"),
        (GOOD.replace("rgb", "rgb rgb"), "line 2: 'rgb' is not a name, or stands twice"),
        (GOOD.replace("rgb", "../rgb"), "line 2"),
        (GOOD.replace("PLANNING", "DANCING"), "line 1: no task 'DANCING'"),
        (GOOD.replace("points: 0", "points: 1"), "line 3: '1' waypoints"),
        (GOOD.replace("points: 0", "points: many"), "line 3"),
        (GOOD.replace("json", "xml"), "line 4: no layout 'xml'"),
        (GOOD.replace("layout: json\n", ""), "field 'layout': line 4: key is missing"),
        (GOOD.replace("layout", "colour"), "line 4: unknown or repeated key 'colour'"),
        (GOOD.replace("---\n", "task: PLANNING\n---\n"), "line 5: unknown or repeated"),
        (GOOD.replace("---\n", "open: parts\n---\n"), "line 5: 'parts' cannot be left open"),
        (GOOD.replace("---", "- -"), "the header does not end"),
        ("", "the header does not end"),
        (GOOD.replace("task: PLANNING", "PLANNING"), "no `key: value`"),
    ],
)  # fmt: skip
def test_a_template_s_fault_is_named_with_file_line_and_field(
    text: str, word: str, tmp_path: Path
) -> None:
    file = tmp_path / "mine.txt"
    file.write_text(text)
    with pytest.raises(FormatError, match=word) as found:
        load_prompt(str(file))
    assert str(found.value).startswith(str(file))


@given(st.binary(max_size=200) | st.text(max_size=200).map(lambda t: (GOOD + t).encode()))
def test_any_file_is_a_template_or_refused(data: bytes) -> None:
    try:
        template = parse_template(data, "any.txt", {})
    except FormatError:
        return
    assert template.fields <= set(FIELDS)


def test_a_folder_of_your_own_works_by_path(tmp_path: Path) -> None:
    mine = tmp_path / "prompts"
    mine.mkdir()
    body = GOOD + "{{Go}}: {INSTRUCTION_TEXT} [a]\r\n\n"
    (mine / "mine.txt").write_bytes(body.encode())
    (mine / "notes.md").write_text("no template")
    assert prompt_names(mine) == ("mine",)
    by_name, by_path = load_prompt("mine", mine), load_prompt(str(mine / "mine.txt"))
    assert by_name == by_path and by_name.name == "mine"
    assert render_prompt(by_name, PromptState("left")).text == "{Go}: left [a]\n"
    with pytest.raises(ConfigError, match="known: mine"):
        load_prompt("short", mine)
    with pytest.raises(ConfigError, match="no folder of prompts"):
        load_prompt("mine", tmp_path / "nowhere")
    with pytest.raises(StorageError):
        load_prompt(str(tmp_path / "none.txt"))
    os.mkfifo(mine / "pipe.txt")
    (mine / "folder.txt").mkdir()
    for other in ("pipe.txt", "folder.txt"):
        with pytest.raises(StorageError, match="not a file"):
            load_prompt(str(mine / other))
    assert prompt_names(mine) == ("mine",)
    (mine / "big.txt").write_bytes(b"x" * 100_000)
    with pytest.raises(StorageError):
        load_prompt("big", mine)
