"""Who computes a checkpoint's answers: torch where it is installed, NumPy anywhere."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from gn0.errors import ConfigError
from gn0.policies.bae.questions import I64, Questions, list_choices
from gn0.policies.qwen.model import answer_prompts, load_numpy_model, weigh_answers

BACKENDS = ("auto", "torch", "numpy")
U8 = NDArray[np.uint8]
F32 = NDArray[np.float32]
BATCH_CARD = 64  # decisions at once on a card


class Engine(Protocol):
    """Answers a batch of one shape.

    Attributes:
        name: what computes, for the protocol card and the identity of a run.
        batch: prompts at once.
    """

    name: str
    batch: int

    def answer(self, pictures: Sequence[U8], prompts: I64, draws: F32 | None = None) -> I64:
        """The most probable answers int64 [batch, slots].

        Args:
            pictures: uint8 [batch, H, W, 3] each, in the prompt's order.
            prompts: int64 [batch, P].
            draws: float32 [batch, slots], by which tokens are drawn instead (`pick_token`).
        """
        ...

    def weigh(
        self, pictures: Sequence[U8], prompts: I64, answers: I64
    ) -> dict[int, NDArray[np.float64]]:
        """How probable the choices of answers int64 [batch, slots] were; costs a second decision.

        Returns:
            by slot with a choice: float64 [batch, ids], at temperature 1, among the ids, rising,
            that make a readable answer there (`list_allowed`).
        """
        ...


class EngineNumpy:
    """The core install's: float32 on the CPU."""

    name = "NumPy, float32"

    def __init__(self, questions: Questions, batch: int, *, free: bool = False) -> None:
        self.batch = batch or 1
        self._layout = questions.layout
        slots, frame, said = questions.slots, questions.settings.frame, questions.place_said
        self._allowed = list_choices(slots, frame, free=free, said=said)
        self._readable = list_choices(slots, frame, said=said)
        self._model = load_numpy_model(questions.folder)

    def answer(self, pictures: Sequence[U8], prompts: I64, draws: F32 | None = None) -> I64:
        """See `Engine`."""
        return answer_prompts(self._model, self._layout, prompts, pictures, self._allowed, draws)

    def weigh(
        self, pictures: Sequence[U8], prompts: I64, answers: I64
    ) -> dict[int, NDArray[np.float64]]:
        """How probable the choices of answers were."""
        slots = self._readable
        return weigh_answers(self._model, self._layout, prompts, pictures, slots, answers)


class EngineTorch:
    """torch's: on a card where there is one."""

    def __init__(
        self,
        questions: Questions,
        batch: int,
        device: str,
        dtype: str,
        *,
        free: bool = False,
        drawn: bool = False,
    ) -> None:
        import torch

        from gn0.policies.bae.actor import Actor
        from gn0.policies.bae.checkpoint import load_checkpoint

        if device == "auto":
            device = "cuda" if torch.cuda.is_available() else "cpu"
        if device.startswith("cuda") and not torch.cuda.is_available():
            raise ConfigError("torch sees no GPU", where="device", remedy="give device=cpu")
        self.batch = batch or (BATCH_CARD if device.startswith("cuda") else 1)
        model = load_checkpoint(questions.folder).model.to(device)
        self._torch, self._device = torch, torch.device(device)
        kind = torch.bfloat16 if dtype == "bfloat16" else None
        self._readable = list_choices(
            questions.slots, questions.settings.frame, said=questions.place_said
        )
        self.name = f"torch, {dtype} on {self._device.type}"
        self._actor = Actor(
            model, questions.layout, questions.slots, questions.settings.frame, self.batch,
            dtype=kind, free=free, said=questions.place_said, drawn=drawn,
        )  # fmt: skip

    def answer(self, pictures: Sequence[U8], prompts: I64, draws: F32 | None = None) -> I64:
        """See `Engine`."""
        numbers = None if draws is None else self._send(draws)
        shown = [self._send(one) for one in pictures]
        said = self._actor.decide(shown, self._send(prompts), numbers)
        found: I64 = said.ids.cpu().numpy()
        return found

    def weigh(
        self, pictures: Sequence[U8], prompts: I64, answers: I64
    ) -> dict[int, NDArray[np.float64]]:
        """How probable the choices of answers were; in the weights' own precision."""
        forward = self._actor.forward
        with self._torch.no_grad():
            features = forward.encode([self._send(one) for one in pictures])
            hidden = forward.read(features, self._send(prompts), self._send(answers))
            return {
                k: forward.score(hidden[:, k], self._send(ids)).double().softmax(-1).cpu().numpy()
                for k, ids in enumerate(self._readable)
                if not isinstance(ids, int) and len(ids) > 1
            }

    def _send(self, array: NDArray[Any]) -> Any:
        return self._torch.from_numpy(array).to(self._device)


def open_engine(
    questions: Questions,
    backend: str,
    device: str,
    dtype: str,
    batch: int,
    *,
    free: bool = False,
    drawn: bool = False,
) -> Engine:
    """An engine for a checkpoint.

    Args:
        questions: of the checkpoint.
        backend: torch, numpy, or auto: torch where it is installed.
        device: of torch: cpu, cuda or auto.
        dtype: of torch: float32 or bfloat16.
        batch: prompts at once; 0: one, and 64 on a card.
        free: tokens are chosen among all that the model knows.
        drawn: answers may be given `draws`.

    Raises:
        ConfigError: a value is not among these, or torch is asked for and is not here.
        CheckpointError: the checkpoint cannot be read.
    """
    known = {"backend": (backend, BACKENDS), "dtype": (dtype, ("float32", "bfloat16"))}
    for name, (value, values) in known.items():
        if value not in values:
            raise ConfigError(
                f"no {name} {value!r}", where=name, remedy=f"known: {', '.join(values)}"
            )
    if not 0 <= batch <= 65_536:
        raise ConfigError(f"batches of {batch}", where="batch", remedy="give 0 to 65536")
    here = all(find_spec(name) for name in ("torch", "transformers"))
    if backend == "numpy" or (backend == "auto" and not here):
        return EngineNumpy(questions, batch, free=free)
    if not here:
        raise ConfigError(
            "torch and transformers are not installed",
            where="backend",
            remedy='pip install "gn0[train]", or give backend=numpy',
        )
    return EngineTorch(questions, batch, device, dtype, free=free, drawn=drawn)
