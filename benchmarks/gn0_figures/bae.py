"""Figures of the policy's model on a card: what training and deciding take, the learner alone."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional
from transformers import Qwen3VLConfig, Qwen3VLForConditionalGeneration

from gn0.data.navigation_vocabulary import NavigationVocabulary
from gn0.policies.bae.forward import ForwardConstant
from gn0.policies.bae.sizes import build_model
from gn0.policies.bae.tokens import TokenIds
from gn0.policies.qwen.architecture import parse_architecture
from gn0.policies.qwen.layout import PictureSize, PromptLayout, build_layout
from gn0.training.adapters import add_adapters
from gn0.training.learner import Learner
from gn0.training.recipe import Recipe
from gn0.training.rl.policy_gradient import AnswerBatch, PolicyLoss, PolicyLosses
from gn0_figures.board import Figure, FigureContext, FigureRow, FigureSkipped

BATCH, WORDS, ANSWER = 512, 40, 34
LARGE_BATCH, LARGE_ANSWER, LARGE_WORDS = 8, 106, 420
LARGE_SIZES = (*(PictureSize(640, 480),) * 2, *(PictureSize(768, 768),) * 2)
RANK = 16  # of adapters
ROOMY = 100e9  # bytes of a card that a step of all of 4B must fit
_FIRST = 1800  # id of <0>: any will do
_VOCABULARY = NavigationVocabulary(
    number=_FIRST, actions=(2805, 2802, 2803, 2804), begin=2800, close=2801, end=1702, size=2806,
    rows=2816,
)  # fmt: skip
IDS = TokenIds(
    pad=1700, start=1701, end=1702, vision_start=1709, vision_end=1710, image=1712, video=1713,
    vocabulary=_VOCABULARY,
)  # fmt: skip


def build_4b() -> Qwen3VLForConditionalGeneration:
    """Qwen3-VL-4B's geometry with random weights, on the default device."""
    text = {
        "vocab_size": 152_704, "hidden_size": 2560, "intermediate_size": 9728,
        "num_hidden_layers": 36, "num_attention_heads": 32, "num_key_value_heads": 8,
        "head_dim": 128, "max_position_embeddings": 32_768, "tie_word_embeddings": True,
        "bos_token_id": None, "eos_token_id": None, "pad_token_id": 0,
        "rope_parameters": {
            "rope_type": "default", "rope_theta": 5e6, "mrope_interleaved": True,
            "mrope_section": [24, 20, 20],
        },
    }  # fmt: skip
    vision = {
        "depth": 24, "hidden_size": 1024, "intermediate_size": 4096, "num_heads": 16,
        "patch_size": 16, "spatial_merge_size": 2, "temporal_patch_size": 2,
        "out_hidden_size": 2560, "num_position_embeddings": 2304,
        "deepstack_visual_indexes": [5, 11, 17],
    }  # fmt: skip
    config = Qwen3VLConfig(
        text_config=text, vision_config=vision, image_token_id=151_655, video_token_id=151_656,
        vision_start_token_id=151_652, vision_end_token_id=151_653, tie_word_embeddings=True,
    )  # fmt: skip
    return Qwen3VLForConditionalGeneration(config)


def lay_out(model: Any, sizes: list[PictureSize], words: int) -> PromptLayout:
    """Prompts with these pictures and so many words."""
    parts: list[int | PictureSize] = [1]
    for size in sizes:
        parts += [2, size, 3]
    return build_layout(parse_architecture(model.config.to_dict()), [*parts, *[5] * words, 4])


def draw_batch(
    layout: PromptLayout, batch: int, answer: int, device: str = "cuda"
) -> tuple[list[Tensor], Tensor, Tensor]:
    """Pictures, prompts and answers at random, on the card."""
    pictures = [
        torch.randint(0, 256, (batch, size.height, size.width, 3), dtype=torch.uint8).to(device)
        for size in layout.sizes
    ]
    ids = torch.from_numpy(np.tile(layout.ids, (batch, 1))).to(device)
    return pictures, ids, torch.randint(_FIRST, _FIRST + 1000, (batch, answer)).to(device)


