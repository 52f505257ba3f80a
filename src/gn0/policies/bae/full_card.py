"""A card that is too small, said in bytes and in our words."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

from gn0.errors import DeviceMemoryError


@contextmanager
def refuse_full_card(device: torch.device | str, what: str, remedy: str) -> Iterator[None]:
    """Turn torch's error of a full card into ours.

    Args:
        device: the card.
        what: does not fit it.
        remedy: what to do about it.

    Raises:
        DeviceMemoryError: the card is full; says how many bytes are free.
    """
    try:
        yield
    except torch.OutOfMemoryError as error:
        free, whole = torch.cuda.mem_get_info(device)
        ours = torch.cuda.memory_reserved(device)
        raise DeviceMemoryError(
            f"{what} does not fit on the card: {free} of its {whole} bytes are free, {ours} are "
            f"the model's and its steps', {whole - free - ours} scenes' and others'",
            where=str(device),
            remedy=remedy,
        ) from error
