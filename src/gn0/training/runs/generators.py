"""Where torch's generators of random numbers stand, saved and put back."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from gn0.errors import CheckpointError, brief

_CPU, _CUDA, _OWN = "torch_cpu", "torch_cuda_", "own/"


def capture_generators(own: Mapping[str, torch.Generator] | None = None) -> dict[str, Tensor]:
    """States uint8 [n] of torch's generator, of each card's in use, and of generators of one's own.

    Args:
        own: by name.
    """
    states = {_CPU: torch.get_rng_state()}
    if torch.cuda.is_available() and torch.cuda.is_initialized():
        for card in range(torch.cuda.device_count()):
            states[f"{_CUDA}{card}"] = torch.cuda.get_rng_state(card)
    for name, generator in (own or {}).items():
        states[_OWN + name] = generator.get_state()
    return states


def restore_generators(
    states: Mapping[str, Tensor], own: Mapping[str, torch.Generator] | None = None
) -> tuple[str, ...]:
    """Put generators where they stood.

    Returns:
        What could not be put back here, in words: cards that this machine lacks.

    Raises:
        CheckpointError: the generators of one's own are others, or a state is none.
    """
    own = own or {}
    saved = {name.removeprefix(_OWN) for name in states if name.startswith(_OWN)}
    if saved != set(own):
        raise CheckpointError(
            f"generators {brief(sorted(saved))} were saved, {brief(sorted(own))} are to go on",
            remedy="resume with the recipe of the run",
        )
    lost: list[str] = []
    for name, state in states.items():
        try:
            if name.startswith(_OWN):
                own[name.removeprefix(_OWN)].set_state(state)
            elif name == _CPU:
                torch.set_rng_state(state)
            elif int(name.removeprefix(_CUDA)) < torch.cuda.device_count():
                torch.cuda.set_rng_state(state, int(name.removeprefix(_CUDA)))
            else:
                lost.append(f"no card {name.removeprefix(_CUDA)} here: its random numbers are new")
        except (RuntimeError, ValueError, TypeError) as error:
            raise CheckpointError(f"generator {brief(name)}: {brief(str(error))}") from None
    return tuple(lost)
