"""What is trained: a model with its tokenizer, and how it is asked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import msgspec
import torch
from transformers import PreTrainedTokenizerBase, Qwen3VLForConditionalGeneration

from gn0.data.answer_slots import AnswerSlots, compile_slots
from gn0.geometry import Pose2D
from gn0.missions.controls import CONTROL_TEXT
from gn0.policies.bae.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from gn0.policies.bae.forward import ForwardConstant
from gn0.policies.bae.policy_settings import (
    PolicySettings,
    load_policy_settings,
    save_policy_settings,
)
from gn0.policies.bae.prompt_fields import PromptState, render_prompt
from gn0.policies.bae.prompt_table import PromptTable, build_prompt_table
from gn0.policies.bae.prompt_template import PromptTemplate
from gn0.policies.bae.sizes import build_model
from gn0.policies.bae.tokenizer import MERGES, read_token_ids, train_tokenizer
from gn0.policies.bae.tokenizer_file import TokenizerFile
from gn0.policies.qwen.architecture import Architecture, parse_architecture
from gn0.training.streams.samples import SampleMaker

_ROUND = 8  # texts' tokens are rounded up to a multiple of this


@dataclass(frozen=True)
class Pupil:
    """A policy in training.

    Attributes:
        checkpoint: model and tokenizer.
        settings: how it is asked.
        template: the prompt of the settings.
    """

    checkpoint: Checkpoint
    settings: PolicySettings
    template: PromptTemplate

    @property
    def model(self) -> Qwen3VLForConditionalGeneration:
        """The model."""
        return self.checkpoint.model

    @cached_property
    def architecture(self) -> Architecture:
        """The model's shape."""
        return parse_architecture(self.model.config.to_dict())

    @cached_property
    def words(self) -> TokenizerFile:
        """The tokenizer of texts and answers."""
        return TokenizerFile(self.checkpoint.tokenizer.backend_tokenizer)

    @cached_property
    def slots(self) -> AnswerSlots:
        """Of its answers."""
        return compile_slots(self.settings.form, self.checkpoint.ids.vocabulary, self.words)

    @cached_property
    def longest_text(self) -> int:
        """Tokens that an instruction may have; the rest of `settings.text_length` is the prompt's.

        Two are kept for where words of both meet, which the tokenizer may cut in another way.
        """
        own = _count_text(self, [CONTROL_TEXT]) - len(self.words.encode(CONTROL_TEXT))
        return self.settings.text_length - own - 2

    def table(self, texts: Sequence[str]) -> PromptTable:
        """Prompts of these instructions; the layout is the same whatever they are.

        Raises:
            ConfigError: one is empty, or longer than `settings.text_length`.
        """
        return build_prompt_table(
            self.template,
            [PromptState(text, self.settings.frame) for text in texts],
            self.settings.sizes,
            self.architecture,
            self.words,
            self.checkpoint.ids,
            text_length=self.settings.text_length,
        )

    def maker(self, texts: Sequence[str], device: torch.device | str) -> SampleMaker:
        """Makes batches of states whose episodes have these instructions."""
        return SampleMaker(self.table(texts), self.slots, self.settings.frame, device)

    def forward(self, table: PromptTable, **options: bool) -> ForwardConstant:
        """Its forward for these prompts, on the device where the model is; with its options."""
        forward = ForwardConstant(self.model, table.layout, len(self.slots), **options)
        return forward.to(self.model.device)

    def save(
        self, folder: Path | str, *, card: str = "", shard_mb: int = 2000, overwrite: bool = False
    ) -> None:
        """Write model, tokenizer, prompt and settings: what `gn0 bench run --policy bae` loads.

        Raises:
            StorageError: the folder cannot be written, or holds something else.
        """
        save_checkpoint(folder, self.checkpoint, card=card, shard_mb=shard_mb, overwrite=overwrite)
        save_policy_settings(folder, self.settings, self.template)


def build_pupil(
    size: str,
    settings: PolicySettings,
    texts: Sequence[str],
    *,
    tokenizer: PreTrainedTokenizerBase | None = None,
    merges: int = MERGES,
    seed: int = 0,
) -> Pupil:
    """A model of random weights that is asked in this way.

    Args:
        size: `nano` or `tiny`.
        settings: how it is asked; the length of texts becomes that of the longest of `texts`.
        texts: instructions, of training and of evaluation: they decide the length of prompts.
        tokenizer: one that has the navigation tokens; trained on `texts` when None.
        merges: of the tokenizer that is trained.
        seed: of the weights.

    Raises:
        ConfigError: no such size, or a text that cannot be asked.
        DataError: there are no texts.
    """
    template = settings.load_template()
    if tokenizer is None:
        tokenizer = train_tokenizer(_list_texts(template, settings, texts), merges)
    ids = read_token_ids(tokenizer)
    made = Checkpoint(build_model(size, ids, seed), tokenizer, ids)
    return fit_texts(Pupil(made, settings, template), texts)


def _list_texts(
    template: PromptTemplate, settings: PolicySettings, texts: Sequence[str]
) -> list[str]:
    """What the tokenizer is trained on: the texts, and what the prompt says beside them."""
    state = PromptState(CONTROL_TEXT, settings.frame, Pose2D(0, 0, 0))
    states = [state, replace(state, last_action=1, collided=True)]
    return [*texts, *(render_prompt(template, one).text for one in states)]


def load_pupil(folder: Path | str, *, dtype: torch.dtype = torch.float32) -> Pupil:
    """A policy that training wrote.

    Raises:
        CheckpointError: the folder holds none.
    """
    settings = load_policy_settings(folder)
    return Pupil(load_checkpoint(folder, dtype=dtype), settings, settings.load_template(folder))


def fit_texts(pupil: Pupil, texts: Sequence[str]) -> Pupil:
    """The same policy with prompts just long enough for the longest of these texts.

    Raises:
        ConfigError: one is empty or too long.
    """
    length = -(-_count_text(pupil, texts) // _ROUND) * _ROUND
    settings = msgspec.structs.replace(pupil.settings, text_length=length)
    return Pupil(pupil.checkpoint, settings, pupil.template)


def _count_text(pupil: Pupil, texts: Sequence[str]) -> int:
    """Tokens of the longest stretch of prompt that an episode decides."""
    table = build_prompt_table(
        pupil.template,
        [PromptState(text, pupil.settings.frame) for text in (CONTROL_TEXT, *texts)],
        pupil.settings.sizes,
        pupil.architecture,
        pupil.words,
        pupil.checkpoint.ids,
    )
    return max((c.table.shape[-1] for c in table.chunks if len(c.table) > 1), default=1)
