"""Named random streams: the only source of randomness.

A stream depends on its root seed and its names alone, never on the order in which streams are
opened, so the same seed gives the same bytes for any worker count, order or resume.
"""

from __future__ import annotations

import hashlib
import json

import numpy as np

from gn0.errors import FormatError


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


def save_stream(stream: np.random.Generator) -> str:
    """Where a stream of ours stands, as a text that `load_stream` goes on from."""
    return json.dumps(stream.bit_generator.state, default=lambda array: array.tolist())


def load_stream(text: str) -> np.random.Generator:
    """The stream of a text.

    Raises:
        FormatError: it is not the state of a stream.
    """
    bits = np.random.Philox(0)
    try:
        state = json.loads(text)
        for name, count in (("counter", 4), ("key", 2)):
            state["state"][name] = np.array(state["state"][name], np.uint64).reshape(count)
        state["buffer"] = np.array(state["buffer"], np.uint64).reshape(4)
        bits.state = state
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError) as error:
        raise FormatError(f"not a stream: {type(error).__name__}", where="stream") from None
    return np.random.Generator(bits)
