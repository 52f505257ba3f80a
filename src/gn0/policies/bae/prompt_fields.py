"""What the fields of a prompt hold: what a robot knows about itself, and what it was told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from gn0.data.answer_form import AnswerForm
from gn0.data.codec import (
    ACTION_TOKENS,
    Answer,
    AnyFrame,
    EgoFrame,
    encode_heading,
    encode_waypoints,
    without_control_tokens,
)
from gn0.data.dataset import Dataset
from gn0.errors import ConfigError
from gn0.geometry import Pose2D
from gn0.paper import MAP_BINS
from gn0.policies.bae.prompt_template import PromptTemplate
from gn0.sim.sensors import MapFrame

WIDEST = (MapFrame(876, 987, 0.08765, 0.0, 0.0), MapFrame(8765, 9876, 0.08765, 0.0, 0.0))
"""Maps of which a prompt says as much as of any: their numbers have the most digits."""
INSTRUCTION_LIMIT = 8_000  # characters; the longest known (RxR) have about 2,500


@dataclass(frozen=True)
class PromptState:
    """What a prompt is made of; what is None is not known.

    Attributes:
        instruction: the text of the mission, as a user typed it.
        frame: the map picture that coordinates are on.
        pose: x, y [m] and yaw [rad], world frame.
        last_action: code of the action before, None at the start of an episode.
        collided: whether that action was cut short.
    """

    instruction: str
    frame: AnyFrame | None = None
    pose: Pose2D | None = None
    last_action: int | None = None
    collided: bool = False

    @cached_property
    def current(self) -> tuple[int, int] | None:
        """CURRENT_PIXEL: map tokens (x, y) of where the agent stands; None if that is not known."""
        if self.frame is None or (self.pose is None and not isinstance(self.frame, EgoFrame)):
            return None
        pose = np.array([self.pose or (0.0, 0.0, 0.0)], np.float64)
        x, y = encode_waypoints(self.frame, np.zeros((1, 1, 2)), pose)[0, 0].tolist()
        return x, y


@dataclass(frozen=True)
class Prompt:
    """A prompt, filled.

    Attributes:
        text: what the model reads after the pictures.
        pictures: names of the sensors whose pictures come before it, in order.
    """

    text: str
    pictures: tuple[str, ...]


def render_prompt(template: PromptTemplate, state: PromptState) -> Prompt:
    """Fill a template.

    Raises:
        ConfigError: a field is asked for that the state does not know (names file, line and
            field), the coordinates are on another picture than the prompt says, or the
            instruction is empty or too long.
    """
    kind = "ego" if isinstance(state.frame, EgoFrame) else "global"
    if template.points and template.frame not in ("any", kind) and state.frame is not None:
        raise ConfigError(
            f"coordinates are on the {kind} picture, the prompt speaks of the {template.frame} one",
            where=template.file,
            remedy="take another prompt, or samples with other map tokens",
        )
    read = {name: read_field(name, template, state) for name in template.fields}
    values = {name: value for name, value in read.items() if value is not None}
    return Prompt(template.fill(values), template.pictures)


def read_field(name: str, template: PromptTemplate, state: PromptState) -> str | None:
    """What a field of `FIELDS` holds; None if the state does not know it."""
    return _VALUES[name](template, state)


def clean_instruction(text: str) -> str:
    """A user's text on one line, without anything that reads as a token.

    Raises:
        ConfigError: nothing is left, or it is longer than 8,000 characters.
    """
    if len(text) > INSTRUCTION_LIMIT:
        raise ConfigError(
            f"an instruction of {len(text)} characters",
            where="instruction",
            remedy=f"give at most {INSTRUCTION_LIMIT}",
        )
    words = " ".join(without_control_tokens(text).split())
    if not words:
        raise ConfigError(
            "the instruction says nothing", where="instruction", remedy="say where to go"
        )
    return words


def sample_state(dataset: Dataset, episode_id: str, step: int) -> PromptState:
    """What the prompt of a dataset's sample is made of.

    Raises:
        DataError: the episode has no samples.
        ConfigError: it has no such step.
    """
    rows, episode = dataset.rows(episode_id), dataset.episode(episode_id)
    _check_step(episode_id, step, len(rows))
    tokens = dataset.about.settings.tokens
    frame = tokens.of_grid(dataset.navigation(episode.scene_id).grid)
    return PromptState(
        instruction=episode.instruction,
        frame=frame,
        pose=Pose2D(*map(float, rows.poses[step])),
        last_action=int(rows.executed[step - 1]) if step else None,
        collided=bool(step and rows.collided[step - 1]),
    )


def sample_answer(dataset: Dataset, episode_id: str, step: int, form: AnswerForm) -> Answer:
    """What a model should answer at a dataset's sample.

    Raises:
        DataError: the episode has no samples.
        ConfigError: it has no such step, its samples have no map tokens, or fewer points.
    """
    rows = dataset.rows(episode_id)
    _check_step(episode_id, step, len(rows))
    actions = tuple(rows.actions[step, : form.actions].tolist())
    if not form.points:
        return Answer(actions)
    tokens = rows.pixels[step, : form.points]
    if (tokens < 0).any():
        raise ConfigError(
            "the samples have no map tokens", where=episode_id, remedy="build the dataset again"
        )
    return Answer(actions, tuple((int(x), int(y)) for x, y in tokens))


def _check_step(episode_id: str, step: int, steps: int) -> None:
    if not 0 <= step < steps:
        raise ConfigError(
            f"no step {step} in episode {episode_id!r}",
            where="step",
            remedy=f"its samples are steps 0 to {steps - 1}",
        )


Value = Callable[[PromptTemplate, PromptState], str | None]


def _of_frame(read: Callable[[AnyFrame], str]) -> Value:
    return lambda _, state: None if state.frame is None else read(state.frame)


def _of_place(axis: int) -> Value:
    return lambda _, state: None if state.current is None else f"<{state.current[axis]}>"


def _metres(value: float) -> str:
    return f"{value:.4g}"


def _unit(size: int, frame: AnyFrame) -> str:
    return _metres(size / MAP_BINS * frame.metres_per_pixel)


_VALUES: dict[str, Value] = {
    "INSTRUCTION_TEXT": lambda _, state: clean_instruction(state.instruction),
    "TASK_TYPE": lambda template, _: template.task,
    "OCC_W": _of_frame(lambda f: str(f.width)),
    "OCC_H": _of_frame(lambda f: str(f.height)),
    "OCC_M_PER_PX": _of_frame(lambda f: _metres(f.metres_per_pixel)),
    "X_NORM_UNIT_M": _of_frame(lambda f: _unit(f.width, f)),
    "Y_NORM_UNIT_M": _of_frame(lambda f: _unit(f.height, f)),
    "CUR_XN": _of_place(0),
    "CUR_YN": _of_place(1),
    "HEADING": lambda _, state: (
        None if state.pose is None else f"<{encode_heading(state.pose.yaw)}>"
    ),
    "LAST_ACTION": lambda _, state: (
        "none" if state.last_action is None else ACTION_TOKENS[state.last_action]
    ),
    "BUMPER": lambda _, state: "hit" if state.collided else "free",
}