def _learn(model: Any, forward: ForwardConstant, batch: int, answer: int) -> Callable[[], None]:
    """A step of SFT: forward, backward, AdamW, in bfloat16 but for weights and states."""
    pictures, ids, said = draw_batch(forward.layout, batch, answer)
    optimiser = torch.optim.AdamW(model.parameters(), 1e-5, fused=True)

    def step() -> None:
        with torch.autocast("cuda", torch.bfloat16):
            logits = forward.logits(forward.encode(pictures), ids, said)
        loss = functional.cross_entropy(logits.float().flatten(0, 1), said.flatten())
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        optimiser.step()

    return step


@dataclass(frozen=True)
class Large:
    """A large model that learns by adapters, or a small one in its place.

    Attributes:
        build: of random weights.
        sizes: of the pictures.
        words: of a prompt.
        batch: samples of a step, or answers to one prompt.
        answer: tokens.
        device: where.
    """

    build: Callable[[], Qwen3VLForConditionalGeneration]
    sizes: tuple[PictureSize, ...]
    words: int
    batch: int
    answer: int
    device: str


def learn_by_adapters(large: Large) -> Iterator[tuple[str, float, float, int]]:
    """A step of SFT and one of a policy gradient: what, seconds, bytes, weights that learn."""
    with torch.device(large.device):
        model = large.build().train()
    add_adapters(model, IDS, rank=RANK, dtype=torch.bfloat16)
    layout = lay_out(model, list(large.sizes), large.words)
    forward = ForwardConstant(model, layout, large.answer, checkpointed=True).to(large.device)
    recipe = Recipe(rate=1e-4, mean=0.0, distance_weight=0.0, decay=0.0)
    free, acts = np.arange(_FIRST, _FIRST + 1000), np.array(sorted(_VOCABULARY.actions))
    allowed = [np.array([4])] * large.answer
    allowed[:24], allowed[-6:] = [free] * 24, [acts] * 6  # as many are chosen as by a whole answer
    pictures, ids, said = draw_batch(layout, large.batch, large.answer, large.device)
    for slot, own in enumerate(allowed):
        one = torch.from_numpy(own).to(large.device)
        said[:, slot] = one[torch.arange(large.batch, device=large.device) % len(own)]
    loss = PolicyLoss(forward, allowed).to(large.device)
    learner = Learner[AnswerBatch, PolicyLosses](loss, recipe, autocast=torch.bfloat16)
    weights = sum(weight.numel() for weight in learner.weights.values())

    def teach() -> None:
        with torch.autocast(large.device, torch.bfloat16):
            logits = forward.logits(forward.encode(pictures), ids, said)
        cost = functional.cross_entropy(logits.float().flatten(0, 1), said.flatten())
        learner.optimiser.zero_grad(set_to_none=True)
        cost.backward()
        learner.update(1.0)

    shown = tuple(picture[:1] for picture in pictures)
    with torch.no_grad(), torch.autocast(large.device, torch.bfloat16):
        old = loss.score(shown, ids[:1], said).logprobs
    gains = torch.linspace(-1, 1, large.batch, device=large.device)
    answers = AnswerBatch(shown, ids[:1], said, old, gains, loss.chosen.expand(large.batch, -1))

    def reward() -> None:
        learner.step(answers, 1.0)

    for name, step in (("SFT", teach), ("a policy gradient", reward)):
        if large.device == "cuda":
            torch.cuda.reset_peak_memory_stats()
        seconds = _time(step, 1, 2 if large.device == "cuda" else 1)
        taken = torch.cuda.max_memory_allocated() if large.device == "cuda" else 0
        yield name, seconds, taken, weights


def _time(call: Callable[[], object], warm: int, times: int) -> float:
    """Seconds of a call, the mean of some after the warm ones."""
    for _ in range(warm):
        call()
    _wait()
    begin = time.perf_counter()
    for _ in range(times):
        call()
    _wait()
    return (time.perf_counter() - begin) / times


def _wait() -> None:
    if torch.cuda.is_available():
        torch.cuda.synchronize()


