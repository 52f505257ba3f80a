"""What is trained: a model with its tokenizer, and how it is asked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import zip_longest
from pathlib import Path

import msgspec
import torch
from transformers import PreTrainedTokenizerBase, Qwen3VLForConditionalGeneration

from gn0.data.answer_slots import AnswerSlots, compile_slots
from gn0.data.codec import AnyFrame
from gn0.errors import ConfigError
from gn0.geometry import Pose2D
from gn0.missions.controls import CONTROL_TEXT
from gn0.policies.bae.checkpoint import Checkpoint, load_checkpoint, save_checkpoint
from gn0.policies.bae.forward import ForwardConstant
from gn0.policies.bae.policy_settings import (
    PolicySettings,
    join_inputs,
    load_policy_settings,
    save_policy_settings,
)
from gn0.policies.bae.prompt_fields import WIDEST, PromptState, render_prompt
from gn0.policies.bae.prompt_table import PromptTable, build_prompt_table
from gn0.policies.bae.prompt_template import PromptTemplate
from gn0.policies.bae.sizes import build_model
from gn0.policies.bae.tokenizer import MERGES, read_token_ids, train_tokenizer
from gn0.policies.bae.tokenizer_file import TokenizerFile
from gn0.policies.qwen.architecture import Architecture, parse_architecture
from gn0.sim.sensors import MapFrame
from gn0.training.streams.samples import SampleMaker, Stream, find_frames, pack_frames
from gn0.training.words_kept import keep_words

_ROUND = 8  # texts' tokens are rounded up to a multiple of this
_MEET = 2  # tokens kept for where a text and the prompt around it meet


@dataclass(frozen=True)
class Pupil:
    """A policy in training.

    A policy that is asked in several ways is trained in each: `inputs` has a pupil a way, and all
    of them share one model.

        for name, one in pupil.inputs.items():
            maker, forward = one.maker(texts, device), one.forward(one.table(texts))

    Attributes:
        checkpoint: model and tokenizer.
        settings: how it is asked.
        template: the prompt of the settings, of the default where there are several inputs.
        others: prompts of `settings.inputs`, by name; GN0's own are read where they are not here.
    """

    checkpoint: Checkpoint
    settings: PolicySettings
    template: PromptTemplate
    others: Mapping[str, PromptTemplate] = field(default_factory=dict)

    @cached_property
    def inputs(self) -> Mapping[str, Pupil]:
        """The pupil of each input, by name, the default first; itself where there is one alone."""
        if not self.settings.inputs:
            return {self.settings.input: self}
        known = {self.settings.input: self.template, **self.others}
        return {
            name: Pupil(self.checkpoint, own, known.get(name) or own.load_template())
            for name, own in self.settings.by_input.items()
        }

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
        return keep_words(self.checkpoint.tokenizer)

    @cached_property
    def slots(self) -> AnswerSlots:
        """Of its answers."""
        return compile_slots(self.settings.form, self.checkpoint.ids.vocabulary, self.words)

    @cached_property
    def longest_text(self) -> int:
        """Tokens that an instruction may have; the rest of `settings.text_length` is the prompt's.

        Two are kept for where words of both meet, which the tokenizer may cut in another way. Where
        there are several inputs, that of the one with least room.
        """
        if self.settings.inputs:
            return min(one.longest_text for one in self.inputs.values())
        return self.settings.text_length - _count_own(self) - _MEET

    def table(self, texts: Sequence[str], maps: Sequence[MapFrame] = ()) -> PromptTable:
        """Prompts of these instructions; the layout is the same whatever they are.

        Args:
            texts: instructions.
            maps: the whole map that each speaks of; read where coordinates are on it, and if none
                are given there, any.

        Raises:
            ConfigError: one is empty, or longer than `settings.text_length`.
        """
        own = self.settings.frame
        frames: Sequence[AnyFrame] = maps or WIDEST[:1] * len(texts) if own is None else ()
        states = [PromptState(text, own or frame) for text, frame in zip_longest(texts, frames)]
        return build_prompt_table(
            self.template,
            states,
            self.settings.sizes,
            self.architecture,
            self.words,
            self.checkpoint.ids,
            text_length=self.settings.text_length,
        )

    def maker(
        self,
        texts: Sequence[str],
        device: torch.device | str,
        maps: Sequence[MapFrame] | Callable[[], Sequence[MapFrame]] = (),
    ) -> SampleMaker:
        """Makes batches of states whose episodes have these instructions.

        Args:
            texts: instructions by episode number.
            device: of the states.
            maps: the whole map of each episode, or what finds them; read where coordinates are on
                it.

        Raises:
            ConfigError: coordinates are on whole maps, and none are given.
        """
        own = self.settings
        if own.frame is not None:
            return SampleMaker(self.table(texts), self.slots, own.frame, device, input=own.input)
        frames = maps() if callable(maps) else maps
        if len(frames) != len(texts):
            raise ConfigError(
                f"{len(frames)} maps of {len(texts)} episodes",
                where="maps",
                remedy="give the map of each: coordinates are on the whole of it",
            )
        table = self.table(texts, frames)
        return SampleMaker(table, self.slots, None, device, pack_frames(frames), own.input)

    def maker_of(self, stream: Stream, device: torch.device | str) -> SampleMaker:
        """Makes batches of a stream's states."""
        return self.maker(stream.texts, device, lambda: find_frames(stream))

    def forward(self, table: PromptTable, **options: bool) -> ForwardConstant:
        """Its forward for these prompts, on the device where the model is; with its options."""
        forward = ForwardConstant(self.model, table.layout, len(self.slots), **options)
        return forward.to(self.model.device)

    def save(
        self,
        folder: Path | str,
        *,
        card: str = "",
        shard_mb: int = 2000,
        dtype: torch.dtype = torch.bfloat16,
        overwrite: bool = False,
    ) -> None:
        """Write model, tokenizer, prompt and settings: what `gn0 bench run --policy bae` loads.

        Raises:
            StorageError: the folder cannot be written, or holds something else.
        """
        save_checkpoint(
            folder, self.checkpoint, card=card, shard_mb=shard_mb, dtype=dtype, overwrite=overwrite
        )
        save_policy_settings(folder, self.settings, self.template, self.others)


