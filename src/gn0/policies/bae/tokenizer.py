"""Tokenizers: byte-level BPE trained on a corpus' language, and navigation tokens for any other."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from tokenizers import AddedToken, Regex, Tokenizer, decoders, normalizers, pre_tokenizers
from tokenizers.models import BPE
from tokenizers.trainers import BpeTrainer
from transformers import PreTrainedTokenizerBase
from transformers.models.qwen2.tokenization_qwen2 import PRETOKENIZE_REGEX, Qwen2Tokenizer

from gn0.data.codec import NAVIGATION_TOKENS, without_control_tokens
from gn0.errors import DataError
from gn0.policies.bae.tokenizer_file import TokenizerFile
from gn0.policies.bae.tokens import SPECIALS, TokenIds, find_token_ids
from gn0.storage import folder_atomic

MERGES = 1500  # enough for the language of generated missions
# turns of text and pictures, as Qwen3-VL's own template writes them; no tools, no videos
CHAT = (
    "{%- for message in messages -%}{{ '<|im_start|>' + message.role + '\n' }}"
    "{%- if message.content is string -%}{{ message.content }}{%- else -%}"
    "{%- for part in message.content -%}"
    "{%- if part.type == 'image' -%}<|vision_start|><|image_pad|><|vision_end|>"
    "{%- elif part.text is defined -%}{{ part.text }}{%- endif -%}"
    "{%- endfor -%}{%- endif -%}{{ '<|im_end|>\n' }}{%- endfor -%}"
    "{%- if add_generation_prompt -%}{{ '<|im_start|>assistant\n' }}{%- endif -%}"
)


def train_tokenizer(texts: Iterable[str], merges: int = MERGES) -> Qwen2Tokenizer:
    """A tokenizer of a corpus' language, with Qwen's special tokens and the navigation tokens.

    The same texts in any order give the same tokenizer. Control tokens in texts are taken out.

    Args:
        texts: instructions, and prompts without pictures.
        merges: pairs that become tokens; fewer where the texts have no more.

    Raises:
        DataError: there are no texts.
    """
    cleaned = sorted({without_control_tokens(text) for text in texts})
    if not any(text.strip() for text in cleaned):
        raise DataError("no texts to train a tokenizer on", remedy="name a dataset or a suite")
    model = Tokenizer(BPE(unk_token=None, byte_fallback=False))
    model.normalizer = normalizers.NFC()
    split = pre_tokenizers.Split(Regex(PRETOKENIZE_REGEX), behavior="isolated")
    bytes_only = pre_tokenizers.ByteLevel(add_prefix_space=False, use_regex=False)
    model.pre_tokenizer = pre_tokenizers.Sequence([split, bytes_only])
    model.decoder = decoders.ByteLevel()
    alphabet = sorted(pre_tokenizers.ByteLevel.alphabet())
    trainer = BpeTrainer(
        vocab_size=len(alphabet) + merges, initial_alphabet=alphabet, show_progress=False
    )
    model.train_from_iterator(cleaned, trainer)
    found = _read_model(model)
    tokenizer = Qwen2Tokenizer(
        vocab=found["vocab"],
        merges=[tuple(pair) for pair in found["merges"]],
        unk_token="<|endoftext|>",  # noqa: S106
        eos_token="<|im_end|>",  # noqa: S106
        pad_token="<|endoftext|>",  # noqa: S106
    )
    tokenizer.add_tokens([AddedToken(one, special=True, normalized=False) for one in SPECIALS])
    tokenizer.chat_template = CHAT
    add_missing_tokens(tokenizer)
    return tokenizer


def save_tokenizer(
    folder: Path | str, tokenizer: PreTrainedTokenizerBase, *, overwrite: bool = False
) -> None:
    """Write a tokenizer's folder, which stock transformers loads; all of it or nothing.

    Raises:
        StorageError: the folder cannot be written, or holds something else.
    """
    with folder_atomic(folder, overwrite=overwrite, marker="tokenizer.json") as made:
        tokenizer.save_pretrained(made)


def _read_model(model: Tokenizer) -> dict[str, Any]:
    return json.loads(model.to_str())["model"]


def add_missing_tokens(tokenizer: PreTrainedTokenizerBase) -> int:
    """Add those of the 1006 navigation tokens that are missing; returns how many were.

    They are no special tokens: `decode(skip_special_tokens=True)` would drop special ones.
    """
    plain = [AddedToken(one, special=False, normalized=False) for one in NAVIGATION_TOKENS]
    return int(tokenizer.add_tokens(plain))


def read_token_ids(tokenizer: PreTrainedTokenizerBase) -> TokenIds:
    """Ids of transformers' tokenizer; see `find_token_ids`.

    Raises:
        CheckpointError: as there.
    """
    return find_token_ids(TokenizerFile(tokenizer.backend_tokenizer))
