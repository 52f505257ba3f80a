"""What `gn0 policy examine` examines: GN-BAE, asked in one of its ways, or a recurrent baseline."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

import torch

from gn0.errors import ConfigError
from gn0.policies.bae.draws import check_draw_after
from gn0.policies.bae.policy_bae import digest_checkpoint
from gn0.policies.bae.shipped import TRAINED, find_checkpoint
from gn0.policies.bae.waypoint_plan import check_carried
from gn0.policies.cma.cma_checkpoint import digest_cma_checkpoint, load_cma_checkpoint
from gn0.policies.cma.cma_settings import FILE
from gn0.policies.cma.cma_words import encode_text
from gn0.policies.qwen.byte_pairs import read_byte_pairs
from gn0.sim.device_env import VectorEnvDevice
from gn0.training.exams.episode_loop import EpisodeLoop
from gn0.training.exams.evaluation import ClosedLoop
from gn0.training.exams.recurrent_examination import ClosedLoopRecurrent
from gn0.training.exams.walk_job import WalkJob
from gn0.training.pupil import Pupil, load_pupil
from gn0.training.streams.step_ring import find_torch_device
from gn0.training.worlds import Eyes


class Examined(Protocol):
    """A policy that walks.

    Attributes:
        settings: what it is shown.
        weights: digest of what its answers hang on.
        executed: actions of an answer that are carried out.
        draw_after: actions without getting anywhere after which answers are drawn; 0: never.
        length: tokens that it reads of a prompt or an instruction.
    """

    settings: Eyes
    weights: str
    executed: int
    draw_after: int
    length: int

    def fits(self, text: str) -> bool:
        """Whether it can be told an instruction."""
        ...

    def open_loop(self, world: VectorEnvDevice, dtype: torch.dtype | None) -> EpisodeLoop:
        """The loop that plays episodes with it, on the world's device."""
        ...


class ExaminedBae:
    """GN-BAE.

    Args:
        folder: of the checkpoint.
        job: how it is asked.

    Raises:
        CheckpointError: the folder is no policy.
        ConfigError: it has no such input, or no answer of its can be carried out so.
    """

    def __init__(self, folder: Path, job: WalkJob) -> None:
        self._pupil = pupil = _choose_input(load_pupil(folder), job.inputs)
        self._job, settings = job, pupil.settings
        if job.executed > settings.form.actions:
            raise ConfigError(
                f"{job.executed} actions of an answer cannot be carried out",
                where="executed",
                remedy=f"give 1 to {settings.form.actions}, or 0 for {settings.executed}",
            )
        check_carried(job.carried, settings.form.points)
        self.settings: Eyes = settings
        self.weights = digest_checkpoint(folder)
        self.executed = job.executed or settings.executed
        self.draw_after = check_draw_after(job.draw_after, settings.draw_after)
        self.length = settings.text_length

    def fits(self, text: str) -> bool:
        """Exactly, where `leave_out_long` leaves two tokens of room."""
        pupil = self._pupil
        if len(pupil.words.encode(text)) <= pupil.longest_text:
            return True
        try:
            pupil.table([text])
        except ConfigError:
            return False
        return True

    def open_loop(self, world: VectorEnvDevice, dtype: torch.dtype | None) -> EpisodeLoop:
        """See `Examined`."""
        self._pupil.model.to(find_torch_device(world)).eval()
        return ClosedLoop(
            world,
            self._pupil,
            dtype=dtype,
            executed=self.executed,
            draw_after=self.draw_after,
            confirm_stop=self._job.confirm_stop,
            carried=self._job.carried,
        )


class ExaminedRecurrent:
    """A recurrent baseline: the most probable action, one a decision.

    Args:
        folder: of the checkpoint.
        job: how it is asked.

    Raises:
        CheckpointError: the folder is no such policy.
        ConfigError: it cannot be asked so.
    """

    draw_after = 0
    executed = 1

    def __init__(self, folder: Path, job: WalkJob) -> None:
        odd = {
            "inputs": job.inputs, "executed": job.executed not in (0, 1),
            "draw_after": job.draw_after > 0, "confirm_stop": job.confirm_stop,
            "carried": job.carried != "actions",
        }  # fmt: skip
        for name, is_odd in odd.items():
            if is_odd:
                raise ConfigError(
                    "a recurrent baseline has one way of being asked, and says one action",
                    where=name,
                    remedy=f"leave {name} out",
                )
        checkpoint = load_cma_checkpoint(folder)
        self._net = checkpoint.model
        self.settings: Eyes = checkpoint.settings
        self._tokenizer = read_byte_pairs(checkpoint.tokenizer, folder)
        self.weights = digest_cma_checkpoint(folder)
        self.length = checkpoint.settings.text_length

    def fits(self, text: str) -> bool:
        """See `Examined`."""
        try:
            encode_text(self._tokenizer, text, self.length)
        except ConfigError:
            return False
        return True

    def open_loop(self, world: VectorEnvDevice, dtype: torch.dtype | None) -> EpisodeLoop:
        """See `Examined`."""
        net = self._net.to(find_torch_device(world)).eval()
        return ClosedLoopRecurrent(world, net, self._tokenizer, dtype)


def open_examined(job: WalkJob) -> Examined:
    """The policy of a job.

    Raises:
        CheckpointError: there is none, or it is damaged.
        ConfigError: it cannot be asked so.
    """
    named = Path(job.checkpoint).expanduser()
    for folder in (named, named / TRAINED):
        if job.checkpoint and (folder / FILE).is_file():
            return ExaminedRecurrent(folder, job)
    return ExaminedBae(find_checkpoint(job.checkpoint), job)


def _choose_input(pupil: Pupil, name: str) -> Pupil:
    """The policy as it is asked in one of its ways; itself when `name` is empty."""
    if not name:
        return pupil
    known: Mapping[str, Pupil] = pupil.inputs  # where it was trained in several
    if name not in known:
        raise ConfigError(
            f"the policy has no input {name!r}",
            where="inputs",
            remedy=f"known: {', '.join(known) or 'its only one; leave the option out'}",
        )
    return known[name]
