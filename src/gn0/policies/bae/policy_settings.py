"""`policy.json`: what a checkpoint is shown and asked, and what is done with its answers.

Weights say nothing of it; a policy that was trained on other pictures, squares or prompts than it
is given walks into walls. Training writes the file beside the weights, and acting reads it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

import msgspec

from gn0.config import Config, load_json
from gn0.data.answer_form import AnswerForm
from gn0.data.codec import EgoFrame
from gn0.errors import CheckpointError, ConfigError, Gn0Error
from gn0.paper import ACTIONS_AHEAD
from gn0.policies.bae.draws import MOST
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

INPUT_NAME = re.compile("[a-z][a-z0-9_]{0,31}")
MAPS = ("bev", "occupancy")
"""Whole maps, as prompts name them."""
Pixels = Annotated[int, msgspec.Meta(ge=1, le=4096)]
VIEWS = ("rgb", "history", "goal_picture")
"""Pictures that need a camera, as prompts name them."""
_OPEN_TO = ("task", "pictures", "points", "layout", "frame")


class PolicyInput(Config, frozen=True):
    """One way to ask a checkpoint.

    Attributes:
        prompt: one of GN0's templates by name, or a .txt file beside the weights.
        pictures: that the prompt shows, in order: rgb, history, goal_picture, bev, occupancy, or
            `SQUARE_NAMES`.
        form: of its answers.
        without: parts of the prompt that are off.
        task: PLANNING or TRACKING.
        coordinates: what answers' coordinates are on: a square of the ego map, or the whole map, as
            in the paper.
        square: number of that square.
        text_length: tokens that the prompt has for what an episode says; longer texts are refused.
        prompt_digest: of the template as it was trained on; empty where nobody wrote it down.
    """

    prompt: str
    pictures: tuple[str, ...]
    form: AnswerForm
    without: tuple[str, ...] = ()
    task: Literal["PLANNING", "TRACKING"] = "PLANNING"
    coordinates: Literal["square", "map"] = "square"
    square: Annotated[int, msgspec.Meta(ge=0)] = 0
    text_length: Annotated[int, msgspec.Meta(ge=1, le=4096)] = 96
    prompt_digest: str = ""


class PolicySettings(PolicyInput, frozen=True):
    """How a checkpoint is asked.

    One set of weights may be asked in several ways, with other pictures and prompts. The fields of
    `PolicyInput` are the first of them, the default; `inputs` has the others by name.

    Attributes:
        preset: camera preset by name.
        history_tile: (width, height) [px] of a view in the mosaic; the preset's when None.
        view: squares of the sensor ego_map, and whether the occupancy picture has an arrow.
        map_size: (width, height) [px] that bev and occupancy of any scene are brought to.
        executed: actions of an answer that are carried out before the next question.
        draw_after: actions without getting anywhere after which answers are drawn as probable as
            the model holds them, until it moves; 0: never, they are the most probable ones.
        input: name of the default; empty where the checkpoint is asked in one way alone.
        inputs: the other ways, by name.
    """

    preset: str = "tiny_128"
    history_tile: tuple[int, int] | None = None
    view: MapView = MapView()
    map_size: tuple[Pixels, Pixels] = (128, 128)
    executed: Annotated[int, msgspec.Meta(ge=1, le=ACTIONS_AHEAD)] = 3
    draw_after: Annotated[int, msgspec.Meta(ge=0, le=MOST)] = 0
    input: str = ""
    inputs: dict[str, PolicyInput] = msgspec.field(default_factory=dict)

    def __post_init__(self) -> None:
        self._check_names()
        self._check(self, "")
        for name, own in self.inputs.items():
            self._check(own, f"inputs.{name}.")

    def _check_names(self) -> None:
        names = (self.input, *self.inputs) if self.input or self.inputs else ()
        for name in names:
            if not INPUT_NAME.fullmatch(name) or names.count(name) > 1:
                raise ConfigError(
                    f"{name!r} names no input, or two",
                    where="inputs",
                    remedy="name each, the default too, by small letters, digits and _",
                )

    def _check(self, own: PolicyInput, where: str) -> None:
        known = (*VIEWS, *MAPS, *SQUARE_NAMES[: len(self.view.squares)])
        for name in own.pictures:
            if name not in known:
                raise ConfigError(
                    f"no picture {name!r} for this policy",
                    where=f"{where}pictures",
                    remedy=f"known: {', '.join(known)}",
                )
        if own.square >= len(self.view.squares):
            raise ConfigError(
                f"coordinates on square {own.square} of {len(self.view.squares)}",
                where=f"{where}square",
                remedy="name one of view.squares",
            )
        if self.executed > own.form.actions:
            raise ConfigError(
                f"{self.executed} of {own.form.actions} actions cannot be carried out",
                where="executed",
                remedy="give at most form.actions",
            )

    def choose(self, name: str = "") -> PolicySettings:
        """The settings of one of its inputs, alone; the default without a name.

        Raises:
            ConfigError: there is none of that name; lists those that there are.
        """
        if name in ("", self.input):
            return msgspec.structs.replace(self, inputs={})
        if name not in self.inputs:
            known = ", ".join((self.input, *self.inputs)) if self.inputs else ""
            raise ConfigError(
                f"no inputs {name!r}",
                where="inputs",
                remedy=f"known: {known}" if known else "leave it out: there is one way alone",
            )
        own = self.inputs[name]
        fields = {field: getattr(own, field) for field in PolicyInput.__struct_fields__}
        return msgspec.structs.replace(self, input=name, inputs={}, **fields)

    @property
    def by_input(self) -> dict[str, PolicySettings]:
        """The settings of each input alone, by name, the default first."""
        return {name: self.choose(name) for name in (self.input, *self.inputs)}

    @property
    def shown(self) -> tuple[str, ...]:
        """Pictures that any of its inputs shows."""
        every = (*self.pictures, *(name for own in self.inputs.values() for name in own.pictures))
        return tuple(dict.fromkeys(every))

    @property
    def camera(self) -> CameraPreset:
        """The cameras."""
        return find_preset(self.preset, history_tile=self.history_tile)

    @property
    def frame(self) -> EgoFrame | None:
        """The square that answers' coordinates are on; None where that is the whole map."""
        if self.coordinates == "map":
            return None
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
        sizes |= {name: PictureSize(*self.map_size) for name in MAPS}
        for name, square in zip(SQUARE_NAMES, self.view.squares, strict=False):
            sizes[name] = PictureSize(square.size, square.size)
        return sizes

    def sensors(self, template: PromptTemplate) -> tuple[str, ...]:
        """Sensors that must be read for the prompt; heading and place are of the sensor `pose`."""
        seen = ["ego_map" if name in SQUARE_NAMES else name for name in self.pictures]
        if "HEADING" in template.fields or self.coordinates == "map":
            seen.append("pose")
        return tuple(dict.fromkeys(seen))

    def load_template(self, folder: Path | str = "") -> PromptTemplate:
        """The template of the prompt.

        Args:
            folder: of the checkpoint, where the prompt is a file of its own.

        Raises:
            ConfigError: no such template, it does not leave open what is asked for, or it speaks of
                another map picture, place or arrow than the settings have.
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
            "frame": "global" if self.coordinates == "map" else "ego",
        }
        chosen = {key: wanted[key] for key in _OPEN_TO if wanted[key] != getattr(plain, key)}
        if plain.frame == "any" or not plain.points:
            chosen.pop("frame", None)  # it takes the picture as it is
        template = load_prompt(self.prompt, place, without=self.without, **chosen)  # type: ignore[arg-type]
        if "arrow" in template.parts and ("arrow" in template.on) != self.view.arrow:
            raise ConfigError(
                f"prompt {template.name!r} speaks of the agent as "
                f"{'an arrow' if 'arrow' in template.on else 'a disc'}, the occupancy picture has "
                f"{'an arrow' if self.view.arrow else 'a disc'}",
                where=template.file,
                remedy="set view.arrow, or switch part 'arrow' off",
            )
        told = "CUR_XN" in template.fields and "CUR_YN" in template.fields
        if self.coordinates == "map" and self.form.points and not (self.form.first_point or told):
            raise ConfigError(
                f"prompt {template.name!r} does not say where on the map the agent stands, and "
                "answers begin with it",
                where=template.file,
                remedy="leave part current_pixel on, or take the compact layout",
            )
        if self.prompt_digest and template.digest != self.prompt_digest:
            raise CheckpointError(
                f"prompt {self.prompt!r} has digest {template.digest[:12]}, the checkpoint was "
                f"trained on {self.prompt_digest[:12]}",
                where=template.file,
                remedy="use the version of GN0 that the model card names",
            )
        return template


def join_inputs(chosen: Mapping[str, PolicySettings]) -> PolicySettings:
    """One policy's settings of those of each input; the inverse of `by_input`.

    Raises:
        ConfigError: names are odd.
    """
    (name, first), *others = chosen.items()
    inputs = {
        other: PolicyInput(**{f: getattr(own, f) for f in PolicyInput.__struct_fields__})
        for other, own in others
    }
    return msgspec.structs.replace(first, input=name, inputs=inputs)


def frame_of(square: EgoSquare) -> EgoFrame:
    """The frame of coordinates on a square."""
    return EgoFrame(square.size, square.metres_per_pixel, square.ahead)


def holds_policy(folder: Path | str) -> bool:
    """Whether a folder is a trained policy, and no model as it was released."""
    return (Path(folder) / FILE).is_file()


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
    for own in settings.by_input.values():
        if own.prompt.endswith(ENDING) and Path(own.prompt).name != own.prompt:
            raise CheckpointError(
                f"prompt {own.prompt!r} is not a file in its folder",
                where=file,
                remedy="put it beside the weights",
            )
    return settings


def save_policy_settings(
    folder: Path | str,
    settings: PolicySettings,
    template: PromptTemplate | None = None,
    others: Mapping[str, PromptTemplate] | None = None,
) -> PolicySettings:
    """Write the settings, and prompts that are files of a user's own, beside the weights.

    Args:
        folder: of the checkpoint.
        settings: what is written, with the digests of the templates.
        template: as `settings.load_template` read it; read again when None.
        others: the same of `settings.inputs`, by name.

    Returns:
        the settings as they were written.

    Raises:
        ConfigError, FormatError: a prompt cannot be read, or two have one file name.
        StorageError: the folder cannot be written.
    """
    templates = {settings.input: template, **(others or {})}
    written, files = {}, dict[str, str]()
    for input_name, chosen in settings.by_input.items():
        own = chosen.prompt.endswith(ENDING)
        source = Path(chosen.prompt)
        name = source.name if own else chosen.prompt
        read = templates.get(input_name)
        if read is None:
            plain = msgspec.structs.replace(chosen, prompt=name, prompt_digest="")
            read = plain.load_template(source.parent)
        if own:
            if files.setdefault(name, read.file) != read.file:
                raise ConfigError(
                    f"two prompts are files {name!r}", where=read.file, remedy="rename one"
                )
            write_bytes(Path(folder) / name, read_bytes(read.file))
        written[input_name] = msgspec.structs.replace(
            chosen, prompt=name, prompt_digest=read.digest
        )
    found = join_inputs(written)
    plainly = msgspec.to_builtins(found)
    plain = PolicySettings(prompt="", pictures=(), form=settings.form)
    for name in ("input", "inputs", "map_size", "coordinates"):  # files without them are as ever
        if getattr(found, name) == getattr(plain, name):
            del plainly[name]
    for own in plainly.get("inputs", {}).values():
        if own["coordinates"] == plain.coordinates:
            del own["coordinates"]
    write_json(Path(folder) / FILE, plainly)
    return found
