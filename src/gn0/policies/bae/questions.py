"""What a checkpoint is asked about N agents: prompts by text, and which tokens may answer."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from gn0.data.answer_slots import FREE, AnswerSlots, X, Y, compile_slots
from gn0.data.codec import AnyFrame, EgoFrame, encode_heading, encode_waypoints
from gn0.data.navigation_vocabulary import TextTokenizer
from gn0.errors import CheckpointError, ConfigError, FormatError, PolicyError, StorageError
from gn0.geometry import Pose2D
from gn0.policies.bae.policy_settings import (
    MAPS,
    SQUARE_NAMES,
    VIEWS,
    PolicySettings,
    load_policy_settings,
)
from gn0.policies.bae.prompt_fields import WIDEST, PromptState
from gn0.policies.bae.prompt_table import PromptFiller, build_prompt_table
from gn0.policies.bae.tokenizer_file import load_tokenizer
from gn0.policies.bae.tokens import find_token_ids
from gn0.policies.qwen.architecture import load_architecture
from gn0.sim.sensors import MapFrame
from gn0.sim.state import Observation

I64 = NDArray[np.int64]
TEXTS_KEPT = 4096  # prompts of so many texts are kept


class Questions:
    """Asks a checkpoint about what agents observe; needs no torch.

    Args:
        folder: of the checkpoint.
        tokenizer: of it; its tokenizer.json is read when None.
        inputs: in which of its ways it is asked; its default when empty.

    Attributes:
        settings: of that way alone.
        inputs: names of all of them; none where there is one alone.

    Raises:
        ConfigError: it has no such inputs; lists those that it has.
        CheckpointError: the folder lacks something, or its parts do not fit each other.
    """

    def __init__(
        self, folder: Path, tokenizer: TextTokenizer | None = None, inputs: str = ""
    ) -> None:
        self.folder = folder
        every = load_policy_settings(folder)
        self.inputs = tuple(every.by_input) if every.input else ()
        self.settings: PolicySettings = every.choose(inputs)
        self._without_cameras = [
            name
            for name, own in every.by_input.items()
            if name and not {*own.pictures}.intersection(VIEWS)
        ]
        self.architecture = load_architecture(folder)
        try:
            self.template = self.settings.load_template(folder)
            self.tokenizer = load_tokenizer(folder) if tokenizer is None else tokenizer
            self.ids = find_token_ids(self.tokenizer)
        except (ConfigError, FormatError, StorageError) as error:
            raise CheckpointError(
                error.what, where=error.where or folder, remedy=error.remedy
            ) from None
        rows = self.architecture.text.vocabulary
        if self.ids.vocabulary.size > rows:
            raise CheckpointError(
                f"the tokenizer has {self.ids.vocabulary.size} tokens, the model rows for {rows}",
                where=folder,
                remedy="the tokenizer is that of another checkpoint",
            )
        self.slots: AnswerSlots = compile_slots(
            self.settings.form, self.ids.vocabulary, self.tokenizer
        )
        self.find = lru_cache(TEXTS_KEPT)(self._find)
        plain = self.find("go", self.settings.frame or WIDEST[0]).table
        self.layout, self.place_said = plain.layout, plain.place

    def _find(self, text: str, frame: AnyFrame) -> PromptFiller:
        """Prompts of an instruction, with coordinates on this picture.

        Raises:
            ConfigError: it is empty, or too long for this checkpoint.
        """
        settings = self.settings
        table = build_prompt_table(
            self.template,
            [PromptState(text, frame)],
            settings.sizes,
            self.architecture,
            self.tokenizer,
            self.ids,
            text_length=settings.text_length,
        )
        return PromptFiller(table)

    def check(self, text: str) -> None:
        """Refuse an instruction that cannot be asked, whatever the map.

        Raises:
            ConfigError: see `find`.
        """
        for frame in (self.settings.frame,) if self.settings.frame else WIDEST:
            self.find(text, frame)

    def find_frame(self, observation: Observation) -> AnyFrame:
        """The picture that coordinates are on: the checkpoint's square, or the agent's whole map.

        Raises:
            PolicyError: they are on the whole map, and the agent has none.
        """
        own = self.settings.frame
        if own is not None:
            return own
        scale, origin = observation.bev_metres_per_pixel, observation.map_origin
        for name in MAPS:
            picture = observation.read(name)
            if picture is not None and scale is not None and origin is not None:
                height, width = picture.shape[:2]
                return MapFrame(width, height, scale, *origin)
        raise PolicyError(
            "coordinates are on the whole map, and the agent has none",
            where=self.folder,
            remedy="carry the sensors bev or occupancy",
        )

    def fill(
        self, text: str, last: int, collided: bool, yaw: float | None,
        pose: Pose2D | None = None, frame: AnyFrame | None = None,
    ) -> I64:  # fmt: skip
        """The prompt int64 [P].

        Args:
            text: the instruction.
            last: code of the action before; -1 at the start.
            collided: whether it was cut short.
            yaw: heading [rad] in the world; None where the prompt does not say it.
            pose: where the agent stands; read where coordinates are on the whole map.
            frame: the picture that they are on; the checkpoint's square when None.
        """
        frame = frame or self.settings.frame or WIDEST[0]
        heading = 0 if yaw is None else encode_heading(yaw)
        numbers = np.array([[*find_place(frame, pose), heading]], np.int32)
        one = np.ones(1, np.int64)
        found: I64 = self.find(text, frame).fill(one * 0, one * last, one * collided, numbers)[0]
        return found.astype(np.int64)

    def show(self, observation: Observation) -> list[NDArray[np.uint8]]:
        """Pictures uint8 [H, W, 3] of the prompt, in its order.

        Raises:
            PolicyError: one is missing or of another size than the checkpoint was trained on.
        """
        settings, sizes = self.settings, self.settings.sizes
        shown = []
        for name in self.settings.pictures:
            square = SQUARE_NAMES.index(name) if name in SQUARE_NAMES else None
            picture: Any = observation.read(name if square is None else "ego_map")
            if square is not None and picture is not None:
                width, height = settings.view.picture_size
                if picture.shape[:2] == (height, width):
                    picture = settings.view.split(picture)[square]
            size = sizes[name]
            if name in MAPS and picture is not None:
                whole = Image.fromarray(picture)
                wanted = (size.width, size.height)
                picture = np.asarray(whole.resize(wanted, Image.Resampling.BOX), np.uint8)
            if picture is None or picture.shape != (size.height, size.width, 3):
                got = "missing" if picture is None else f"{picture.shape[1]}×{picture.shape[0]} px"
                raise PolicyError(
                    f"picture {name!r} is {got}, the checkpoint was trained on "
                    f"{size.width}×{size.height} px",
                    where=self.folder,
                    remedy=f"use camera preset {settings.preset} and the checkpoint's ego map"
                    + (
                        f"; inputs={self._without_cameras[0]} needs no camera"
                        if name in VIEWS and self._without_cameras
                        else ""
                    ),
                )
            if name == "history" and self.template.task == "TRACKING":
                picture = np.zeros_like(picture)  # as its samples have it
            shown.append(picture)
        return shown


def list_allowed(
    slots: AnswerSlots, frame: EgoFrame | None, *, free: bool = False, room: int = 0
) -> list[I64]:
    """The ids int64 that each slot may have, point 0 forced to the agent's own place.

    Args:
        slots: of the answers.
        frame: the square that coordinates are on, where that place is always the same; without
            one point 0 may be anywhere, see `list_choices`.
        free: every slot may have any token of the vocabulary, and so may …
        room: … so many more behind them.
    """
    if free:
        return [np.arange(slots.vocabulary.size)] * (len(slots) + room)
    forced = slots.forced(None if frame is None else find_place(frame))[0]
    return [
        np.array([own], np.int64) if own != FREE else slots.allowed(k).astype(np.int64)
        for k, own in enumerate(forced)
    ]


def list_choices(
    slots: AnswerSlots,
    frame: EgoFrame | None,
    *,
    free: bool = False,
    room: int = 0,
    said: tuple[int, int] | None = None,
) -> list[I64 | int]:
    """As `list_allowed`; without a square point 0 is copied from where the prompt says it.

    Args:
        slots: see `list_allowed`, as the next three.
        frame: of coordinates.
        free: any token anywhere.
        room: tokens more.
        said: the places in the prompt that say x and y of point 0; the slots of point 0 are then
            these numbers.
    """
    found: list[I64 | int] = [*list_allowed(slots, frame, free=free, room=room)]
    if frame is None and said is not None and not free:
        for kind, place in zip((X, Y), said, strict=True):
            for k in np.flatnonzero((slots.kinds == kind) & (slots.index == 0)).tolist():
                found[k] = place
    return found


def find_place(frame: AnyFrame, pose: Pose2D | None = None) -> tuple[int, int]:
    """Map tokens (x, y) of the agent's own place on a picture; a square's is always the same."""
    poses = np.array([pose or (0.0, 0.0, 0.0)], np.float64)
    x, y = encode_waypoints(frame, np.zeros((1, 1, 2)), poses)[0, 0].tolist()
    return x, y
