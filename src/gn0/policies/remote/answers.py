"""What a server's answer means: actions out of a decoded reply, or a refusal that says why."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from gn0.errors import PolicyError
from gn0.policies.text import TextAnswer
from gn0.sim.state import Action, Displacement

ActionFormat = Literal["auto", "discrete", "nav_delta"]
Delta = tuple[float, float, float]

ROWS_LIMIT = 4096  # actions in an answer
FARTHEST = 1000.0  # m and rad: nobody means a longer step
_WORDS = {
    "stop": 0, "<stop>": 0,
    "move_forward": 1, "forward": 1, "fwd": 1, "<fwd>": 1,
    "turn_left": 2, "left": 2, "<left>": 2,
    "turn_right": 3, "right": 3, "<right>": 3,
}  # fmt: skip
_TYPES = {
    "": "auto", "auto": "auto",
    "discrete": "discrete", "vlnce": "discrete", "vln_ce": "discrete", "int": "discrete",
    "nav_delta": "nav_delta", "nav": "nav_delta", "delta": "nav_delta", "continuous": "nav_delta",
    "relative_pose": "nav_delta", "relative": "nav_delta",
    "text": "text",
}  # fmt: skip
_REMEDY = "answer with actions as in docs/policies.md"


@dataclass(frozen=True)
class Answer:
    """Actions of one reply, in order; none at all means STOP.

    Attributes:
        actions: discrete actions, or (dx forward, dy left [m], dyaw [rad]) rows.
        dropped: rows left out because they held NaN or infinity.
        understood: False when a text could not be read and means STOP.
    """

    actions: tuple[Action | Delta, ...]
    dropped: int = 0
    understood: bool = True


def read_answer(
    reply: Any,
    *,
    action_format: ActionFormat = "auto",
    parse_text: Callable[[str], TextAnswer] | None = None,
) -> Answer:
    """The actions of a decoded reply.

    Accepts the keys `actions`, `action.nav_delta`, `action.discrete`, `action.vlnce` and `action`,
    with `action_type`, `action.type` or `action_format` beside them. Without a type, integers and
    names are discrete and rows of three numbers are nav_delta.

    Raises:
        PolicyError: no action in it, an unknown one, or a shape that means nothing.
    """
    if not isinstance(reply, dict):
        raise _refusal(f"is a {type(reply).__name__}, not a map")
    if "error" in reply and not any(key.startswith("action") for key in reply):
        raise _refusal(f"reports an error: {show(reply['error'])}")
    kind, raw = _select(reply)
    if kind == "text":
        if parse_text is None:
            raise PolicyError(
                f"the answer is a text: {show(raw)}",
                remedy="say whose words they are: --policy-option answers=navid (or uninavid, "
                "navila)",
            )
        if not isinstance(raw, str):
            raise _refusal(f"has a text that is a {type(raw).__name__}")
        said = parse_text(raw)
        return Answer(said.actions, understood=said.understood)
    rows, shape = _table(raw)
    if action_format != "auto":
        kind = action_format
    elif kind == "auto":
        kind = _guess(rows, shape)
    if kind == "discrete":
        return Answer(tuple(_discrete(value) for value in _flat(rows)))
    return _deltas(rows, shape)


def show(value: Any) -> str:
    """A stranger's words, short and on one line."""
    text = value if isinstance(value, str) else repr(value)[:400]
    return "".join(c if c.isprintable() else " " for c in text[:200]).strip() or "(nothing)"


def _refusal(what: str) -> PolicyError:
    return PolicyError(f"the answer {what}", remedy=_REMEDY)


def _select(reply: dict[str, Any]) -> tuple[str, Any]:
    named = (reply.get(key) for key in ("action_type", "action.type", "action_format"))
    stated = next((value for value in named if value is not None), None)
    if stated is not None and not isinstance(stated, str):
        raise _refusal(f"has an action_type that is a {type(stated).__name__}")
    kind = _TYPES.get((stated or "").strip().lower().replace("-", "_"))
    if kind is None:
        raise _refusal(f"has action_type {show(stated)!r}: known are discrete, nav_delta, text")
    if kind == "text":
        for key in ("text", "actions", "action"):
            if key in reply:
                return kind, reply[key]
        raise _refusal("says it is a text and has none")
    if "actions" in reply:
        return kind, reply["actions"]
    for key, means in (
        ("action.nav_delta", "nav_delta"),
        ("action.discrete", "discrete"),
        ("action.vlnce", "discrete"),
    ):
        if key in reply:
            return means, reply[key]
    if "action" in reply:
        return kind, reply["action"]
    raise _refusal(f"has no actions: its keys are {show(', '.join(sorted(reply)))}")