def measure_model(ctx: FigureContext) -> list[FigureRow]:
    """Samples and decisions a second of size tiny, and one step of training of 4B."""
    if not torch.cuda.is_available():
        raise FigureSkipped("needs a GPU: torch sees none")
    rows: list[FigureRow] = []

    def add(name: str, value: float, unit: str, detail: str) -> None:
        rows.append(FigureRow(name=name, value=value, unit=unit, detail=detail))
        ctx.report(rows[-1])

    free = torch.arange(_FIRST, _FIRST + 1000).cuda()
    slots = [free] * 24 + [free[:1]] + [free[:4]] * 6 + [free[:1]] * 2
    for count in (1, 2, 4):
        model = build_model("tiny", IDS).cuda().train()
        layout = lay_out(model, [PictureSize(128, 128)] * count, WORDS)
        forward = ForwardConstant(model, layout, ANSWER, compiled=True).cuda()
        torch.cuda.reset_peak_memory_stats()
        seconds = _time(_learn(model, forward, BATCH, ANSWER - 1), 4, 20)
        gigabytes = torch.cuda.max_memory_allocated() / 1e9
        detail = f"tiny, {count} pictures of 128 px, {len(layout)} + {ANSWER - 1} tokens, batch "
        detail += f"{BATCH}, bfloat16, compiled; pictures at random lie on the card; "
        rate = BATCH / seconds
        add(f"SFT samples a second, {count} pictures", rate, "1/s", f"{detail}{gigabytes:.3g} GB")
        plain = ForwardConstant(model.eval(), layout, ANSWER).cuda()
        pictures, ids, _ = draw_batch(layout, BATCH, 1)

        def decide(
            plain: ForwardConstant = plain, pictures: list[Tensor] = pictures, ids: Tensor = ids
        ) -> None:
            with torch.no_grad(), torch.autocast("cuda", torch.bfloat16):
                plain.sample(plain.encode(pictures), ids, slots)

        detail = f"tiny, {count} pictures of 128 px, {BATCH} at once, 30 free slots of 33, bfloat16"
        rate = BATCH / _time(decide, 2, 5)
        add(f"decisions a second, {count} pictures", rate, "1/s", f"{detail}, not compiled")
        del model, forward, plain, decide, pictures, ids
        torch.cuda.empty_cache()
    with torch.device("cuda"):
        model = build_4b().train()
    layout = lay_out(model, list(LARGE_SIZES), LARGE_WORDS)
    forward = ForwardConstant(model, layout, LARGE_ANSWER, checkpointed=True).cuda()
    torch.cuda.reset_peak_memory_stats()
    learn = _learn(model, forward, LARGE_BATCH, LARGE_ANSWER - 1)
    seconds, said = 0.0, ""
    try:
        seconds = _time(learn, 1, 2)
    except torch.OutOfMemoryError as error:
        if torch.cuda.get_device_properties(0).total_memory > ROOMY:
            raise
        said = str(error)
    millions = sum(weight.numel() for weight in model.parameters()) / 1e6
    detail = (
        f"4B's geometry, {millions:,.0f} M weights of float32 and AdamW's states, all trained, "
    )
    detail += (
        f"checkpointed, bfloat16 within; batch {LARGE_BATCH}, two views of 640×480, two maps of "
    )
    detail += f"768×768, {len(layout)} + {LARGE_ANSWER - 1} tokens"
    if said:
        add("a step of SFT of 4B that does not fit", LARGE_BATCH, "", f"{detail}: {said}")
    else:
        add("a step of SFT of 4B", seconds, "s", detail)
        add("memory that it takes", torch.cuda.max_memory_allocated() / 1e9, "GB", detail)
    del model, forward, learn
    return [*rows, *_measure_adapters(ctx)]


def _measure_adapters(ctx: FigureContext) -> list[FigureRow]:
    """Steps of 4B by adapters, for a card of 80 GB."""
    torch.cuda.empty_cache()
    rows = []
    large = Large(build_4b, LARGE_SIZES, LARGE_WORDS, LARGE_BATCH, LARGE_ANSWER - 1, "cuda")
    for name, seconds, taken, weights in learn_by_adapters(large):
        detail = (
            f"4B's geometry frozen in bfloat16, adapters of rank {RANK} and rows of navigation "
        )
        detail += f"tokens, {weights / 1e6:.3g} M weights, checkpointed; pictures as above, "
        detail += f"{LARGE_BATCH} {'samples' if name == 'SFT' else 'answers to one prompt'}"
        for what, value, unit in (
            (f"a step of {name} of 4B by adapters", seconds, "s"),
            (f"memory that {name} by adapters takes", taken / 1e9, "GB"),
        ):
            rows.append(FigureRow(name=what, value=value, unit=unit, detail=detail))
            ctx.report(rows[-1])
    return rows


FIGURES = [
    Figure("train.model", "The policy's model on a card", measure_model, 2.0, backend="cuda")
]
