"""What an agent is told, as sensors of the environments: a text, tokens, a number, or nothing.

The number is an index into the environment's `episodes`, for tables that a learner makes of their
texts; a device has no texts, but the same tokens and numbers.

Tokens are the bytes of the text in UTF-8: any language, no vocabulary file, nothing lost, the same
ids in every suite. They are numbered as the public byte-level tokeniser of ByT5 numbers them:

* 0 fills up, 1 ends the text, 2 is not used;
* 3 + b is byte b, so that "A" (65) is 68.

A learner with a tokeniser of its own hands it to the environment as a `Vocabulary`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from gn0.errors import ConfigError, EpisodeError, brief
from gn0.missions.episode import Episode
from gn0.plugins import describe_error
from gn0.sim.sensor.table import check_sensors, sensor_names, several_names

WORDS: frozenset[str] = frozenset({"instruction", "instruction_tokens", "instruction_index"})
PAD, END, FIRST_BYTE = 0, 1, 3
TOKENS = FIRST_BYTE + 256  # size of the vocabulary
TOKEN_LIMIT = 512  # tokens of an instruction; a multiple of it where one is longer
TEXT_LIMIT = 1024  # characters, unless an instruction is longer
_PRINTABLE = frozenset(chr(c) for c in range(32, 127))


@dataclass(frozen=True)
class Vocabulary:
    """A tokeniser of the learner's own, in place of bytes.

    Attributes:
        encode: the tokens of a text, its end included if the learner wants one.
        size: tokens are 0 to size − 1.
        length: tokens of an observation; None: those of the longest text.
        pad: token that fills up.
    """

    encode: Callable[[str], Sequence[int]]
    size: int
    length: int | None = None
    pad: int = 0

    def __post_init__(self) -> None:
        long = self.length is None or self.length >= 1
        if not (long and 0 <= self.pad < self.size):
            raise ConfigError(
                f"a vocabulary of {self.size} tokens, {self.pad} of which fills up {self.length}",
                remedy="give a size and a length above 0, and a pad below the size",
            )

    def read(self, episode: Episode) -> NDArray[np.int32]:
        """The tokens of an episode's instruction, not filled up.

        Raises:
            EpisodeError: `encode` fails, or gives no such tokens.
        """
        try:
            found = np.asarray(self.encode(episode.instruction))
        except Exception as error:  # whatever a stranger's code raises
            raise _refuse(episode, f"cannot be tokenised: {describe_error(error)}") from error
        whole = found.ndim == 1 and (found.dtype.kind in "iu" or not found.size)
        if not whole or (found.size and not (found.min() >= 0 and found.max() < self.size)):
            raise _refuse(episode, f"gives something else than tokens from 0 to {self.size - 1}")
        return found.astype(np.int32)


def read_vocabulary(given: Vocabulary | Mapping[str, Any] | None) -> Vocabulary | None:
    """A vocabulary as it is given: itself, its fields, or None for bytes.

    Raises:
        ConfigError: it has other fields.
    """
    if not isinstance(given, Mapping):
        return given
    try:
        return Vocabulary(**given)
    except TypeError as error:
        raise ConfigError(
            f"no vocabulary has these fields: {error}",
            remedy="give encode and size, and length and pad if you like",
        ) from None


class WordTable:
    """The tokens of episodes' instructions [E, length]; each text is tokenised once.

    Args:
        episodes: by number.
        vocabulary: a tokeniser or its fields; bytes when None.

    Attributes:
        length: tokens of an instruction.
        size: of the vocabulary.
        rows: int32 [E, length], by number of the episode, as far as `extend` was told.

    Raises:
        EpisodeError: a text that cannot be tokenised, or is longer than `Vocabulary.length`.
    """

    def __init__(
        self,
        episodes: Sequence[Episode],
        vocabulary: Vocabulary | Mapping[str, Any] | None = None,
    ) -> None:
        self._vocabulary = vocabulary = read_vocabulary(vocabulary)
        self._texts: dict[str, NDArray[np.int32]] = {}
        self.size = TOKENS if vocabulary is None else vocabulary.size
        if vocabulary is None:
            self.length = token_length(episodes)
        elif vocabulary.length is not None:
            self.length = vocabulary.length
        else:
            self.length = max(1, *(len(self._encode(episode)) for episode in episodes))
        self.rows = np.zeros((0, self.length), np.int32)
        for episode in () if vocabulary is None else episodes:
            self.row(episode)  # it may be refused

    def extend(self, episodes: Sequence[Episode]) -> bool:
        """Add rows until there is one for each of `episodes`; whether there were any to add.

        Raises:
            EpisodeError: see `WordTable`; then nothing is added.
        """
        fresh = episodes[len(self.rows) :]
        if not len(fresh):
            return False
        self.rows = np.concatenate([self.rows, np.stack([self.row(episode) for episode in fresh])])
        return True

    def row(self, episode: Episode) -> NDArray[np.int32]:
        """The tokens of an instruction [length], filled up.

        Raises:
            EpisodeError: see `WordTable`.
        """
        if self._vocabulary is None:
            return encode_text(episode.instruction, self.length)
        tokens = self._encode(episode)
        if len(tokens) > self.length:
            raise _refuse(episode, f"has {len(tokens)} tokens, more than {self.length}")
        row = np.full(self.length, self._vocabulary.pad, np.int32)
        row[: len(tokens)] = tokens
        return row

    def _encode(self, episode: Episode) -> NDArray[np.int32]:
        assert self._vocabulary is not None
        if episode.instruction not in self._texts:
            self._texts[episode.instruction] = self._vocabulary.read(episode)
        return self._texts[episode.instruction]


def _refuse(episode: Episode, wrong: str) -> EpisodeError:
    return EpisodeError(
        f"the instruction {wrong}",
        where=f"episode {episode.id!r}",
        remedy="give a Vocabulary of that size and length, or leave the episode out",
    )


def _name_sensor(name: object) -> str:
    return name if isinstance(name, str) else brief(name)


def split_sensors(names: Iterable[str]) -> tuple[frozenset[str], frozenset[str]]:
    """Sensor names of an environment: what is measured, and how the agent is told.

    Raises:
        ConfigError: a name is unknown; lists those that exist.
    """
    found = frozenset(map(_name_sensor, several_names(names)))
    known = WORDS.union(sensor_names())
    unknown = sorted(map(str, found - known))
    if unknown:
        raise ConfigError(
            f"no sensor named {unknown[0]!r}",
            remedy="known: " + ", ".join(sorted(known)),
        )
    return check_sensors(found - WORDS), found & WORDS


def word_spaces(
    words: Iterable[str], episodes: Sequence[Episode], table: WordTable | None = None
) -> dict[str, spaces.Space[Any]]:
    """The observation space of each of these words, wide enough for all episodes.

    `table` has the tokens, where they are among the words.
    """
    found: dict[str, spaces.Space[Any]] = {}
    if "instruction" in words:
        found["instruction"] = text_space(episodes)
    if "instruction_tokens" in words:
        known = table or WordTable(episodes)
        found["instruction_tokens"] = spaces.Box(0, known.size - 1, (known.length,), np.int32)
    if "instruction_index" in words:
        found["instruction_index"] = spaces.Box(0, 2**31 - 1, (), np.int32)
    return found


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
