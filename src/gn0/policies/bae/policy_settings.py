"""`policy.json`: what a checkpoint is shown and asked, and what is done with its answers.

Weights say nothing of it; a policy that was trained on other pictures, squares or prompts than it
is given walks into walls. Training writes the file beside the weights, and acting reads it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import msgspec

from gn0.config import Config, load_json
from gn0.data.answer_form import AnswerForm
from gn0.data.codec import EgoFrame
from gn0.errors import CheckpointError, ConfigError, Gn0Error
from gn0.paper import ACTIONS_AHEAD
from gn0.policies.bae.prompt_template import ENDING, PromptTemplate, load_prompt
from gn0.policies.qwen.layout import PictureSize
from gn0.sim.ego_map import EgoSquare, MapView
from gn0.sim.history import mosaic_size
from gn0.sim.presets import CameraPreset, find_preset
from gn0.storage import read_bytes, write_bytes, write_json

FILE = "policy.json"
LIMIT = 2**20  # bytes of it
SQUARE_NAMES = ("near", "far", *(f"square_{number}" for number in range(2, 8)))
"""Names that prompts give the squares of `ego_map`, in their order."""

_VIEWS = ("rgb", "history", "goal_picture")
_OPEN_TO = ("task", "pictures", "points", "layout", "frame")


class PolicySettings(Config, frozen=True):
    """How a checkpoint is asked.

    Attributes:
        prompt: one of GN0's templates by name, or a .txt file beside the weights.
        pictures: that the prompt shows, in order: rgb, history, goal_picture, or `SQUARE_NAMES`.
        form: of its answers.
        without: parts of the prompt that are off.
        task: PLANNING or TRACKING.
        preset: camera preset by name.
        history_tile: (width, height) [px] of a view in the mosaic; the preset's when None.
        view: squares of the sensor ego_map.
        square: number of the square that answers' coordinates are on.
        text_length: tokens that the prompt has for what an episode says; longer texts are refused.
        executed: actions of an answer that are carried out before the next question.
        prompt_digest: of the template as it was trained on; empty where nobody wrote it down.
    """

    prompt: str
    pictures: tuple[str, ...]
    form: AnswerForm
    without: tuple[str, ...] = ()
    task: Literal["PLANNING", "TRACKING"] = "PLANNING"
    preset: str = "tiny_128"
    history_tile: tuple[int, int] | None = None
    view: MapView = MapView()
    square: Annotated[int, msgspec.Meta(ge=0)] = 0
    text_length: Annotated[int, msgspec.Meta(ge=1, le=4096)] = 96
    executed: Annotated[int, msgspec.Meta(ge=1, le=ACTIONS_AHEAD)] = 3
    prompt_digest: str = ""

    def __post_init__(self) -> None:
        known = (*_VIEWS, *SQUARE_NAMES[: len(self.view.squares)])
        for name in self.pictures:
            if name not in known:
                raise ConfigError(
                    f"no picture {name!r} for this policy",
                    where="pictures",
                    remedy=f"known: {', '.join(known)}",
                )
        if self.square >= len(self.view.squares):
            raise ConfigError(
                f"coordinates on square {self.square} of {len(self.view.squares)}",
                where="square",
                remedy="name one of view.squares",
            )
        if self.executed > self.form.actions:
            raise ConfigError(
                f"{self.executed} of {self.form.actions} actions cannot be carried out",
                where="executed",
                remedy="give at most form.actions",
            )

    @property
    def camera(self) -> CameraPreset:
        """The cameras."""
        return find_preset(self.preset, history_tile=self.history_tile)

    @property
    def frame(self) -> EgoFrame:
        """The square that answers' coordinates are on."""
        return frame_of(self.view.squares[self.square])

    @property
    def sizes(self) -> dict[str, PictureSize]:
        """Sizes of all pictures that a prompt may show."""
        camera = self.camera
        sizes = {
            "rgb": PictureSize(*camera.picture_size),
            "history": PictureSize(*mosaic_size(camera.history_tile)),
            "goal_picture": PictureSize(*camera.picture_size),
        }
        for name, square in zip(SQUARE_NAMES, self.view.squares, strict=False):
            sizes[name] = PictureSize(square.size, square.size)
        return sizes

    def sensors(self, template: PromptTemplate) -> tuple[str, ...]:
        """Sensors that must be read for the prompt; the heading is the sensor `pose`."""
        seen = ["ego_map" if name in SQUARE_NAMES else name for name in self.pictures]
        if "HEADING" in template.fields:
            seen.append("pose")
        return tuple(dict.fromkeys(seen))

    def load_template(self, folder: Path | str = "") -> PromptTemplate:
        """The template of the prompt.

        Args:
            folder: of the checkpoint, where the prompt is a file of its own.

        Raises:
            ConfigError: no such template, it does not leave open what is asked for, or it speaks of
                the whole map, of which an agent is not told where it lies.
            StorageError, FormatError: it cannot be read.
            CheckpointError: it is not the one that the checkpoint was trained on.
        """
        place = folder if self.prompt.endswith(ENDING) else None
        plain = load_prompt(self.prompt, place)
        wanted = {
            "task": self.task,
            "pictures": self.pictures,
            "points": self.form.points,
            "layout": self.form.layout,
            "frame": "ego",
        }
        chosen = {key: wanted[key] for key in _OPEN_TO if wanted[key] != getattr(plain, key)}
        if plain.frame == "any" or not plain.points:
            chosen.pop("frame", None)  # it takes the square as it is
        template = load_prompt(self.prompt, place, without=self.without, **chosen)  # type: ignore[arg-type]
        if self.prompt_digest and template.digest != self.prompt_digest:
            raise CheckpointError(
                f"prompt {self.prompt!r} has digest {template.digest[:12]}, the checkpoint was "
                f"trained on {self.prompt_digest[:12]}",
                where=template.file,
                remedy="use the version of GN0 that the model card names",
            )
        return template


