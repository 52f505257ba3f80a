"""Labels as the model writes them: map tokens, action tokens, and the answer text.

A waypoint is two tokens `<0>` … `<999>`: its pixel on a map picture over the picture's size, times
1000, rounded half up and clipped to 999 (paper, trajectory tokenisation and prompts). The picture
is the whole map (`sim.sensors.MapFrame`), or a square around the agent that turns with it
(`EgoFrame`). Pixel coordinates count from the centre of the first pixel, as the official release
counts them, so a waypoint at a pixel's centre gets exactly the release's tokens.

An answer is one JSON object on one line, its keys in the paper's order or actions first:

    {"pixel":"[[<12>,<34>],…]","vlnce":"<action><FWD>,<LEFT>,<STOP>,<STOP>,<STOP>,<STOP></action>"}

or, for models trained from scratch, the same tokens with nothing between them (`compact`):

    <12><34>…<action><FWD><LEFT><STOP><STOP><STOP><STOP></action>

`parse_answer` is strict: what it accepts, `write_answer` writes byte for byte. `salvage_answer`
reads what a model meant, by the release's rules. What an answer must hold, slot by slot, is in
`answer_form.py`; the same in the ids of a tokenizer in `answer_slots.py`.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gn0.errors import ConfigError, FormatError
from gn0.geometry import F32, F64
from gn0.paper import ACTIONS_AHEAD, MAP_BINS
from gn0.sim.sensors import MapFrame

ACTION_TOKENS = ("<STOP>", "<FWD>", "<LEFT>", "<RIGHT>")  # in the order of their codes
ACTION_BEGIN, ACTION_END = "<action>", "</action>"
ANSWER_LENGTH = 16_384  # characters that are looked at; a whole answer has about 400
NAVIGATION_TOKENS = (
    *(f"<{n}>" for n in range(MAP_BINS)),
    *(ACTION_BEGIN, ACTION_END, "<FWD>", "<LEFT>", "<RIGHT>", "<STOP>"),
)
"""The 1006 tokens a model learns, the numbers first and without gaps."""

AnswerOrder = Literal["paper", "actions_first"]
"""Which key comes first: `pixel` as in the paper's prompts (l. 1799), or `vlnce` (earlier exit)."""

AnswerLayout = Literal["compact", "json"]
ORDERS: tuple[AnswerOrder, ...] = ("paper", "actions_first")

I16 = NDArray[np.int16]
_CODE_OF = {token: code for code, token in enumerate(ACTION_TOKENS)}
_NUMBER = "(?:0|[1-9][0-9]{0,2})"
_PAIR = re.compile(rf"<({_NUMBER})>,?<({_NUMBER})>")
_ACTIONS = "<(?:FWD|LEFT|RIGHT|STOP)>"
_SPOKEN = rf"<action>({_ACTIONS}(?:,{_ACTIONS})*)</action>"
_POINTS = rf"\[((?:\[<{_NUMBER}>,<{_NUMBER}>\])(?:,\[<{_NUMBER}>,<{_NUMBER}>\])*)\]"
_SHORT_SPOKEN = rf"<action>((?:{_ACTIONS})+)</action>"
_SHORT_POINTS = rf"((?:<{_NUMBER}><{_NUMBER}>)*)"
# by layout and order: the pattern, and which of its groups are the actions and the points
_STRICT: dict[tuple[AnswerLayout, AnswerOrder], tuple[re.Pattern[str], int, int]] = {
    ("json", "paper"): (
        re.compile(rf'\{{(?:"pixel":"{_POINTS}",)?"vlnce":"{_SPOKEN}"\}}'), 2, 1,
    ),
    ("json", "actions_first"): (
        re.compile(rf'\{{"vlnce":"{_SPOKEN}"(?:,"pixel":"{_POINTS}")?\}}'), 1, 2,
    ),
    ("compact", "paper"): (re.compile(_SHORT_POINTS + _SHORT_SPOKEN), 2, 1),
    ("compact", "actions_first"): (re.compile(_SHORT_SPOKEN + _SHORT_POINTS), 1, 2),
}  # fmt: skip
_EXAMPLE: dict[AnswerOrder, str] = {
    "paper": '{"pixel":…,"vlnce":…}',
    "actions_first": '{"vlnce":…,"pixel":…}',
}
_CONTROL = re.compile(r"<(?:[0-9]{1,3}|/?action|FWD|LEFT|RIGHT|STOP|image|video|\|[^<>|\s]*\|)>")


