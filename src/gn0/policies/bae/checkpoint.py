"""Checkpoints: any Hugging Face folder of a Qwen3-VL in, one that stock transformers loads out."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from transformers import AutoTokenizer, PreTrainedTokenizerBase, Qwen3VLForConditionalGeneration
from transformers.utils import logging

from gn0.errors import CheckpointError, brief
from gn0.policies.bae.shard_file import write_shards
from gn0.policies.bae.tokenizer import add_missing_tokens, read_token_ids
from gn0.policies.bae.tokens import PAD_ROWS, TokenIds
from gn0.policies.qwen.architecture import load_architecture
from gn0.policies.qwen.model import check_shapes
from gn0.policies.qwen.weights import INDEX, MANIFEST, SINGLE, open_weights
from gn0.storage import folder_atomic, plain_path, write_json

SHARD_MB = 2000


@dataclass(frozen=True)
class Checkpoint:
    """A model with its tokenizer.

    Attributes:
        model: in evaluation mode.
        tokenizer: has the navigation tokens.
        ids: those that the model's configuration and prompts need.
    """

    model: Qwen3VLForConditionalGeneration
    tokenizer: PreTrainedTokenizerBase
    ids: TokenIds


def load_checkpoint(
    folder: Path | str, *, grow: bool = False, dtype: torch.dtype = torch.float32
) -> Checkpoint:
    """Load a folder with config.json, safetensors and a tokenizer; nothing is asked of the network.

    Args:
        folder: as `save_checkpoint` or stock transformers wrote it.
        grow: add navigation tokens where they are missing; their rows begin as the mean of all.
        dtype: of the weights.

    Raises:
        CheckpointError: no such model or tokenizer, not all of it, or no navigation tokens.
    """
    folder = plain_path(folder)
    architecture = load_architecture(folder)
    check_shapes(architecture, open_weights(folder))
    logging.disable_progress_bar()  # seconds at most, and lines that nobody asked for
    try:
        tokenizer = AutoTokenizer.from_pretrained(folder, local_files_only=True)
        model = Qwen3VLForConditionalGeneration.from_pretrained(
            folder, local_files_only=True, use_safetensors=True, dtype=dtype
        )
    except Exception as error:  # transformers has no error of its own
        what = f"transformers cannot load it: {brief(str(error))}"
        raise CheckpointError(what, where=folder) from error
    if grow and add_missing_tokens(tokenizer):
        with torch.no_grad():
            grow_vocabulary(model, len(tokenizer))
    try:
        ids = read_token_ids(tokenizer)
    except CheckpointError as error:
        raise CheckpointError(error.what, where=folder, remedy=error.remedy) from None
    rows = model.get_input_embeddings().weight.shape[0]
    if ids.vocabulary.size > rows:
        raise CheckpointError(
            f"the tokenizer has {ids.vocabulary.size} tokens, the model rows for {rows}",
            where=folder,
            remedy="the tokenizer is that of another checkpoint",
        )
    return Checkpoint(model.eval(), tokenizer, ids)


def grow_vocabulary(model: Qwen3VLForConditionalGeneration, tokens: int) -> None:
    """Rows for so many tokens, a multiple of 64; new ones begin as the mean of those before."""
    before = model.get_input_embeddings().weight.shape[0]
    if tokens <= before:
        return
    model.resize_token_embeddings(tokens, pad_to_multiple_of=PAD_ROWS, mean_resizing=False)
    for table in {model.get_input_embeddings().weight, model.get_output_embeddings().weight}:
        table.data[before:] = table.data[:before].float().mean(0).to(table.dtype)


def save_checkpoint(
    folder: Path | str,
    checkpoint: Checkpoint,
    *,
    shard_mb: int = SHARD_MB,
    dtype: torch.dtype = torch.bfloat16,
    overwrite: bool = False,
    card: str = "",
) -> None:
    """Write a folder that stock transformers and our NumPy twin load; all of it or nothing.

    `shards.json` states each shard's SHA-256, which `open_weights` checks.

    Args:
        folder: where to.
        checkpoint: model and tokenizer.
        shard_mb: bytes of a shard at most, in 10⁶; a single array may be larger.
        dtype: of the weights in the files.
        overwrite: replace a checkpoint that is there.
        card: text of the model card, README.md.

    Raises:
        StorageError: the folder cannot be written, or holds something else.
    """
    with folder_atomic(folder, overwrite=overwrite, marker=MANIFEST) as made:
        checkpoint.model.config.dtype = dtype
        checkpoint.model.config.save_pretrained(made)
        checkpoint.tokenizer.save_pretrained(made)
        hashes = _write_weights(made, checkpoint.model, shard_mb * 1_000_000, dtype)
        write_json(made / MANIFEST, hashes)
        if card:
            (made / "README.md").write_text(card, "utf-8")


def _write_weights(
    folder: Path, model: Qwen3VLForConditionalGeneration, limit: int, dtype: torch.dtype
) -> dict[str, str]:
    tied = bool(model.config.tie_word_embeddings)
    arrays = {
        name: array
        for name, array in model.state_dict().items()
        if not (tied and name == "lm_head.weight")
    }
    single = SINGLE.removesuffix(".safetensors")
    hashes, where = write_shards(folder, single, arrays.items(), limit, dtype)
    if len(hashes) > 1:
        total = sum(array.numel() for array in arrays.values()) * dtype.itemsize
        write_json(folder / INDEX, {"metadata": {"total_size": total}, "weight_map": where})
    return hashes
