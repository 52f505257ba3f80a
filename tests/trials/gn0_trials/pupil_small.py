"""A model in training, its tokenizer and samples, small enough for a CPU."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

from gn0.data.answer_form import AnswerForm
from gn0.data.answer_slots import compile_slots
from gn0.data.codec import EgoFrame
from gn0.policies.bae.forward import ForwardConstant
from gn0.policies.bae.prompt_fields import PromptState
from gn0.policies.bae.prompt_table import build_prompt_table
from gn0.policies.bae.prompt_template import load_prompt
from gn0.policies.bae.sizes import build_model
from gn0.policies.bae.tokenizer import read_token_ids, train_tokenizer
from gn0.policies.bae.tokenizer_file import TokenizerFile
from gn0.policies.bae.tokens import TokenIds
from gn0.policies.qwen.architecture import parse_architecture
from gn0.policies.qwen.layout import PictureSize
from gn0.training.streams.samples import LabelledStates, SampleMaker

torch.set_num_threads(1)  # tests run beside each other; threads that wait for cores take them
FRAME = EgoFrame(32, 0.24, 0.65)
TEXTS = ("go to the sofa", "turn left at the door, then wait", "find a plant")


def make_words() -> tuple[Any, TokenIds]:
    """A tokenizer of the texts, and its ids."""
    tokenizer = train_tokenizer([*TEXTS, "PLANNING\nat heading last none bumper free hit"], 300)
    return tokenizer, read_token_ids(tokenizer)


class PupilSmall:
    """A model of size nano with random weights, and batches for it."""

    def __init__(self, words: tuple[Any, TokenIds], seed: int = 0, points: int = 13) -> None:
        tokenizer, ids = words
        own = TokenizerFile(tokenizer.backend_tokenizer)
        self.model = build_model("nano", ids, seed).train()
        self.ids, self.tokenizer = ids, tokenizer
        architecture = parse_architecture(self.model.config.to_dict())
        template = load_prompt("short", pictures=["near", "far"], points=points, frame="ego")
        self.slots = compile_slots(AnswerForm(points=points, layout="compact"), ids.vocabulary, own)
        sizes = dict.fromkeys(("near", "far"), PictureSize(32, 32))
        states = [PromptState(text, FRAME) for text in TEXTS]
        self.table = build_prompt_table(template, states, sizes, architecture, own, ids)
        self.maker = SampleMaker(self.table, self.slots, FRAME, "cpu")
        self.forward = self.forward_of(self.model)

    def forward_of(self, model: Any) -> ForwardConstant:
        """The forward of a model of this shape."""
        return ForwardConstant(model, self.table.layout, len(self.slots))


def draw_states(count: int, seed: int = 0) -> LabelledStates:
    """States at random."""
    stream = np.random.default_rng(seed)

    def send(array: Any) -> torch.Tensor:
        return torch.from_numpy(np.ascontiguousarray(array))

    way = stream.uniform(-1, 2.5, (count, 13, 2)).astype(np.float32)
    way[:, 0] = 0
    return LabelledStates(
        episode=send(stream.integers(0, len(TEXTS), count).astype(np.int32)),
        pose=send(stream.uniform(-3, 3, (count, 3))),
        last=send(stream.integers(-1, 4, count).astype(np.int8)),
        collided=send(stream.random(count) < 0.2),
        actions=send(stream.integers(0, 4, (count, 6)).astype(np.int8)),
        waypoints=send(way),
        distance=send(stream.uniform(0, 12, count)),
        pictures={
            name: send(stream.integers(0, 256, (count, 32, 32, 3), np.uint8))
            for name in ("near", "far")
        },
    )