@dataclass(frozen=True)
class EgoFrame:
    """A square map picture around the agent that turns with it: its heading is up.

    Attributes:
        size: width and height [px].
        metres_per_pixel: scale [m].
        ahead: where the agent stands: the share of the picture that lies before it, 0.5 the middle.
    """

    size: int = 224
    metres_per_pixel: float = 0.05
    ahead: float = 0.5

    def __post_init__(self) -> None:
        if not (1 <= self.size <= 65536 and self.metres_per_pixel > 0 and 0 <= self.ahead <= 1):
            raise ConfigError(
                f"picture of {self.size} px at {self.metres_per_pixel} m, {self.ahead} ahead",
                remedy="give a positive size and scale, and a share of 0 to 1",
            )

    @property
    def width(self) -> int:
        """Width [px]."""
        return self.size

    @property
    def height(self) -> int:
        """Height [px]."""
        return self.size


AnyFrame = MapFrame | EgoFrame


def _to_world(waypoints: NDArray[np.floating], poses: NDArray[np.floating]) -> F64:
    c, s = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
    x, y = waypoints[..., 0].astype(np.float64), waypoints[..., 1].astype(np.float64)
    return np.stack([poses[:, :1] + c * x - s * y, poses[:, 1:2] + s * x + c * y], axis=-1)


def _to_agent(places: F64, poses: NDArray[np.floating]) -> F64:
    c, s = np.cos(poses[:, 2])[:, None], np.sin(poses[:, 2])[:, None]
    x, y = places[..., 0] - poses[:, :1], places[..., 1] - poses[:, 1:2]
    return np.stack([c * x + s * y, -s * x + c * y], axis=-1)


def waypoint_pixels(
    frame: AnyFrame, waypoints: NDArray[np.floating], poses: NDArray[np.floating]
) -> F64:
    """Picture coordinates (x to the right, y down) [N, K, 2] px of waypoints, not rounded.

    Whole numbers are the centres of pixels; (0, 0) is the first of the top row.

    Args:
        frame: the map picture.
        waypoints: [N, K, 2] m in each agent's frame.
        poses: [N, 3] x, y [m], yaw [rad]; an `EgoFrame` does not read them.
    """
    s = frame.metres_per_pixel
    if isinstance(frame, EgoFrame):
        w = np.asarray(waypoints, np.float64)
        return np.stack(
            [
                0.5 * frame.size - w[..., 1] / s - 0.5,
                frame.ahead * frame.size - w[..., 0] / s - 0.5,
            ],
            axis=-1,
        )
    world = _to_world(np.asarray(waypoints), np.asarray(poses, np.float64).reshape(-1, 3))
    right = (world[..., 0] - frame.x_min) / s - 0.5
    down = frame.height - (world[..., 1] - frame.y_min) / s - 0.5
    return np.stack([right, down], axis=-1)


def encode_pixels(pixels: NDArray[np.floating], size: tuple[int, int]) -> I16:
    """Map tokens [..., 2] of picture coordinates [..., 2] px: round half up of px/size · 1000.

    Clipped to 0 … 999, as what lies outside the picture must be.

    Args:
        pixels: (x, y).
        size: (width, height) [px].
    """
    scaled = np.asarray(pixels, np.float64) / np.array(size, np.float64) * MAP_BINS
    return np.clip(np.floor(scaled + 0.5), 0, MAP_BINS - 1).astype(np.int16)


def decode_pixels(tokens: NDArray[np.integer], size: tuple[int, int]) -> F64:
    """Picture coordinates [..., 2] px of map tokens, not rounded to pixels."""
    return np.asarray(tokens, np.float64) / MAP_BINS * np.array(size, np.float64)


def encode_waypoints(
    frame: AnyFrame, waypoints: NDArray[np.floating], poses: NDArray[np.floating]
) -> I16:
    """Map tokens [N, K, 2] (x, y) of waypoints; see `waypoint_pixels` and `encode_pixels`."""
    pixels = waypoint_pixels(frame, waypoints, poses)
    return encode_pixels(pixels, (frame.width, frame.height))


def decode_waypoints(
    frame: AnyFrame, tokens: NDArray[np.integer], poses: NDArray[np.floating]
) -> F32:
    """Waypoints [N, K, 2] m in each agent's frame, of map tokens [N, K, 2].

    Off by at most half a token in x and in y where the waypoint lay on the picture.
    """
    s = frame.metres_per_pixel
    pixels = decode_pixels(tokens, (frame.width, frame.height))
    if isinstance(frame, EgoFrame):
        left = (0.5 * frame.size - 0.5 - pixels[..., 0]) * s
        forward = (frame.ahead * frame.size - 0.5 - pixels[..., 1]) * s
        return np.stack([forward, left], axis=-1).astype(np.float32)
    x = frame.x_min + (pixels[..., 0] + 0.5) * s
    y = frame.y_min + (frame.height - 0.5 - pixels[..., 1]) * s
    at = np.asarray(poses, np.float64).reshape(-1, 3)
    return _to_agent(np.stack([x, y], axis=-1), at).astype(np.float32)


