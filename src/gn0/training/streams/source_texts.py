"""What a tokenizer is trained on: instructions of suites and datasets, and GN0's own prompts.

Without torch, so that a source's faults are named wherever it is looked at.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from gn0.data.dataset import DATASET_FILE, open_dataset
from gn0.errors import DataError
from gn0.policies.bae.prompt_template import load_prompt, prompt_names
from gn0.suites.suite import load_suite

# what `short` leaves open, and the words of its fields
_OPEN = {"task": "PLANNING", "pictures": ["rgb"], "points": 13, "layout": "compact", "frame": "ego"}
FIELD_WORDS = "PLANNING\nTRACKING\nuser\nassistant\nlast none\nbumper free\nbumper hit"


def read_instructions(sources: Iterable[Path | str]) -> tuple[str, ...]:
    """Instructions of all episodes, source by source.

    Args:
        sources: suite or dataset folders.

    Raises:
        DataError: there are none.
        BenchError, StorageError, FormatError: a source is missing or damaged.
    """
    texts: list[str] = []
    for source in sources:
        if (Path(source) / DATASET_FILE).is_file():
            episodes = open_dataset(source).episodes
        else:
            episodes = load_suite(source).episodes
        texts += [episode.instruction for episode in episodes if episode.instruction.strip()]
    if not texts:
        raise DataError(
            "no instructions to train a tokenizer on",
            remedy="name suites or datasets whose episodes have texts",
        )
    return tuple(texts)


def prompt_texts() -> dict[str, str]:
    """What GN0's own prompts say beside their fields, by name."""
    found = {}
    for name in prompt_names():
        template = load_prompt(name, **(_OPEN if name == "short" else {}))  # type: ignore[arg-type]
        found[name] = "\n".join("".join(line.pieces[::2]) for line in template.lines)
    return {**found, "fields": FIELD_WORDS}
