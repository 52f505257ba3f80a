"""What a checkpoint is asked about N agents: prompts by text, and which tokens may answer."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gn0.data.answer_slots import FREE, AnswerSlots, compile_slots
from gn0.data.codec import EgoFrame, encode_heading, encode_waypoints
from gn0.data.navigation_vocabulary import TextTokenizer
from gn0.errors import CheckpointError, ConfigError, FormatError, PolicyError, StorageError
from gn0.policies.bae.policy_settings import SQUARE_NAMES, PolicySettings, load_policy_settings
from gn0.policies.bae.prompt_fields import PromptState
from gn0.policies.bae.prompt_table import PromptFiller, build_prompt_table
from gn0.policies.bae.tokenizer_file import load_tokenizer
from gn0.policies.bae.tokens import find_token_ids
from gn0.policies.qwen.architecture import load_architecture
from gn0.sim.state import Observation

I64 = NDArray[np.int64]
TEXTS_KEPT = 4096  # prompts of so many texts are kept


class Questions:
    """Asks a checkpoint about what agents observe; needs no torch.

    Args:
        folder: of the checkpoint.
        tokenizer: of it; its tokenizer.json is read when None.

    Raises:
        CheckpointError: the folder lacks something, or its parts do not fit each other.
    """

    def __init__(self, folder: Path, tokenizer: TextTokenizer | None = None) -> None:
        self.folder = folder
        self.settings: PolicySettings = load_policy_settings(folder)
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
        self.place = find_place(self.settings.frame)
        self.find = lru_cache(TEXTS_KEPT)(self._find)
        self.layout = self.find("go").table.layout

    def _find(self, text: str) -> PromptFiller:
        """Prompts of an instruction.

        Raises:
            ConfigError: it is empty, or too long for this checkpoint.
        """
        settings = self.settings
        table = build_prompt_table(
            self.template,
            [PromptState(text, settings.frame)],
            settings.sizes,
            self.architecture,
            self.tokenizer,
            self.ids,
            text_length=settings.text_length,
        )
        return PromptFiller(table)

    def fill(self, text: str, last: int, collided: bool, yaw: float | None) -> I64:
        """The prompt int64 [P].

        Args:
            text: the instruction.
            last: code of the action before; -1 at the start.
            collided: whether it was cut short.
            yaw: heading [rad] in the world; None where the prompt does not say it.
        """
        heading = 0 if yaw is None else encode_heading(yaw)
        numbers = np.array([[*self.place, heading]], np.int32)
        one = np.ones(1, np.int64)
        found: I64 = self.find(text).fill(one * 0, one * last, one * collided, numbers)[0]
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
            if picture is None or picture.shape != (size.height, size.width, 3):
                got = "missing" if picture is None else f"{picture.shape[1]}×{picture.shape[0]} px"
                raise PolicyError(
                    f"picture {name!r} is {got}, the checkpoint was trained on "
                    f"{size.width}×{size.height} px",
                    where=self.folder,
                    remedy=f"use camera preset {settings.preset} and the checkpoint's ego map",
                )
            shown.append(picture)
        return shown


def list_allowed(
    slots: AnswerSlots, frame: EgoFrame, *, free: bool = False, room: int = 0
) -> list[I64]:
    """The ids int64 that each slot may have, point 0 forced to the agent's own place.

    With `free` every slot may have any token of the vocabulary, and so may `room` more behind them.
    """
    if free:
        return [np.arange(slots.vocabulary.size)] * (len(slots) + room)
    forced = slots.forced(find_place(frame))[0]
    return [
        np.array([own], np.int64) if own != FREE else slots.allowed(k).astype(np.int64)
        for k, own in enumerate(forced)
    ]


def find_place(frame: EgoFrame) -> tuple[int, int]:
    """Map tokens (x, y) of the agent's own place on a square."""
    x, y = encode_waypoints(frame, np.zeros((1, 1, 2)), np.zeros((1, 3)))[0, 0].tolist()
    return x, y
