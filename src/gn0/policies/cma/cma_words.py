"""Instructions as ids: byte-level BPE of the house, so no word is unknown and none is left out."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gn0.data.codec import without_control_tokens
from gn0.data.navigation_vocabulary import TextTokenizer
from gn0.errors import ConfigError, brief

CHARACTERS = 40  # of a text for each token that is read; longer ones are not even cut to pieces


def encode_text(tokenizer: TextTokenizer, text: str, length: int) -> list[int]:
    """Ids of an instruction; what reads as a control token is taken out.

    Args:
        tokenizer: of the checkpoint.
        text: the instruction.
        length: tokens that are read.

    Raises:
        ConfigError: it says nothing, or has more tokens.
    """
    cleaned = without_control_tokens(text).strip()
    if not cleaned:
        raise ConfigError(
            f"instruction {brief(text)} says nothing", where="instruction", remedy="write one"
        )
    if len(cleaned) > CHARACTERS * length:
        raise ConfigError(
            f"an instruction of {len(cleaned)} characters",
            where="instruction",
            remedy=f"shorten it: {length} tokens are read",
        )
    ids = list(tokenizer.encode(cleaned))
    if len(ids) > length:
        raise ConfigError(
            f"an instruction of {len(ids)} tokens, {length} are read: {brief(cleaned)}",
            where="instruction",
            remedy="shorten it, or train with a greater --text-length",
        )
    return ids


def tabulate_texts(
    tokenizer: TextTokenizer, texts: Sequence[str], length: int
) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Ids of E instructions, int32 [E, length], and how many each has, int64 [E]; 0 behind them.

    Raises:
        ConfigError: see `encode_text`.
    """
    table = np.zeros((len(texts), length), np.int32)
    counts = np.zeros(len(texts), np.int64)
    known: dict[str, list[int]] = {}
    for row, text in enumerate(texts):
        ids = known.get(text)
        if ids is None:
            ids = known[text] = encode_text(tokenizer, text, length)
        table[row, : len(ids)] = ids
        counts[row] = len(ids)
    return table, counts
