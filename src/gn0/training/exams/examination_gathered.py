"""The examination of a policy whose weights lie in parts: a whole copy of it answers and walks."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import torch

from gn0.training.exams.examination import Examination, Lender
from gn0.training.learner import Learner
from gn0.training.pupil import Pupil
from gn0.training.sharding import build_hollow, gather_into


@dataclass(frozen=True)
class WeightsWhole:
    """Lends a copy that has the averaged weights already; see `Lender`."""

    autocast: torch.dtype | None

    @contextmanager
    def averaged_weights(self) -> Iterator[None]:
        """Nothing to do."""
        yield


class ExaminationGathered:
    """Called in all processes: weights come to the first one, which examines; the others wait.

    The copy lies on the first process' card as long as the run lasts, in the type in which steps
    are computed.

    Args:
        pupil: what is examined.
        learner: whose weights it has; sharded.
        open_examination: of a pupil and whom it asks for weights, in the first process.
    """

    def __init__(
        self,
        pupil: Pupil,
        learner: Learner[Any, Any],
        open_examination: Callable[[Pupil, Lender], Examination],
    ) -> None:
        self.learner = learner
        self._model, self._examination = None, None
        if learner.processes.leads:
            dtype = learner.autocast or torch.float32
            self._model = build_hollow(pupil.model, learner.device, dtype)
            self._model.requires_grad_(False).eval()
            copy = replace(pupil, checkpoint=replace(pupil.checkpoint, model=self._model))
            self._examination = open_examination(copy, WeightsWhole(learner.autocast))

    def __call__(self) -> Mapping[str, float]:
        """What was measured, in the first process; nothing in the others."""
        learner = self.learner
        with learner.averaged_weights():
            gather_into(self._model, learner.model, learner.processes)
        return {} if self._examination is None else self._examination()
