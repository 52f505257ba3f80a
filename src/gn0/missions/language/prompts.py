"""Prompts for language models: the paper's four roles, each answered with one JSON object.

Roles (paper, appendix "Instruction Generation"): `moving` tells the segments with distances,
`grammar` mends a base instruction and nothing else, `detailed` grounds the steps in rooms and
landmarks, `review` checks that text against the steps.
"""

from __future__ import annotations

from typing import Any, Literal

from gn0.missions.language.route import Landmark, RouteDescription, RouteSegment, Style
from gn0.missions.language.template import distance_phrase, landmark_phrase, target_phrase
from gn0.missions.language.text_check import LANDMARKS_MOST
from gn0.missions.language.word_forms import plain_name

VERSION = "1"  # of the wording; change it with any word below
Role = Literal["moving", "grammar", "detailed", "review"]
ANSWER_FIELD: dict[Role, str] = {
    "moving": "moving_instruction",
    "grammar": "instruction",
    "detailed": "instruction",
    "review": "instruction",
}

_MOVING = """\
You are a robotics navigation instructor. From the path summary, write one concise English \
instruction. Tell straight segments as 'go straight for <distance> meters' and never mention \
heading angles. Where the summary has a turn, say 'turn left', 'turn right' or 'turn around'. \
Never use the word 'slightly'. Name the target once, at the very end, as the place to stop.
Return JSON exactly as {"moving_instruction": "..."}."""

_GRAMMAR = """\
You are an editor. Make the smallest possible grammar fix to the navigation instruction: articles \
and fluency only (as 'an other' -> 'another', 'get a water' -> 'get some water'). Add no context \
and keep the meaning. If it is already fine, return it unchanged.
Return JSON exactly as {"instruction": "..."}."""

_DETAILED = """\
You are good at guiding the way. Write fluent navigation instructions from structured steps.

Rules:
- Keep the order of the actions exactly as given; never add, drop or reorder a step.
- Use at most one landmark or area a step, from those listed for that step and no others. For \
moves prefer areas and rooms; for turns prefer the object near the turn.
- Say turns as left or right of the one who walks; never use the word 'slightly'.
- Natural, concise English with smooth transitions (then, next, after that); no numbering and not \
the word 'step'.
- Say 'on your left' or 'on your right' of a landmark only where its side is listed.
- Mention the target only once, at the end, as the place of arrival.
- Prefer distinctive objects to walls, ceilings and floors.
{style_rules}
Return JSON exactly as {{"instruction": "..."}}."""

_STYLE_RULES: dict[Style, str] = {
    "base": "- One short sentence.",
    "detailed": "- A sentence for every one or two steps. Distances may be told as whole meters, "
    "only where the movement text tells them.",
    "benchmark": "- One or two sentences in total that cover all moves and turns.\n"
    "- No distances and no coordinates.",
}

_REVIEW = """\
You are editing a navigation instruction. Keep the order and number of its steps; add no step and \
no landmark that is not provided. Use at most {most} distinct landmarks in total and do not repeat \
one without need. Prefer large, distinctive landmarks; avoid ceilings, floors and tiny clutter. \
Where landmarks are weak, keep the instruction brief. Keep left and right as the steps have them. \
Never use the word 'slightly'. Mention the goal object once, at the end.{style_rule}
Output a single concise paragraph without numbering or bullet points.
Return JSON exactly as {{"instruction": "..."}}."""


def build_messages(
    role: Role, route: RouteDescription, style: Style, *, text: str = "", movement: str = ""
) -> list[dict[str, str]]:
    """The messages of one request.

    Args:
        role: which of the four.
        route: the route.
        style: style of the text in the end.
        text: the text to mend (`grammar`) or to review (`review`).
        movement: what `moving` wrote, for `detailed`.
    """
    scene, target = plain_name(route.scene_id) or "scene", target_phrase(route.target, route=True)
    if role == "moving":
        summary = "\n".join(_summary_line(i, s) for i, s in enumerate(route.segments, 1))
        user = f"Scene: {scene}\nTarget object: {target}\nPath summary (in order):\n{summary}"
        return _messages(_MOVING, user)
    if role == "grammar":
        user = f"Scene: {scene}\nTarget object or place: {target}\nInstruction: {text}"
        return _messages(_GRAMMAR, user)
    steps = "\n".join(_step_line(i, s) for i, s in enumerate(route.segments, 1))
    if role == "detailed":
        user = f"Scene: {scene}\nGoal object: {target}\nStep breakdown:\n{steps}"
        if movement:
            user += f"\n\nMovement text:\n{movement}"
        return _messages(_DETAILED.format(style_rules=_STYLE_RULES[style]), user)
    rule = " Keep it to one or two sentences, without distances." if style == "benchmark" else ""
    landmarks = ", ".join(dict.fromkeys(landmark_phrase(m) for m in route.landmarks)) or "none"
    user = (
        f"Goal object: {target}\nStep breakdown:\n{steps}\n\n"
        f"Available landmarks: {landmarks}\n\nInstruction to refine:\n{text}"
    )
    return _messages(_REVIEW.format(most=LANDMARKS_MOST, style_rule=rule), user)


def _messages(system: str, user: str) -> list[dict[str, str]]:
    return [{"role": "system", "content": system}, {"role": "user", "content": user}]


def _summary_line(number: int, segment: RouteSegment) -> str:
    if segment.turn == "around":
        return f"{number}. turn around"
    if segment.turn is not None:
        return f"{number}. turn {segment.turn} (significant)"
    return f"{number}. straight, {distance_phrase(segment.distance)}"


def _step_line(number: int, s: RouteSegment) -> str:
    landmarks = "; ".join(_landmark_words(m) for m in s.landmarks) or "none"
    if s.turn is not None:
        words = "turn around" if s.turn == "around" else f"turn {s.turn}"
        return f"{number}. {words}; landmarks: {landmarks}"
    areas = [s.inside, *s.crosses, s.enters]
    told = " -> ".join(dict.fromkeys(a for a in areas if a)) or "unknown"
    door = ", through a doorway" if s.doors else ""
    return f"{number}. move straight{door}; areas: {told}; landmarks: {landmarks}"


def _landmark_words(landmark: Landmark) -> str:
    where: Any = {
        "past": f"passed on your {landmark.side}",
        "towards": "straight ahead at the end",
        "at": "beside the turn",
        "facing": "straight ahead after the turn",
    }
    return f"{landmark_phrase(landmark)} ({where[landmark.relation]})"
