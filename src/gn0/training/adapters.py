"""LoRA: adapters of low rank learn beside weights that are frozen, by peft.

Linear layers of the language model and of the projector have adapters. The rows of the navigation
tokens learn as a whole: where a checkpoint was just given these tokens, all of them begin as the
same row, and adapters alone could never tell one from another. What is written in the end is a
plain model, the adapters added to its weights.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional
from transformers import Qwen3VLForConditionalGeneration

from gn0.errors import ConfigError
from gn0.policies.bae.tokens import TokenIds
from gn0.seeds import derive_seed
from gn0.training.pupil import Pupil
from gn0.training.recipe import Recipe

ADAPTED = (
    r".*language_model\.layers\.\d+\.(self_attn\.[qkvo]_proj|mlp\.(gate|up|down)_proj)"
    r"|.*visual\.(merger|deepstack_merger_list\.\d+)\.linear_fc[12]"
)
"""Layers that have adapters, by their names in the model."""

_NAME = "default"  # of the adapter, as peft calls it
_PARTS = ("lora_A", "lora_B")


class TableLearned(nn.Module):
    """A table of embeddings of which some rows learn, the rest being frozen.

    Args:
        base: the table, or a linear head without bias.
        ids: int64 [K] of the rows that learn.
        rows: float32 [K, hidden] of them; those of another table that is tied to this one.
    """

    def __init__(
        self, base: nn.Embedding | nn.Linear, ids: Tensor, rows: nn.Parameter | None = None
    ) -> None:
        super().__init__()
        self.base = base
        self.register_buffer("ids", ids, persistent=False)
        place = torch.full((len(base.weight),), -1, dtype=torch.int32)
        place[ids] = torch.arange(len(ids), dtype=torch.int32)
        self.register_buffer("place", place, persistent=False)
        if rows is None:
            self.rows = nn.Parameter(base.weight.detach()[ids].float().clone())
        else:
            self._lent = [rows]  # not a weight of this module: it is counted once

    def _rows(self) -> Tensor:
        found: Tensor = self._lent[0] if "_lent" in self.__dict__ else self.rows
        return found

    @property
    def weight(self) -> Tensor:
        """The whole table; a copy."""
        table = self.base.weight
        return table.index_copy(0, self._ids(), self._rows().to(table.dtype))

    def _ids(self) -> Tensor:
        found: Tensor = self.ids
        return found

    def forward(self, x: Tensor) -> Tensor:
        """Rows of ids [...], or logits of hidden states [..., hidden]."""
        if isinstance(self.base, nn.Linear):
            return functional.linear(x, self.weight)
        place: Tensor = self.place[x].long()
        own = functional.embedding(place.clamp(min=0), self._rows())
        plain: Tensor = self.base(x)
        return torch.where((place >= 0)[..., None], own.to(plain.dtype), plain)

    @torch.no_grad()
    def write(self) -> nn.Module:
        """The plain layer, with the rows as they are now."""
        self.base.weight.index_copy_(0, self._ids(), self._rows().to(self.base.weight.dtype))
        return self.base


def add_adapters(
    model: Qwen3VLForConditionalGeneration,
    ids: TokenIds,
    *,
    rank: int,
    scale: float = 2.0,
    seed: int = 0,
    dtype: torch.dtype | None = None,
) -> None:
    """Freeze a model and give it adapters, which say nothing yet.

    Args:
        model: changed in place; it answers as before.
        ids: of its tokenizer.
        rank: of the adapters.
        scale: of what they say: peft's alpha by rank.
        seed: of the adapters' weights.
        dtype: of the frozen weights; adapters are float32. None: as they are.

    Raises:
        ConfigError: the rank is below 1, or the model has adapters already.
    """
    from peft import LoraConfig, inject_adapter_in_model

    if rank < 1 or has_adapters(model):
        raise ConfigError(
            f"adapters of rank {rank}", where="lora", remedy="give a rank of 1 or more, once"
        )
    model.requires_grad_(False)
    if dtype is not None:
        model.to(dtype)
    config = LoraConfig(r=rank, lora_alpha=scale * rank, target_modules=ADAPTED, lora_dropout=0.0)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(derive_seed(seed, "adapters") % 2**63)
        inject_adapter_in_model(config, model)
    for name, weight in model.named_parameters():
        weight.requires_grad_(any(part in name for part in _PARTS))
        if weight.requires_grad:
            weight.data = weight.data.float()
    language, words = model.model.language_model, ids.vocabulary
    learned = torch.tensor(
        sorted({*range(words.number, words.number + 1000), *words.actions, words.begin,
                words.close})
    ).to(model.lm_head.weight.device)  # fmt: skip
    tied = language.embed_tokens.weight is model.lm_head.weight
    language.embed_tokens = TableLearned(language.embed_tokens, learned)
    rows = language.embed_tokens.rows if tied else None
    model.lm_head = TableLearned(model.lm_head, learned, rows)


def adapt_pupil(pupil: Pupil, recipe: Recipe, seed: int, where: torch.device) -> None:
    """Give a pupil the adapters of its recipe, if it has some; on a card the rest is bfloat16."""
    if recipe.lora:
        add_adapters(
            pupil.model,
            pupil.checkpoint.ids,
            rank=recipe.lora,
            scale=recipe.lora_scale,
            seed=seed,
            dtype=torch.bfloat16 if where.type == "cuda" else None,
        )


def has_adapters(model: nn.Module) -> bool:
    """Whether a model was given adapters that were not added to its weights yet."""
    return any(isinstance(module, TableLearned) for module in model.modules())


@torch.no_grad()
def merge_adapters(model: Qwen3VLForConditionalGeneration) -> None:
    """Make the model plain again: what its adapters learned is in its weights."""
    for name, module in list(model.named_modules()):
        if hasattr(module, "lora_A"):
            _put(model, name, _merge(module))
    for name, module in list(model.named_modules()):
        if isinstance(module, TableLearned):
            _put(model, name, module.write())
    model.requires_grad_(True)


def _merge(layer: Any) -> nn.Module:
    base: nn.Module = layer.get_base_layer()
    weight: Any = base.weight
    weight.copy_(weight.float() + layer.get_delta_weight(_NAME).float())
    return base


def _put(model: nn.Module, name: str, layer: nn.Module) -> None:
    parent, _, own = name.rpartition(".")
    setattr(model.get_submodule(parent), own, layer)
