"""What an agent is told, as sensors of the environments: a text, tokens, a number, or nothing.

The number is an index into the environment's `episodes`, for tables that a learner makes of their
texts; a device has no texts, but the same tokens and numbers.

Tokens are the bytes of the text in UTF-8: any language, no vocabulary file, nothing lost, the same
ids in every suite. They are numbered as the public byte-level tokeniser of ByT5 numbers them:

* 0 fills up, 1 ends the text, 2 is not used;
* 3 + b is byte b, so that "A" (65) is 68.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from gn0.errors import ConfigError
from gn0.missions.episode import Episode
from gn0.sim.sensor.table import check_sensors, sensor_names

WORDS: frozenset[str] = frozenset({"instruction", "instruction_tokens", "instruction_index"})
PAD, END, FIRST_BYTE = 0, 1, 3
TOKENS = FIRST_BYTE + 256  # size of the vocabulary
TOKEN_LIMIT = 512  # tokens of an instruction; a multiple of it where one is longer
TEXT_LIMIT = 1024  # characters, unless an instruction is longer
_PRINTABLE = frozenset(chr(c) for c in range(32, 127))


def split_sensors(names: Iterable[str]) -> tuple[frozenset[str], frozenset[str]]:
    """Sensor names of an environment: what is measured, and how the agent is told.

    Raises:
        ConfigError: a name is unknown; lists those that exist.
    """
    found = frozenset(names)
    known = WORDS.union(sensor_names())
    unknown = sorted(map(str, found - known))
    if unknown:
        raise ConfigError(
            f"no sensor named {unknown[0]!r}",
            remedy="known: " + ", ".join(sorted(known)),
        )
    return check_sensors(found - WORDS), found & WORDS


def word_spaces(words: Iterable[str], episodes: Sequence[Episode]) -> dict[str, spaces.Space[Any]]:
    """The observation space of each of these words, wide enough for all episodes."""
    found: dict[str, spaces.Space[Any]] = {}
    if "instruction" in words:
        found["instruction"] = text_space(episodes)
    if "instruction_tokens" in words:
        found["instruction_tokens"] = spaces.Box(0, TOKENS - 1, (token_length(episodes),), np.int32)
    if "instruction_index" in words:
        found["instruction_index"] = spaces.Box(0, 2**31 - 1, (), np.int32)
    return found


def encode_texts(episodes: Sequence[Episode], length: int) -> NDArray[np.int32]:
    """The instructions of episodes as tokens [E, length]; see `encode_text`."""
    return np.stack([encode_text(episode.instruction, length) for episode in episodes])


def text_space(episodes: Sequence[Episode]) -> spaces.Text:
    """A space that holds every instruction: printable ASCII and whatever else they use."""
    texts = [episode.instruction for episode in episodes]
    return spaces.Text(
        max_length=max(TEXT_LIMIT, *map(len, texts)),
        charset=_PRINTABLE.union(*map(set, texts)),
    )


def token_length(episodes: Sequence[Episode]) -> int:
    """How many tokens hold each of the instructions and its end: a multiple of TOKEN_LIMIT."""
    longest = max(len(episode.instruction.encode("utf-8", "replace")) for episode in episodes)
    return -(-(longest + 1) // TOKEN_LIMIT) * TOKEN_LIMIT


def encode_text(text: str, length: int) -> NDArray[np.int32]:
    """A text as `length` tokens: its bytes, the end, and filling; a longer one is cut."""
    data = np.frombuffer(text.encode("utf-8", "replace"), np.uint8)[: length - 1]
    tokens = np.full(length, PAD, np.int32)
    tokens[: len(data)] = data.astype(np.int32) + FIRST_BYTE
    tokens[len(data)] = END
    return tokens


def decode_tokens(tokens: NDArray[np.integer]) -> str:
    """The text that tokens stand for, up to its end."""
    data = np.asarray(tokens)
    ends = np.flatnonzero(data == END)
    data = data[: ends[0]] if len(ends) else data
    return bytes((data[data >= FIRST_BYTE] - FIRST_BYTE).tolist()).decode("utf-8", "replace")