def choose_default(pupil: Pupil, name: str) -> Pupil:
    """The same policy, asked in another of its inputs where none is named.

    Raises:
        ConfigError: it has no such input; lists those that it has.
    """
    pupil.settings.choose(name)
    first, others = pupil.inputs[name], {k: p for k, p in pupil.inputs.items() if k != name}
    settings = join_inputs({name: first.settings, **{k: p.settings for k, p in others.items()}})
    prompts = {other: one.template for other, one in others.items()}
    return Pupil(pupil.checkpoint, settings, first.template, prompts)


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
    prompts = {name: (own, own.load_template()) for name, own in settings.by_input.items()}
    if tokenizer is None:
        said = [one for own, template in prompts.values() for one in _list_said(template, own)]
        tokenizer = train_tokenizer([*texts, *said], merges)
    ids = read_token_ids(tokenizer)
    made = Checkpoint(build_model(size, ids, seed), tokenizer, ids)
    return fit_texts(open_pupil(made, settings), texts)


def _list_said(template: PromptTemplate, settings: PolicySettings) -> list[str]:
    """What a prompt says beside the texts: the tokenizer is trained on it, too."""
    state = PromptState(CONTROL_TEXT, settings.frame or WIDEST[0], Pose2D(0, 0, 0))
    states = [state, replace(state, last_action=1, collided=True)]
    return [render_prompt(template, one).text for one in states]


def open_pupil(checkpoint: Checkpoint, settings: PolicySettings, folder: Path | str = "") -> Pupil:
    """A pupil with the prompts of all its inputs.

    Args:
        checkpoint: what learns.
        settings: how it is asked.
        folder: where prompts lie that are files of a user's own.

    Raises:
        ConfigError, FormatError, StorageError, CheckpointError: see `PolicySettings.load_template`.
    """
    found = {name: own.load_template(folder) for name, own in settings.by_input.items()}
    first = found.pop(settings.input)
    return Pupil(checkpoint, settings, first, found)


def load_pupil(folder: Path | str, *, dtype: torch.dtype = torch.float32) -> Pupil:
    """A policy that training wrote.

    Raises:
        CheckpointError: the folder holds none.
    """
    settings = load_policy_settings(folder)
    return open_pupil(load_checkpoint(folder, dtype=dtype), settings, folder)


