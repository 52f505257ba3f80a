"""Words of VLN-CE R2R: how a text is cut into them, and the one list that its models know.

Models of VLN-CE and of InternNav look a token up in `embeddings.json.gz`, 2,504 rows in the order
of R2R's own `word_list` (jacobkrantz/VLN-CE @729d141, `vlnce_baselines/config/default.py` 224 to
228 and `models/encoders/instruction_encoder.py` 35; InternRobotics/InternNav @7a5c624,
`internnav/configs/model/cma.py` 16 to 19). They do not look at the list that a file brings. So
tokens mean something to them only by that list, which any R2R file has and which is not ours to
ship. Texts are cut as habitat-lab cuts them, which gives all 11,597 texts of train and val_seen the
very tokens that the files have.
"""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from pathlib import Path

import msgspec

from gn0.errors import FormatError
from gn0.missions.sets.json_file import load_unpacked
from gn0.storage import storage_error

PAD, UNKNOWN = "<pad>", "<unk>"
PAD_INDEX, UNKNOWN_INDEX = 0, 1
R2R_COUNT = 2504
SHOWN = 12  # odd words told
# SHA-256 of R2R's words with a line break between each, the same in every split
R2R_DIGEST = "b945ae8224429b025bb83545383e3a2332bccc26f04900ab9954dfee3ff67f73"
_MARKS = re.compile(r"([^\w-]+)")


def cut_words(text: str) -> list[str]:
    """The words of a text: lower case, no commas or question marks, hyphens kept, marks apart."""
    plain = text.lower().replace(",", "").replace("?", "")
    return [part.strip() for part in _MARKS.split(plain) if part.strip()]


def own_words(texts: Iterable[Sequence[str]]) -> list[str]:
    """A list of the words of these texts, the common ones first."""
    counts = Counter(word for text in texts for word in text)
    return [PAD, UNKNOWN, *sorted(counts, key=lambda word: (-counts[word], word))]


def are_r2r_words(words: Sequence[str]) -> bool:
    """Whether it is R2R's list, word for word."""
    return (
        len(words) == R2R_COUNT
        and hashlib.sha256("\n".join(words).encode("utf-8", "replace")).hexdigest() == R2R_DIGEST
    )


def count_unknown(texts: Iterable[str], words: Iterable[str]) -> dict[str, int]:
    """Words of texts that a list lacks, and how often they come, the commonest first."""
    known = frozenset(words)
    counts = Counter(word for text in texts for word in cut_words(text) if word not in known)
    return dict(sorted(counts.items(), key=lambda item: (-item[1], item[0])))


def tell_unknown(counts: Mapping[str, int]) -> str:
    """A line about words that R2R's list lacks."""
    shown = ", ".join(f"{word} {count}" for word, count in list(counts.items())[:SHOWN])
    more = "" if len(counts) <= SHOWN else f" and {len(counts) - SHOWN} more"
    return f"words that R2R's vocabulary lacks, with how often they come: {shown}{more}"


class _Vocabulary(msgspec.Struct):
    word_list: list[str]


class _Document(msgspec.Struct):
    instruction_vocab: _Vocabulary


def load_r2r_words(path: Path | str) -> tuple[str, ...]:
    """R2R's words, from any file of VLN-CE R2R (`{split}.json.gz`).

    Raises:
        StorageError: missing or unreadable.
        FormatError: no such file, or one of another set; says what it holds instead.
    """
    try:
        stat = Path(path).stat()
    except OSError as error:
        raise storage_error(error, path, "read the vocabulary") from None
    return _load_words(str(path), stat.st_mtime_ns, stat.st_size)


@lru_cache(maxsize=2)
def _load_words(path: str, _changed: int, _size: int) -> tuple[str, ...]:
    data = load_unpacked(path)
    remedy = "give {split}.json.gz of VLN-CE's R2R, as R2R_VLNCE_v1-3_preprocessed has it"
    try:
        words = msgspec.json.decode(data, type=_Document).instruction_vocab.word_list
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise FormatError(
            f"no vocabulary in it: {error!s:.160}",
            file=path, field="instruction_vocab.word_list", remedy=remedy,
        ) from None  # fmt: skip
    if not are_r2r_words(words):
        raise FormatError(
            f"the vocabulary of another set: {len(words):,} words where R2R's has {R2R_COUNT:,}, "
            "or others; VLN-CE's models would look up the wrong rows",
            file=path, field="instruction_vocab.word_list", remedy=remedy,
        )  # fmt: skip
    return tuple(words)
