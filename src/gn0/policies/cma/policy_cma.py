"""CMA and Seq2Seq as policies of the benchmark: retrained, small, not the published weights.

gn0 bench run SUITE --policy cma --policy-option checkpoint=out/cma/policy
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from gn0.errors import CheckpointError, ConfigError, PolicyError
from gn0.policies.bae.policy_settings import SQUARE_NAMES
from gn0.policies.bae.tokenizer_file import load_tokenizer
from gn0.policies.cma.cma_settings import CmaSettings, load_cma_settings
from gn0.policies.cma.cma_words import encode_text
from gn0.sim.ego_map import MapView
from gn0.sim.policy import check_slots
from gn0.sim.state import Action, Observation

if TYPE_CHECKING:
    from gn0.policies.cma.walkers import WalkersCma


class PolicyCma:
    """Asks a recurrent baseline for the next action, the most probable of four.

    Each slot has a memory of its own, which hangs on its episode alone. All batches have one shape,
    so who is asked beside whom changes no action.

    Args:
        checkpoint: the folder `policy` that `gn0 train baseline` wrote.
        device: of torch: cpu, cuda or auto.
        batch: agents computed at once; 0: one, and 64 on a card.
        name: what the policy is called in results; its graph when empty.

    Raises:
        CheckpointError: the folder is not such a checkpoint; says what is wrong.
        ConfigError: an option has no meaning, or torch is not installed.
    """

    def __init__(
        self, checkpoint: str = "", *, device: str = "auto", batch: int = 0, name: str = ""
    ) -> None:
        if not checkpoint:
            raise ConfigError(
                "no checkpoint is named",
                where="checkpoint",
                remedy="pass --policy-option checkpoint=FOLDER, as `gn0 train baseline` wrote it",
            )
        folder = Path(checkpoint).expanduser()
        if not folder.is_dir():
            raise CheckpointError(
                "no such checkpoint", where=folder, remedy="give the folder that training wrote"
            )
        if not 0 <= int(batch) <= 65_536:
            raise ConfigError(f"batches of {batch}", where="batch", remedy="give 0 to 65536")
        self.settings: CmaSettings = load_cma_settings(folder)
        if find_spec("torch") is None:
            raise ConfigError(
                "torch is not installed", where="policy cma", remedy='pip install "gn0[train]"'
            )
        from gn0.policies.cma.cma_checkpoint import digest_cma_checkpoint
        from gn0.policies.cma.walkers import open_walkers

        self.folder, self.name = folder, name or self.settings.kind
        self.sensors: frozenset[str] = self.settings.sensors
        self.map_view: MapView = self.settings.view
        self._walkers: WalkersCma = open_walkers(folder, device, int(batch))
        self._tokenizer = load_tokenizer(folder)
        self._digest = digest_cma_checkpoint(folder)

    def identity(self) -> Mapping[str, str | int | float]:
        """Weights, and whatever else actions hang on."""
        walkers = self._walkers
        return {
            "checkpoint": self._digest[:32],
            "arithmetic": f"{walkers.name}, {walkers.batch} at once",
        }

    @property
    def card_rows(self) -> tuple[tuple[str, str], ...]:
        """What it is, what it is shown, and how it chooses."""
        settings = self.settings
        return (
            ("weights", "retrained, small: not the published ones"),
            ("graph", settings.kind),
            ("pictures", ", ".join(settings.pictures) or "none"),
            ("words", "read" if settings.words else "none: goal-blind"),
            ("camera of training", settings.preset),
            ("actions", "the most probable, one a decision"),
            ("computed by", self._walkers.name),
        )

    def notes_of(self, slot: int) -> dict[str, int]:
        """What was odd in a slot's episode so far: nothing ever is."""
        del slot
        return {}

    def reset_batch(
        self,
        slots: Sequence[int],
        instructions: Sequence[str],
        rngs: Sequence[np.random.Generator],
    ) -> None:
        """Begin an episode in each slot.

        Raises:
            PolicyError: lengths differ, or a slot is named twice.
            ConfigError: an instruction is empty, or too long for the checkpoint.
        """
        check_slots(slots, instructions, rngs)
        length = self.settings.text_length
        read = self.settings.words
        ids = [encode_text(self._tokenizer, t, length) if read else [0] for t in instructions]
        for slot, own in zip(slots, ids, strict=True):
            self._walkers.begin(slot, own)

    def act_batch(self, slots: Sequence[int], observations: Sequence[Observation]) -> list[Action]:
        """The next action of each slot.

        Raises:
            PolicyError: lengths differ, a slot has no episode, or a picture is missing or of
                another size than the checkpoint was trained on.
        """
        check_slots(slots, observations)
        walkers = self._walkers
        missing = [slot for slot in slots if slot not in walkers]
        if missing:
            raise PolicyError(
                f"slot {missing[0]} of policy {self.name!r} has no episode",
                remedy="call reset_batch for it first",
            )
        shown = [self._show(one) for one in observations]
        actions: list[Action] = []
        for begin in range(0, len(slots), walkers.batch):
            some = slice(begin, begin + walkers.batch)
            actions += map(Action, walkers.step(slots[some], shown[some]))
        return actions

    def _show(self, seen: Observation) -> list[NDArray[Any]]:
        """Pictures of the net, in its order."""
        settings, found = self.settings, []
        for name, shape in settings.shapes.items():
            square = SQUARE_NAMES.index(name) if name in SQUARE_NAMES else None
            picture: Any = seen.read(name if square is None else "ego_map")
            if square is not None and picture is not None:
                width, height = settings.view.picture_size
                if picture.shape[:2] == (height, width):
                    picture = settings.view.split(picture)[square]
            if picture is None or picture.shape != shape:
                got = "missing" if picture is None else f"{picture.shape[1]}×{picture.shape[0]} px"
                raise PolicyError(
                    f"picture {name!r} is {got}, the checkpoint was trained on "
                    f"{shape[1]}×{shape[0]} px",
                    where=self.folder,
                    remedy=f"use camera preset {settings.preset} and the checkpoint's ego map",
                )
            found.append(picture)
        return found
