"""Tensors into safetensors files: synced to disk, hashed as they are written.

The library's own writer neither syncs nor tells a full disk from other faults. The format is in
`gn0.policies.qwen.weights`, which reads it.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from pathlib import Path

import torch

_TYPES = {
    torch.float32: "F32",
    torch.float16: "F16",
    torch.bfloat16: "BF16",
    torch.float64: "F64",
    torch.uint8: "U8",
    torch.int32: "I32",
    torch.int64: "I64",
}
_ALIGNED = 8  # bytes; as the library pads its headers


def write_shard(path: Path, arrays: Mapping[str, torch.Tensor]) -> str:
    """Write a safetensors file and sync it to disk.

    Args:
        path: where to.
        arrays: on any device, contiguous or not.

    Returns:
        SHA-256 of the file.

    Raises:
        OSError: the system refuses; the disk may be full.
    """
    # wide numbers first, so that each array begins where its type may be mapped
    order = sorted(arrays, key=lambda name: (-arrays[name].element_size(), name))
    header: dict[str, object] = {"__metadata__": {"format": "pt"}}
    end = 0
    for name in order:
        begin, end = end, end + count_bytes(arrays[name])
        header[name] = {
            "dtype": _TYPES[arrays[name].dtype],
            "shape": list(arrays[name].shape),
            "data_offsets": [begin, end],
        }
    head = json.dumps(header, separators=(",", ":")).encode()
    head += b" " * (-len(head) % _ALIGNED)
    digest = hashlib.sha256()
    with path.open("wb") as file:
        for data in (len(head).to_bytes(8, "little"), head):
            file.write(data)
            digest.update(data)
        for name in order:
            plain = arrays[name].detach().cpu().contiguous().reshape(-1)
            if plain.numel():
                view = memoryview(plain.view(torch.uint8).numpy())
                file.write(view)
                digest.update(view)
        file.flush()
        os.fsync(file.fileno())
    return digest.hexdigest()


def write_shards(
    folder: Path,
    name: str,
    arrays: Iterable[tuple[str, torch.Tensor]],
    limit: int,
    dtype: torch.dtype | None = None,
) -> tuple[dict[str, str], dict[str, str]]:
    """Write arrays as NAME.safetensors, or as NAME-00001-of-N.safetensors where one is not enough.

    Args:
        folder: must be there.
        name: of the files.
        arrays: by name, in this order.
        limit: bytes of a shard at most; a single array may be larger.
        dtype: of the arrays in the files; None leaves them as they are.

    Returns:
        SHA-256 of each file, and the file of each array.

    Raises:
        OSError: the system refuses; the disk may be full.
    """
    shards: list[dict[str, torch.Tensor]] = [{}]
    size = 0
    for key, array in arrays:
        own = array.numel() * (dtype or array.dtype).itemsize
        if shards[-1] and size + own > limit:
            shards.append({})
            size = 0
        shards[-1][key] = array
        size += own
    hashes: dict[str, str] = {}
    where: dict[str, str] = {}
    for number, shard in enumerate(shards, 1):
        many = f"-{number:05d}-of-{len(shards):05d}" if len(shards) > 1 else ""
        file = f"{name}{many}.safetensors"
        if dtype is not None:
            shard = {key: array.detach().to("cpu", dtype) for key, array in shard.items()}
        hashes[file] = write_shard(folder / file, shard)
        where |= dict.fromkeys(shard, file)
    return hashes, where


def count_bytes(array: torch.Tensor) -> int:
    """Bytes of a tensor's numbers."""
    return array.numel() * array.element_size()
