"""Pictures and text to a model's input by transformers' own classes, without torchvision."""

from __future__ import annotations

from typing import Any

from transformers import PreTrainedTokenizerBase
from transformers.models.qwen2_vl.image_processing_pil_qwen2_vl import Qwen2VLImageProcessorPil
from transformers.models.qwen3_vl.processing_qwen3_vl import Qwen3VLProcessor

from gn0.policies.bae.tokenizer import CHAT


class ProcessorPictures(Qwen3VLProcessor):
    """Qwen3-VL's processor for pictures alone; that of videos needs torchvision."""

    def __init__(
        self, image_processor: Any = None, tokenizer: Any = None, chat_template: str | None = None,
        **kwargs: Any,
    ) -> None:  # fmt: skip
        kwargs.pop("video_processor", None)
        super().__init__(image_processor, tokenizer, None, chat_template=chat_template, **kwargs)
        self.video_processor = None


def build_processor(
    tokenizer: PreTrainedTokenizerBase, patch: int, *, least: int = 32, most: int = 1024
) -> ProcessorPictures:
    """A processor that leaves pictures of multiples of 2 · `patch` px as they are.

    Args:
        tokenizer: of the text.
        patch: side of a patch [px].
        least: smaller pictures are enlarged, to the area of a square of this side [px].
        most: larger pictures are reduced, likewise.
    """
    pictures = Qwen2VLImageProcessorPil(
        patch_size=patch,
        merge_size=2,
        temporal_patch_size=2,
        image_mean=[0.5] * 3,
        image_std=[0.5] * 3,
        size={"shortest_edge": least**2, "longest_edge": most**2},
    )
    return ProcessorPictures(pictures, tokenizer, chat_template=tokenizer.chat_template or CHAT)