def frame_of(square: EgoSquare) -> EgoFrame:
    """The frame of coordinates on a square."""
    return EgoFrame(square.size, square.metres_per_pixel, square.ahead)


def load_policy_settings(folder: Path | str) -> PolicySettings:
    """The settings of a checkpoint's folder.

    Raises:
        CheckpointError: there are none, or they are not what a policy's settings are; says what.
    """
    file = Path(folder) / FILE
    if not file.is_file():
        raise CheckpointError(
            f"no {FILE}: nobody says what this model is shown and asked",
            where=folder,
            remedy="give the folder that `gn0 train` wrote",
        )
    try:
        settings = load_json(file, PolicySettings, limit=LIMIT)
        settings.camera  # noqa: B018 (whether there is such a preset)
    except Gn0Error as error:
        where = error.where if str(file) in error.where else f"{file}: {error.where}"
        raise CheckpointError(error.what, where=where, remedy=error.remedy) from None
    if settings.prompt.endswith(ENDING) and Path(settings.prompt).name != settings.prompt:
        raise CheckpointError(
            f"prompt {settings.prompt!r} is not a file in its folder",
            where=file,
            remedy="put it beside the weights",
        )
    return settings


def save_policy_settings(
    folder: Path | str, settings: PolicySettings, template: PromptTemplate | None = None
) -> PolicySettings:
    """Write the settings, and the prompt where it is a file of a user's own, beside the weights.

    Args:
        folder: of the checkpoint.
        settings: what is written, with the digest of the template.
        template: as `settings.load_template` read it; read again when None.

    Returns:
        the settings as they were written.

    Raises:
        ConfigError, FormatError: the prompt cannot be read.
        StorageError: the folder cannot be written.
    """
    own = settings.prompt.endswith(ENDING)
    source = Path(settings.prompt)
    name = source.name if own else settings.prompt
    if template is None:
        plain = msgspec.structs.replace(settings, prompt=name, prompt_digest="")
        template = plain.load_template(source.parent)
    if own:
        write_bytes(Path(folder) / name, read_bytes(template.file))
    written = msgspec.structs.replace(settings, prompt=name, prompt_digest=template.digest)
    write_json(Path(folder) / FILE, msgspec.to_builtins(written))
    return written
