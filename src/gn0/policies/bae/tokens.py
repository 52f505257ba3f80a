"""Ids that a model's configuration and prompts need of its tokenizer."""

from __future__ import annotations

from dataclasses import dataclass

from gn0.data.navigation_vocabulary import NavigationVocabulary, TextTokenizer, load_vocabulary
from gn0.errors import CheckpointError, FormatError

PAD_ROWS = 64  # the embedding's rows are a multiple of this
SPECIALS = (
    "<|endoftext|>", "<|im_start|>", "<|im_end|>", "<|object_ref_start|>", "<|object_ref_end|>",
    "<|box_start|>", "<|box_end|>", "<|quad_start|>", "<|quad_end|>", "<|vision_start|>",
    "<|vision_end|>", "<|vision_pad|>", "<|image_pad|>", "<|video_pad|>",
)  # fmt: skip
"""Special tokens of Qwen2 and Qwen3, in their order."""

_NAMES = {
    "pad": "<|endoftext|>",
    "start": "<|im_start|>",
    "end": "<|im_end|>",
    "vision_start": "<|vision_start|>",
    "vision_end": "<|vision_end|>",
    "image": "<|image_pad|>",
    "video": "<|video_pad|>",
}


@dataclass(frozen=True)
class TokenIds:
    """Ids of a tokenizer.

    Attributes:
        pad, start, end: of padding, and of a turn's begin and end.
        vision_start, vision_end, image, video: around pictures, and in their places.
        vocabulary: of the tokens of answers, and how many rows the embedding has.
    """

    pad: int
    start: int
    end: int
    vision_start: int
    vision_end: int
    image: int
    video: int
    vocabulary: NavigationVocabulary


def find_token_ids(tokenizer: TextTokenizer) -> TokenIds:
    """Ids of a tokenizer that has the navigation tokens.

    Raises:
        CheckpointError: tokens are missing, <0> to <999> have gaps, or one is cut into several.
    """
    found = {name: tokenizer.find_id(token) for name, token in _NAMES.items()}
    missing = [_NAMES[name] for name, one in found.items() if one is None]
    if missing:
        raise CheckpointError(
            f"the tokenizer has no {', '.join(missing)}", remedy="use a tokenizer of Qwen3-VL"
        )
    rows = -(-len(tokenizer) // PAD_ROWS) * PAD_ROWS
    try:
        vocabulary = load_vocabulary(tokenizer, rows=rows)
    except FormatError as error:
        raise CheckpointError(
            error.what,
            where=error.field,
            remedy="load_checkpoint(grow=True) adds them to a tokenizer without any",
        ) from None
    ids = {name: one for name, one in found.items() if one is not None}
    return TokenIds(vocabulary=vocabulary, **ids)
