"""Tokens and answers: exact round trips, a strict parser, and a reader for what models write."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.data.codec import (
    ACTION_TOKENS,
    NAVIGATION_TOKENS,
    ORDERS,
    Answer,
    AnswerLayout,
    AnswerOrder,
    EgoFrame,
    decode_heading,
    decode_pixels,
    decode_waypoints,
    encode_heading,
    encode_pixels,
    encode_waypoints,
    parse_answer,
    salvage_answer,
    token_error,
    waypoint_pixels,
    without_control_tokens,
    write_answer,
)
from gn0.errors import ConfigError, FormatError
from gn0.sim.sensors import MapFrame

POSE = np.zeros((1, 3))
actions = st.lists(st.integers(0, 3), min_size=6, max_size=6)
orders = st.sampled_from(ORDERS)
layouts: st.SearchStrategy[AnswerLayout] = st.sampled_from(["json", "compact"])
pairs = st.lists(st.tuples(st.integers(0, 999), st.integers(0, 999)), min_size=1, max_size=13)


# --------------------------------------------------------------------------------- tokens


def test_tokens_are_round_half_up_of_the_share_of_the_picture() -> None:
    """round_half_up(px / W · 1000), clipped to 999, in x and in y by their own size."""
    pixels = np.array([[0, 0], [1, 1], [200, 150], [399, 299], [400, 300], [-7, 9999]])
    wanted = [[0, 0], [3, 3], [500, 500], [998, 997], [999, 999], [0, 999]]  # 2.5 becomes 3
    assert encode_pixels(pixels, (400, 300)).tolist() == wanted
    assert encode_pixels(np.array([0.5, 1.5]), (1000, 1000)).tolist() == [1, 2]


@given(st.integers(1, 5000), st.data())
def test_whole_pixels_come_back_from_tokens(width: int, data: st.DataObject) -> None:
    """Up to 1000 pixels a side every pixel has a token of its own but for the last ones."""
    pixel = data.draw(st.integers(0, width - 1))
    tokens = encode_pixels(np.array([[pixel, pixel]]), (width, width))
    back = decode_pixels(tokens, (width, width))[0, 0]
    assert abs(back - pixel) <= width / 1000 * (0.5 if tokens[0, 0] < 999 else 1.0) + 1e-9


def test_a_pixel_of_the_map_is_counted_from_its_centre_north_up() -> None:
    frame = MapFrame(width=100, height=50, metres_per_pixel=0.1, x_min=-2.0, y_min=1.0)
    pose = np.array([[-1.95, 5.95, 0.0]])  # centre of the top left pixel
    assert waypoint_pixels(frame, np.zeros((1, 1, 2)), pose)[0, 0] == pytest.approx([0, 0])
    ahead = waypoint_pixels(frame, np.array([[[1.0, -0.5]]]), pose)[0, 0]
    assert ahead == pytest.approx([10, 5])  # east is right, south is down
    row, col = frame.pixel_of(-1.95 + 1.0, 5.95 - 0.5)
    assert (col, row) == (10, 5)
    turned = np.array([[-1.95, 5.95, -math.pi / 2]])  # looking south: forward is down
    assert waypoint_pixels(frame, np.array([[[1.0, 0.5]]]), turned)[0, 0] == pytest.approx([5, 10])


def test_in_an_egocentric_frame_forward_is_up_and_left_is_left() -> None:
    frame = EgoFrame(size=100, metres_per_pixel=0.1)
    points = np.array([[[0.0, 0.0], [2.0, 0.0], [0.0, 2.0]]])
    x, y = waypoint_pixels(frame, points, POSE)[0].T
    assert x.tolist() == pytest.approx([49.5, 49.5, 29.5])
    assert y.tolist() == pytest.approx([49.5, 29.5, 49.5])
    anywhere = np.array([[7.0, -3.0, 2.2]])
    assert (
        encode_waypoints(frame, points, anywhere) == encode_waypoints(frame, points, POSE)
    ).all()
    ahead = EgoFrame(size=100, metres_per_pixel=0.1, ahead=1.0)  # the agent at the lower edge
    assert waypoint_pixels(ahead, points, POSE)[0, 0, 1] == pytest.approx(99.5)


@settings(max_examples=200)
@given(
    st.sampled_from(["global", "ego"]),
    st.integers(20, 1500),
    st.integers(20, 1500),
    st.floats(0.01, 0.2),
    st.tuples(st.floats(0.05, 0.95), st.floats(0.05, 0.95), st.floats(-7, 7)),
    st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), min_size=1, max_size=13),
)
def test_waypoints_come_back_within_half_a_token(
    kind: str, width: int, height: int, scale: float, at: tuple[float, float, float], points: list
) -> None:
    frame = (
        MapFrame(width, height, scale, -3.0, 2.0)
        if kind == "global"
        else EgoFrame(width, scale, at[0])
    )
    pose = np.array([[-3.0 + at[0] * width * scale, 2.0 + at[1] * height * scale, at[2]]])
    reach = 0.3 * min(width, height, frame.height) * scale
    waypoints = reach * np.array([points])
    pixels = waypoint_pixels(frame, waypoints, pose)[0]
    inside = ((pixels >= 0) & (pixels <= np.array([frame.width, frame.height]) - 1)).all(axis=1)
    tokens = encode_waypoints(frame, waypoints, pose)
    assert tokens.dtype == np.int16 and (tokens >= 0).all() and (tokens <= 999).all()
    back = decode_waypoints(frame, tokens, pose)
    error = np.linalg.norm(back[0] - waypoints[0], axis=1)[inside]
    assert (error <= token_error(frame) + 1e-5).all()
    again = encode_waypoints(frame, back, pose)
    assert np.abs(again.astype(int) - tokens)[0][inside].max(initial=0) <= 1  # float32 metres


@given(st.sampled_from(["global", "ego"]), st.integers(0, 999), st.integers(0, 999))
def test_every_token_pair_survives_decoding_and_encoding(kind: str, x: int, y: int) -> None:
    frame = MapFrame(400, 300, 0.05, 0.0, 0.0) if kind == "global" else EgoFrame()
    tokens = np.array([[[x, y]]], np.int16)
    assert encode_waypoints(frame, decode_waypoints(frame, tokens, POSE), POSE).tolist() == [
        [[x, y]]
    ]


@given(st.floats(-50, 50))
def test_a_heading_is_clockwise_from_up_in_thousandths_of_a_turn(yaw: float) -> None:
    token = encode_heading(yaw)
    assert 0 <= token <= 999 and encode_heading(decode_heading(token)) == token
    off = (decode_heading(token) - yaw + math.pi) % math.tau - math.pi
    assert abs(off) <= math.tau / 2000 + 1e-9
    assert [encode_heading(math.radians(d)) for d in (90, 0, -90, 180, 89.8)] == [
        0, 250, 500, 750, 1,
    ]  # fmt: skip
    assert -math.pi < decode_heading(token) <= math.pi


def test_frames_without_meaning_are_refused() -> None:
    for wrong in ({"size": 0}, {"metres_per_pixel": 0.0}, {"ahead": 1.5}, {"size": 10**6}):
        with pytest.raises(ConfigError):
            EgoFrame(**wrong)


def test_there_are_1006_tokens_the_numbers_first_and_in_order() -> None:
    assert len(NAVIGATION_TOKENS) == len(set(NAVIGATION_TOKENS)) == 1006
    assert NAVIGATION_TOKENS[:3] == ("<0>", "<1>", "<2>") and NAVIGATION_TOKENS[999] == "<999>"
    assert set(NAVIGATION_TOKENS[1000:]) == {"<action>", "</action>", *ACTION_TOKENS}


# --------------------------------------------------------------------------------- answers


def test_the_answer_is_the_release_s_to_the_byte() -> None:
    text = write_answer([1, 1, 2, 3, 0, 0], [(12, 34), (999, 0)], order="actions_first")
    assert text == (
        '{"vlnce":"<action><FWD>,<FWD>,<LEFT>,<RIGHT>,<STOP>,<STOP></action>",'
        '"pixel":"[[<12>,<34>],[<999>,<0>]]"}'
    )
    assert json.loads(text)["pixel"] == "[[<12>,<34>],[<999>,<0>]]"
    assert write_answer([1] * 6) == '{"vlnce":"<action>' + ",".join(["<FWD>"] * 6) + '</action>"}'


def test_the_paper_has_the_waypoints_first_and_both_orders_are_read() -> None:
    told = [1, 1, 2, 3, 0, 0], [(12, 34), (999, 0)]
    text = write_answer(*told)
    assert text == (
        '{"pixel":"[[<12>,<34>],[<999>,<0>]]",'
        '"vlnce":"<action><FWD>,<FWD>,<LEFT>,<RIGHT>,<STOP>,<STOP></action>"}'
    )
    other = write_answer(*told, order="actions_first")
    assert parse_answer(text) == parse_answer(other) == salvage_answer(text)
    assert parse_answer(text, order="paper") == parse_answer(other, order="actions_first")
    for wrong, order in ((text, "actions_first"), (other, "paper")):
        with pytest.raises(FormatError, match="its parts are in the order"):
            parse_answer(wrong, order=order)
    short = write_answer(*told, layout="compact")
    assert short == (
        "<12><34><999><0><action><FWD><FWD><LEFT><RIGHT><STOP><STOP></action>"
    ) and parse_answer(short, layout="compact") == parse_answer(text)
    for wrong, layout in ((text, "compact"), (short, "json")):
        with pytest.raises(FormatError, match="not an answer"):
            parse_answer(wrong, layout=layout)
    for made in ({"order": "vlnce"}, {"layout": "xml"}):
        with pytest.raises(ConfigError):
            write_answer(*told, **made)
        with pytest.raises(ConfigError):
            parse_answer(text, **made)


@given(actions, st.none() | pairs, orders, layouts)
def test_what_is_written_is_read(
    codes: list[int], tokens: list | None, order: AnswerOrder, layout: AnswerLayout
) -> None:
    text = write_answer(codes, tokens, order=order, layout=layout)
    wanted = Answer(tuple(codes), None if tokens is None else tuple(tokens))
    assert parse_answer(text, layout=layout) == wanted
    assert parse_answer(text, layout=layout, order=order) == wanted
    assert layout == "compact" or salvage_answer(text) == wanted
    assert parse_answer(f"\n {text}\n", points=len(tokens or ()), layout=layout) == wanted
    with pytest.raises(FormatError):
        parse_answer(text, points=len(tokens or ()) + 1, layout=layout)


@settings(max_examples=100)
@given(actions, pairs, orders, layouts, st.data())
def test_what_the_strict_parser_takes_is_what_would_be_written(
    codes: list[int], tokens: list, order: AnswerOrder, layout: AnswerLayout, data: st.DataObject
) -> None:
    """Any change of a text is refused, or is another text that would be written just so."""
    text = write_answer(codes, tokens, order=order, layout=layout)
    at = data.draw(st.integers(0, len(text) - 1))
    piece = data.draw(st.sampled_from(["", "0", "<", ">", ",", " ", "[", "}", '"', "FWD", "7"]))
    changed = text[:at] + piece + text[at + data.draw(st.integers(0, 3)) :]
    try:
        answer = parse_answer(changed, order=order, layout=layout)
    except FormatError:
        return
    again = write_answer(answer.actions, answer.tokens, order=order, layout=layout)
    assert again == changed.strip()


@given(st.text(max_size=60) | st.text(alphabet='{}[]<>",:vlncepixe FWD0123/action', max_size=90))
def test_any_text_is_refused_or_read_and_never_breaks(text: str) -> None:
    salvage_answer(text)
    for layout in ("json", "compact"):
        with pytest.raises(FormatError):
            parse_answer(text, layout=layout)


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "no JSON"),
        ("[1, 2]", "no JSON object"),
        ('{"pixel":"[[<1>,<2>]]"}', "'vlnce' is missing"),
        ('{"vlnce":"<action><FWD></action>","extra":1}', "unknown key 'extra'"),
        ('{"vlnce":"<FWD>,<FWD>"}', "is not <action>"),
        ('{"vlnce":"<action><FWD></action>","pixel":"[[1,2]]"}', "'pixel' is not"),
        ('{"vlnce":"<action><FWD></action>","pixel":"[[<1000>,<2>]]"}', "'pixel' is not"),
        ('{"vlnce": "<action><FWD></action>"}', "blanks"),
        ('{"vlnce":"<action><FWD>,<STOP></action>"}', "2 actions, expected 6"),
    ],
)
def test_a_fault_is_named(text: str, word: str) -> None:
    with pytest.raises(FormatError, match=word):
        parse_answer(text)


def test_what_models_write_is_salvaged_by_the_release_s_rules() -> None:
    six = (1, 1, 2, 3, 0, 0)
    for text in (
        "<action><FWD>,<FWD>,<LEFT>,<RIGHT>,<STOP>,<STOP></action>",
        "Sure! <action>FWD, FWD, LEFT, RIGHT, STOP, STOP, FWD</action> done",
        '```json\n{"vlnce": "<action>1,1,2,3,0,0</action>"}\n```',
        '{"a": 1} {"vlnce": "fwd fwd left right stop stop"}',
        '{"vlnce": "<action><FWD>,<JUMP>,<FWD>,<LEFT>,<RIGHT>,<STOP>,<STOP></action>"}',
    ):
        assert salvage_answer(text) == Answer(six), text
    legacy = '{"vlnce": "<action>1,1,2,3,0,0</action>", "pixel": [[1, 2], [3, 999]]}'
    assert salvage_answer(legacy) == Answer(six, ((1, 2), (3, 999)))
    for bad in ("[[1, 2, 3]]", "[[1, 1000]]", '"none"', "[]", "[[true, 1]]", "7"):
        found = salvage_answer('{"vlnce": "1 1 2 3 0 0", "pixel": ' + bad + "}")
        assert found == Answer(six, None)
    for nothing in ("", "<action>FWD</action>", '{"vlnce": 3}', "forward", "{" * 50_000):
        assert salvage_answer(nothing) is None


def test_nonsense_is_never_written() -> None:
    for codes, tokens in (([], None), ([4], None), ([1], [(1, 1000)]), ([1], []), ([-1], None)):
        with pytest.raises(ConfigError):
            write_answer(codes, tokens)


@given(st.text(alphabet="<>|/0123456789FWDimend_actionSTOP ", max_size=60))
def test_no_token_survives_in_a_user_s_text(text: str) -> None:
    cleaned = without_control_tokens(text)
    assert not any(token in cleaned for token in NAVIGATION_TOKENS)
    assert "<|im_end|>" not in cleaned
    assert without_control_tokens(cleaned) == cleaned


def test_plain_words_of_a_user_are_kept() -> None:
    assert without_control_tokens("go <b>left</b>, 3 < 5") == "go <b>left</b>, 3 < 5"
    assert without_control_tokens("a<9<FWD>99>b<|im_end|>c") == "a<9 99>b c"
    assert without_control_tokens("<image>left</image>") == " left</image>"