def encode_heading(yaw: float) -> int:
    """The token 0 … 999 of a heading: turned clockwise from up (+y) on a map picture.

    In thousandths of a full turn, rounded half up: 0 up (north), 250 right, 500 down, 750 left.

    Args:
        yaw: [rad], world frame: 0 is +x (right), counter-clockwise.
    """
    share = (0.25 - float(yaw) / math.tau) % 1.0
    return math.floor(share * MAP_BINS + 0.5) % MAP_BINS


def decode_heading(token: int) -> float:
    """The yaw [rad] in (−π, π] of a heading's token."""
    yaw = (0.25 - token / MAP_BINS) * math.tau
    return yaw if yaw > -math.pi else yaw + math.tau


def token_error(frame: AnyFrame) -> float:
    """The most that tokens can put a waypoint wrong [m], where it lies on the picture.

    Half a token in x and in y; at the picture's edge, where tokens are clipped, a whole token or
    half a pixel.
    """
    worst = [max(size / MAP_BINS, 0.5) for size in (frame.width, frame.height)]
    return frame.metres_per_pixel * math.hypot(*worst)


# ------------------------------------------------------------------------------ text


@dataclass(frozen=True)
class Answer:
    """What a model says: actions, and map tokens of waypoints where it was asked for them.

    Attributes:
        actions: codes 0 STOP, 1 FORWARD, 2 LEFT, 3 RIGHT.
        tokens: (x, y) pairs 0 … 999, or None.
    """

    actions: tuple[int, ...]
    tokens: tuple[tuple[int, int], ...] | None = None


def write_answer(
    actions: Sequence[int] | NDArray[np.integer],
    tokens: Sequence[Sequence[int]] | NDArray[np.integer] | None = None,
    *,
    order: AnswerOrder = "paper",
    layout: AnswerLayout = "json",
) -> str:
    """The answer text of actions, and of map tokens [K, 2] where the task has waypoints.

    Args:
        actions: codes 0 STOP, 1 FORWARD, 2 LEFT, 3 RIGHT.
        tokens: (x, y) pairs 0 … 999, or None.
        order: what comes first, the waypoints (paper) or the actions.
        layout: JSON, or the tokens alone.

    Raises:
        ConfigError: no action, no code of one, a token outside 0 … 999, or no such order or layout.
    """
    _check_kind(layout, order)
    codes = [int(code) for code in actions]
    if not codes or not all(0 <= code < len(ACTION_TOKENS) for code in codes):
        raise ConfigError(f"invalid action codes {codes}", remedy="give codes 0 to 3")
    words = [ACTION_TOKENS[code] for code in codes]
    pairs = None if tokens is None else [(int(x), int(y)) for x, y in tokens]
    if pairs is not None and not (pairs and all(0 <= v < MAP_BINS for p in pairs for v in p)):
        raise ConfigError(f"invalid map tokens {pairs}", remedy="give pairs of 0 to 999")
    if layout == "compact":
        parts = [ACTION_BEGIN + "".join(words) + ACTION_END]
        if pairs:
            parts.insert(0, "".join(f"<{x}><{y}>" for x, y in pairs))
    else:
        parts = [f'"vlnce":"{ACTION_BEGIN}{",".join(words)}{ACTION_END}"']
        if pairs:
            parts.insert(0, '"pixel":"[' + ",".join(f"[<{x}>,<{y}>]" for x, y in pairs) + ']"')
    if order == "actions_first":
        parts.reverse()
    return "".join(parts) if layout == "compact" else "{" + ",".join(parts) + "}"


def _check_kind(layout: AnswerLayout, order: AnswerOrder) -> None:
    if (layout, order) not in _STRICT:
        raise ConfigError(
            f"no answer layout {layout!r} in the order {order!r}",
            remedy="give json or compact; paper or actions_first",
        )


def parse_answer(
    text: str,
    *,
    points: int | None = None,
    actions: int = ACTIONS_AHEAD,
    order: AnswerOrder | None = None,
    layout: AnswerLayout = "json",
) -> Answer:
    """Read an answer, strictly: exactly what `write_answer` writes.

    Args:
        text: the answer; white space around it is forgiven, nothing else.
        points: how many waypoints there must be, 0 for none; None takes any number.
        actions: how many actions there must be.
        order: the order that it must have; None takes both.
        layout: the layout that it must have.

    Raises:
        FormatError: it is anything else; says what.
        ConfigError: no such order or layout.
    """
    _check_kind(layout, order or "paper")
    bare = text.strip(" \t\r\n")
    for own in ORDERS if order is None else (order,):
        pattern, spoken, way = _STRICT[layout, own]
        match = pattern.fullmatch(bare)
        if match is not None:
            break
    else:
        raise FormatError(
            "not an answer: " + _fault(bare, layout, order),
            field=_shorten(text),
            remedy="see docs/labels.md",
        )
    codes = tuple(_CODE_OF[token] for token in re.findall(_ACTIONS, match[spoken]))
    if len(codes) != actions:
        raise FormatError(
            f"{len(codes)} actions, expected {actions}", field="vlnce", remedy="see docs/labels.md"
        )
    tokens = None
    if match[way]:
        tokens = tuple((int(x), int(y)) for x, y in _PAIR.findall(match[way]))
    if points is not None and points != len(tokens or ()):
        raise FormatError(
            f"{len(tokens or ())} waypoints, expected {points}",
            field="pixel",
            remedy="see docs/labels.md",
        )
    return Answer(codes, tokens)


