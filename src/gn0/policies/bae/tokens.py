"""Ids that a model's configuration needs of its tokenizer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

from gn0.errors import CheckpointError

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
    "first_bin": "<0>",
}


@dataclass(frozen=True)
class TokenIds:
    """Ids of a tokenizer.

    Attributes:
        pad, start, end: of padding, and of a turn's begin and end.
        vision_start, vision_end, image, video: around pictures, and in their places.
        first_bin: of <0>; <1> to <999> follow.
        size: tokens of the tokenizer.
    """

    pad: int
    start: int
    end: int
    vision_start: int
    vision_end: int
    image: int
    video: int
    first_bin: int
    size: int

    @property
    def rows(self) -> int:
        """Rows of the embedding."""
        return -(-self.size // PAD_ROWS) * PAD_ROWS


def find_token_ids(find_id: Callable[[str], int | None], size: int) -> TokenIds:
    """Ids by a tokenizer's own table.

    Args:
        find_id: id of a token, None where there is none.
        size: tokens of the tokenizer.

    Raises:
        CheckpointError: a token is missing.
    """
    found = {name: find_id(token) for name, token in _NAMES.items()}
    missing = [_NAMES[name] for name, one in found.items() if one is None]
    if missing:
        raise CheckpointError(
            f"the tokenizer has no {', '.join(missing)}",
            remedy="use a tokenizer of Qwen3-VL; load_checkpoint(grow=True) adds navigation tokens",
        )
    assert {field.name for field in fields(TokenIds)} == {*found, "size"}
    return TokenIds(size=size, **{name: one for name, one in found.items() if one is not None})
