"""A model whose weights lie in parts on several cards: FSDP2, for what does not fit on one.

Each process holds its part of every weight, of its gradient and of what the optimiser remembers of
it. A block's weights are gathered while that block is computed, forward and on the way back, and
let go behind it; tables, projector and what else is no block are gathered for the whole step.

    shard_blocks(model, mesh)          # once the model has its weights, before it is on the card
    shard_rest(loss)                   # the whole that is called with batches
    gather_checkpoint(…), gather(…)    # whole again, in the first process
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from types import MethodType
from typing import Any
from weakref import ref

import torch
from torch import Tensor, nn
from torch.distributed.device_mesh import DeviceMesh, init_device_mesh
from torch.distributed.fsdp import (
    FSDPModule,
    MixedPrecisionPolicy,
    fully_shard,
    register_fsdp_forward_method,
)
from torch.distributed.tensor import DTensor
from transformers import Qwen3VLForConditionalGeneration

from gn0.errors import ConfigError
from gn0.policies.bae.checkpoint import Checkpoint
from gn0.policies.bae.forward import GATHERED
from gn0.training.processes import Processes, call_at_end
from gn0.training.runs.optimiser_state import OptimiserState
from gn0.training.runs.training_state import TrainingState


def open_mesh(processes: Processes, where: torch.device) -> DeviceMesh:
    """The processes in a row, each with its card; asked in all of them.

    Raises:
        ConfigError: one process alone, which has nobody to share with.
    """
    refuse_alone(processes)
    mesh = init_device_mesh(where.type, (processes.count,))
    call_at_end(partial(_release_mesh, mesh))
    return mesh


def refuse_alone(processes: Processes) -> None:
    """Refuse to share out weights among one process.

    Raises:
        ConfigError: it is alone.
    """
    if processes.count == 1:
        raise ConfigError(
            "weights of one process cannot be shared out",
            where="fsdp",
            remedy="start it by torchrun on several cards, or leave out --fsdp",
        )


def shard_blocks(model: Qwen3VLForConditionalGeneration, mesh: DeviceMesh) -> None:
    """Keep a part of each block's weights, on the mesh's device, and let go of the rest.

    Args:
        model: changed in place; all its weights are there, the same in all processes.
        mesh: of `open_mesh`.
    """
    policy = _choose_types(mesh)
    for block in list_blocks(model):
        _share_out(block, mesh, policy)
        setattr(block, GATHERED, MethodType(_compute, block))
        register_fsdp_forward_method(block, GATHERED)


def shard_rest(loss: nn.Module) -> None:
    """Keep a part of what `shard_blocks` left whole; the module is what is called each step."""
    mesh = next(one.device_mesh for one in loss.parameters() if isinstance(one, DTensor))
    _share_out(loss, mesh, _choose_types(mesh))


def list_blocks(model: Qwen3VLForConditionalGeneration) -> list[nn.Module]:
    """The layers of the tower and of the language model, which hold nearly all weights."""
    return [*model.model.visual.blocks, *model.model.language_model.layers]


def is_sharded(model: nn.Module) -> bool:
    """Whether a module's weights, or some of them, lie in parts."""
    return any(isinstance(module, FSDPModule) for module in model.modules())


def own_part(array: Tensor) -> Tensor:
    """What of an array is this process' own; all of it where it is not sharded."""
    return array.to_local() if isinstance(array, DTensor) else array


def lay_like(whole: Tensor, like: Tensor) -> Tensor:
    """An array laid out as another is: whole, or this process' part of it, which alone is sent."""
    if not isinstance(like, DTensor) or isinstance(whole, DTensor):
        return whole
    mesh, whole = like.device_mesh, whole.contiguous()
    parts = whole.chunk(mesh.size())  # as FSDP2 cuts: the last ones may be short, or empty
    rank = mesh.get_local_rank()
    own = parts[rank] if rank < len(parts) else whole[:0]
    return DTensor.from_local(
        own.to(like.device, copy=True), mesh, like.placements, run_check=False,
        shape=whole.shape, stride=whole.stride(),
    )  # fmt: skip


def gather(arrays: Mapping[str, Tensor], processes: Processes) -> dict[str, Tensor]:
    """Arrays as a whole: on the CPU in the first process, none in the others; asked in all.

    Those that lie whole in each process are given as they are.

    Raises:
        TrainingError: another process is gone.
    """
    return dict(_gather_each(arrays, processes))


def gather_into(
    model: Qwen3VLForConditionalGeneration | None,
    sharded: Qwen3VLForConditionalGeneration,
    processes: Processes,
) -> None:
    """Write a sharded model's weights over those of a whole one; asked in all processes.

    Args:
        model: in the first process; None in the others.
        sharded: what is read.
        processes: that hold it.
    """
    _reshard(sharded)
    own = {} if model is None else dict(model.named_parameters())
    with torch.no_grad():
        for name, weight in sharded.named_parameters():
            whole = processes.ask(partial(_whole, weight))
            if model is not None:
                own[name].copy_(whole)