def check_going_on(folder: Path | str, settings: PolicySettings) -> None:
    """Refuse to ask a policy in a way that its weights cannot go on with.

    Pictures, prompts and waypoints may be others than it was trained on.

    Raises:
        CheckpointError: the folder holds no policy.
        ConfigError: answers are laid out in another way.
    """
    known = {_lay_out(own) for own in load_policy_settings(folder).by_input.values()}
    for name, own in settings.by_input.items():
        if _lay_out(own) not in known:
            layout, order, actions = _lay_out(own)
            have = " or ".join(f"{one[0]}, {one[1]}, {one[2]} actions" for one in sorted(known))
            raise ConfigError(
                f"answers {f'of input {name!r} ' if name else ''}are {layout}, {order}, {actions} "
                f"actions; the policy answers {have}",
                where=folder,
                remedy="ask for answers as the policy gives them, or begin with random weights",
            )


def _lay_out(settings: PolicySettings) -> tuple[str, str, int]:
    return settings.form.layout, settings.form.order, settings.form.actions


def ask_anew(folder: Path | str, settings: PolicySettings, texts: Sequence[str]) -> Pupil:
    """A policy's weights and tokenizer, asked in another way than it was trained on.

    An input whose prompt has the words of one that the policy knows keeps its length: with eight
    tokens more than it was trained on, half of a policy's answers are others.

    Args:
        folder: of the policy.
        settings: how it is asked from now on; the length of texts becomes that of the longest of
        texts: instructions, where it is not kept.

    Raises:
        CheckpointError: the folder holds no policy.
        ConfigError: see `check_going_on` and `fit_texts`.
    """
    check_going_on(folder, settings)
    pupil = fit_texts(open_pupil(load_checkpoint(folder), settings, folder), texts)

    def tell_words(own: PolicySettings) -> tuple[str, tuple[str, ...]]:
        return Path(own.prompt).name, own.without  # one of the policy's own lies in its folder

    by_input = load_policy_settings(folder).by_input.values()
    known = {tell_words(own): own.text_length for own in by_input}
    kept = {
        name: msgspec.structs.replace(own, text_length=known.get(tell_words(own), own.text_length))
        for name, own in pupil.settings.by_input.items()
    }
    return replace(pupil, settings=join_inputs(kept))


def fit_texts(pupil: Pupil, texts: Sequence[str], *, shorten: bool = True) -> Pupil:
    """The same policy with prompts just long enough for the longest of these texts.

    Args:
        pupil: the policy, in all of its inputs.
        texts: instructions.
        shorten: whether prompts that are longer than that become shorter.

    Raises:
        ConfigError: one is empty or too long.
    """
    fitted = {}
    longest = max((len(pupil.words.encode(text)) for text in texts), default=0)
    for name, one in pupil.inputs.items():
        length = max(_count_text(one, texts), _count_own(one) + longest + _MEET)
        length = -(-length // _ROUND) * _ROUND
        if not shorten:
            length = max(length, one.settings.text_length)
        fitted[name] = msgspec.structs.replace(one.settings, text_length=length)
    return replace(pupil, settings=join_inputs(fitted))


def resize_texts(pupil: Pupil, length: int) -> Pupil:
    """The same policy with prompts that have so many tokens for what an episode says."""
    sized = {
        name: msgspec.structs.replace(own, text_length=length)
        for name, own in pupil.settings.by_input.items()
    }
    return replace(pupil, settings=join_inputs(sized))


def _count_own(pupil: Pupil) -> int:
    """Tokens of such a stretch that are the prompt's own."""
    return _count_text(pupil, [CONTROL_TEXT]) - len(pupil.words.encode(CONTROL_TEXT))


def _count_text(pupil: Pupil, texts: Sequence[str]) -> int:
    """Tokens of the longest stretch of prompt that an episode decides."""
    table = build_prompt_table(
        pupil.template,
        [
            PromptState(text, frame)
            for text in (CONTROL_TEXT, *texts)
            for frame in ([pupil.settings.frame] if pupil.settings.frame else WIDEST)
        ],
        pupil.settings.sizes,
        pupil.architecture,
        pupil.words,
        pupil.checkpoint.ids,
    )
    return max((c.table.shape[-1] for c in table.chunks if len(c.table) > 1), default=1)
