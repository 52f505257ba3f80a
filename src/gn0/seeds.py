"""Named random streams: the only source of randomness.

A stream depends on its root seed and its names alone, never on the order in which streams are
opened, so the same seed gives the same bytes for any worker count, order or resume.
"""

from __future__ import annotations

import hashlib

import numpy as np


def derive_seed(root: int, *names: str | int) -> int:
    """A 128-bit seed from a root seed and names (blake2b, length-prefixed, typed)."""
    digest = hashlib.blake2b(digest_size=16)
    for name in (root, *names):
        token = f"{type(name).__name__[0]}{name}".encode()
        digest.update(len(token).to_bytes(4, "little") + token)
    return int.from_bytes(digest.digest(), "little")


def random_stream(root: int, *names: str | int) -> np.random.Generator:
    """An independent Philox generator for `names` under `root`."""
    return np.random.Generator(np.random.Philox(key=derive_seed(int(root), *names)))