def gather_checkpoint(checkpoint: Checkpoint, processes: Processes) -> Checkpoint:
    """A sharded model with all its weights on the CPU, in the first process; asked in all.

    The others are given what they have.
    """
    _reshard(checkpoint.model)
    found = gather(dict(checkpoint.model.named_parameters()), processes)
    if not processes.leads:
        return checkpoint
    model = build_hollow(checkpoint.model, "meta")
    model.load_state_dict(found, strict=False, assign=True)
    model.tie_weights()
    return replace(checkpoint, model=model.eval())


def gather_state(
    state: TrainingState, processes: Processes, *, with_optimiser: bool
) -> TrainingState:
    """A state with whole arrays on the CPU in the first process; asked in all.

    It is that of a run whose weights are not sharded, and any number of processes goes on from it.

    Args:
        state: of parts.
        processes: that hold them.
        with_optimiser: gather also what the optimiser remembers; else it is left out.
    """
    optimiser = state.optimiser if with_optimiser else None
    if optimiser is not None:
        optimiser = replace(optimiser, arrays=gather(optimiser.arrays, processes))
    return replace(
        state,
        checkpoint=gather_checkpoint(state.checkpoint, processes),
        averaged=gather(state.averaged, processes),
        arrays=gather(state.arrays, processes),
        optimiser=optimiser,
    )


def part_optimiser(state: OptimiserState, weights: Mapping[str, Tensor]) -> OptimiserState:
    """What an optimiser of these weights, which are sharded, remembers of a whole state.

    Args:
        state: of whole arrays.
        weights: by name.
    """

    def part(place: str, array: Tensor) -> Tensor:
        _, _, name = place.partition("/")
        like = weights.get(name)
        return array if like is None or array.shape != like.shape else lay_like(array, like)

    return replace(state, arrays={place: part(place, own) for place, own in state.arrays.items()})


def build_hollow(
    model: Qwen3VLForConditionalGeneration,
    device: torch.device | str,
    dtype: torch.dtype = torch.float32,
) -> Qwen3VLForConditionalGeneration:
    """A model of the same shape whose weights say nothing yet."""
    with torch.device("meta"):
        made = Qwen3VLForConditionalGeneration(model.config).to(dtype)
    if torch.device(device).type != "meta":
        made.to_empty(device=device)
        made.tie_weights()
    return made


def _share_out(module: nn.Module, mesh: DeviceMesh, policy: MixedPrecisionPolicy) -> None:
    call_at_end(partial(_release_module, ref(fully_shard(module, mesh=mesh, mp_policy=policy))))


def _release_mesh(mesh: DeviceMesh) -> None:
    """Let a mesh, which tables of PyTorch's keep for ever, let go of its group."""
    getattr(mesh, "_pg_registry", {}).clear()  # PyTorch 2.11 has it elsewhere


def _release_module(module: ref[nn.Module]) -> None:
    """Let a sharded module, if it is still there, let go of its group."""
    held: Any = module()
    state = None if held is None else held._get_fsdp_state()
    # by names of PyTorch's own, which another version may not have: then a thread lasts longer
    info = getattr(getattr(state, "_fsdp_param_group", None), "mesh_info", None)
    if info is not None:
        info.shard_process_group = None


def _choose_types(mesh: DeviceMesh) -> MixedPrecisionPolicy:
    """On cards blocks are gathered and computed in bfloat16, gradients summed in float32."""
    if mesh.device_type != "cuda":
        return MixedPrecisionPolicy(cast_forward_inputs=False)
    return MixedPrecisionPolicy(
        param_dtype=torch.bfloat16,
        reduce_dtype=torch.float32,
        cast_forward_inputs=False,  # rotary tables stay float32
    )


def _compute(block: nn.Module, compute: Any, *given: Any) -> Any:
    """What a function of a block gives: FSDP2 gathers its weights around this method.

    Keys and values are views, of which FSDP2 warns, and nobody learns by them.
    """
    found = compute(block, *given)
    if isinstance(found, tuple):
        return found[0], *(one.detach() for one in found[1:])
    return found


def _reshard(model: nn.Module) -> None:
    """Let go of what a forward without a way back has left gathered."""
    for module in model.modules():
        if isinstance(module, FSDPModule):
            module.reshard()


def _gather_each(
    arrays: Mapping[str, Tensor], processes: Processes
) -> Iterator[tuple[str, Tensor]]:
    for name, array in arrays.items():
        if not isinstance(array, DTensor):
            yield name, array
            continue
        whole = processes.ask(partial(_whole, array))
        if processes.leads:
            yield name, whole.cpu()
        del whole  # before the next: one at a time lies whole on a card


def _whole(array: Tensor) -> Tensor:
    found = array.detach()
    return found.full_tensor() if isinstance(found, DTensor) else found