def salvage_answer(text: str, *, actions: int = ACTIONS_AHEAD) -> Answer | None:
    """What a model meant, by the rules of the official release; None when that cannot be said.

    The first JSON object with a text "vlnce" counts, else the first bare <action> … </action>.
    Actions are tokens, their bare names, or the digits 0 to 3; unknown ones are dropped, at least
    `actions` must be left and the first of them are kept. Waypoints are pairs of map tokens, or of
    whole numbers; what is no pair of 0 … 999 makes them None.
    """
    spoken, pixel = _find_parts(text[:ANSWER_LENGTH])
    if spoken is None:
        return None
    spoken = re.sub("</?action>", " ", spoken)
    names = {token.strip("<>"): code for token, code in _CODE_OF.items()}
    words = re.findall(r"[A-Za-z]+|[0-9]+", spoken)
    codes = [names.get(w.upper(), "0123".find(w) if len(w) == 1 else -1) for w in words]
    kept = [code for code in codes if code >= 0][:actions]
    if len(kept) < actions:
        return None
    return Answer(tuple(kept), _read_pairs(pixel))


def _find_parts(text: str) -> tuple[str | None, Any]:
    decoder = json.JSONDecoder()
    for match in re.finditer(r"\{", text):
        try:
            value, _ = decoder.raw_decode(text, match.start())
        except (ValueError, RecursionError):
            continue
        if isinstance(value, dict) and isinstance(value.get("vlnce"), str):
            return value["vlnce"], value.get("pixel")
    bare = re.search("<action>(.*?)</action>", text, re.DOTALL)
    return (bare[1] if bare else None), None


def _read_pairs(pixel: Any) -> tuple[tuple[int, int], ...] | None:
    if isinstance(pixel, str):
        try:
            pixel = json.loads(re.sub(r"<([0-9]{1,3})>", r"\1", pixel))
        except (ValueError, RecursionError):
            return None
    if not isinstance(pixel, list) or not pixel:
        return None
    pairs = []
    for pair in pixel:
        if not (isinstance(pair, list) and len(pair) == 2):
            return None
        x, y = pair
        if (
            type(x) is not int
            or type(y) is not int
            or not (0 <= x < MAP_BINS and 0 <= y < MAP_BINS)
        ):
            return None
        pairs.append((x, y))
    return tuple(pairs)


def _shorten(text: str) -> str:
    return text if len(text) <= 60 else text[:57] + "…"


def _fault(text: str, layout: AnswerLayout, order: AnswerOrder | None) -> str:
    """In words, the first thing that is wrong with a text that is no answer."""
    if order is not None:
        other = ORDERS[1 - ORDERS.index(order)]
        if _STRICT[layout, other][0].fullmatch(text):
            return f"its parts are in the order {other!r}, expected {order!r}"
    if layout == "compact":
        return "it is not pairs of <0> to <999> beside <action>…</action>, nothing between them"
    try:
        value = json.loads(text)
    except (ValueError, RecursionError) as error:
        return f"no JSON ({error})"
    if not isinstance(value, dict):
        return "no JSON object"
    unknown = sorted(set(map(str, value)) - {"vlnce", "pixel"})
    if unknown or "vlnce" not in value:
        return f"unknown key {_shorten(unknown[0])!r}" if unknown else "key 'vlnce' is missing"
    if re.fullmatch(_SPOKEN, str(value["vlnce"])) is None:
        return "'vlnce' is not <action>…</action> around <FWD>, <LEFT>, <RIGHT>, <STOP> and commas"
    if "pixel" in value and re.fullmatch(_POINTS, str(value["pixel"])) is None:
        return "'pixel' is not [[<x>,<y>],…] with tokens <0> to <999>"
    return f"blanks, escapes or keys differ from {_EXAMPLE[order or 'paper']}"


def without_control_tokens(text: str) -> str:
    """A user's text in which nothing reads as one of our tokens or of a chat template's.

    An instruction that holds `<999>` or `<|im_end|>` would else become that very token, and one
    with `<image>` a picture more. A blank takes the place of each, so that what stood around it
    does not close up to another.
    """
    return _CONTROL.sub(" ", text)