def _table(raw: Any) -> tuple[list[Any], tuple[int, ...]]:
    """Actions as a list of values or of equally long rows, and its shape."""
    if isinstance(raw, np.ndarray):
        if raw.ndim > 2 or raw.size > ROWS_LIMIT * 16:
            raise _refusal(f"has actions of shape {raw.shape}")
        return (raw.tolist() if raw.ndim else [raw.item()]), raw.shape
    if not isinstance(raw, list):
        return [raw.item() if isinstance(raw, np.generic) else raw], ()
    if len(raw) > ROWS_LIMIT:
        raise _refusal(f"has {len(raw)} actions, {ROWS_LIMIT} are allowed")
    rows = [
        value.tolist() if isinstance(value, np.ndarray | np.generic) else value for value in raw
    ]
    widths = {len(row) if isinstance(row, list) else -1 for row in rows}
    if len(widths) > 1 or any(w > 64 for w in widths):
        raise _refusal("has rows of different lengths")
    width = widths.pop() if widths else -1
    return rows, (len(rows),) if width < 0 else (len(rows), width)


def _flat(rows: list[Any]) -> list[Any]:
    return [v for row in rows for v in (row if isinstance(row, list) else [row])]


def _guess(rows: list[Any], shape: tuple[int, ...]) -> str:
    """Whether it is discrete or nav_delta, as the released client guesses it."""
    values = _flat(rows)
    floats = any(isinstance(v, float) for v in values)
    if not floats or not shape or any(isinstance(v, str | bytes) for v in values):
        return "discrete"
    if (len(shape) == 2 and shape[1] >= 3) or shape == (3,):
        return "nav_delta"
    return "discrete"


def _discrete(value: Any) -> Action:
    if isinstance(value, bytes):
        value = value.decode("utf-8", "replace")
    if isinstance(value, str):
        code = _WORDS.get(value.strip().lower(), -1)
    elif isinstance(value, int) or (isinstance(value, float) and value.is_integer()):
        code = int(value)
    else:
        code = -1
    if not 0 <= code <= 3:
        raise PolicyError(
            f"the answer holds the unknown action {show(value)}",
            remedy="answer with 0 STOP, 1 FORWARD, 2 LEFT, 3 RIGHT, or their names",
        )
    return Action(code)


def _deltas(rows: list[Any], shape: tuple[int, ...]) -> Answer:
    if shape == (0,):
        return Answer(())
    if len(shape) == 1:
        rows, shape = [rows], (1, shape[0])
    if len(shape) != 2 or shape[1] < 3:
        raise _refusal(f"has nav_delta actions of shape {shape}, not (N, 3)")
    for value in _flat(rows):
        if not isinstance(value, int | float):
            raise _refusal(f"has a nav_delta action with {show(value)} in it")
    with np.errstate(over="ignore"):  # beyond float32 is infinite, and dropped as such
        table = np.array([[float(v) for v in row[:3]] for row in rows], np.float32).reshape(-1, 3)
    kept = table[np.isfinite(table).all(axis=1)]
    deltas: list[Action | Delta] = [(r[0], r[1], r[2]) for r in kept.tolist()]
    if kept.size and float(np.abs(kept).max()) > FARTHEST:
        raise _refusal(f"asks for a step of {np.abs(kept).max():g} m or rad")
    return Answer(tuple(deltas), dropped=len(table) - len(kept))


def is_stop(delta: Delta, epsilon: float) -> bool:
    """Whether a delta is so small that it means STOP; compared in float32, as it is sent."""
    return all(abs(value) <= float(np.float32(epsilon)) for value in delta)


def build_displacement(
    delta: Delta, turned: float, max_translation: float = 0.0, max_yaw: float = 0.0
) -> Displacement:
    """A delta as a move in the agent's own frame.

    Args:
        delta: (dx forward, dy left [m], dyaw [rad]).
        turned: yaw since the heading that `delta`'s translation refers to [rad].
        max_translation: longest step [m]; 0 leaves it.
        max_yaw: largest turn [rad]; 0 leaves it.
    """
    dx, dy, dyaw = delta
    length = math.hypot(dx, dy)
    if 0 < max_translation < length:
        dx, dy = dx * max_translation / length, dy * max_translation / length
    if max_yaw > 0:
        dyaw = max(-max_yaw, min(max_yaw, dyaw))
    c, s = math.cos(turned), math.sin(turned)
    return Displacement(c * dx + s * dy, c * dy - s * dx, dyaw)
