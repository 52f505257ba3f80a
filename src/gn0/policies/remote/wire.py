"""The wire format: msgpack with arrays, read as if written by an attacker.

A message is msgpack and nothing else, in one binary WebSocket frame: no magic and no length come
before the map's type byte. `PolicyRemote._ask` has a question's keys, answers.py an answer's.
An array is a map with the byte-string keys `__ndarray__`, `data`, `dtype` (NumPy's type string) and
`shape`; a NumPy scalar has `__npgeneric__`, `data` and `dtype`. Writing gives the same bytes as the
`msgpack` package. Reading checks each count against the bytes that are left before anything is made
of it, knows the types by an allow-list, and takes no extension types.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any, NoReturn

import msgspec
import numpy as np

from gn0.errors import FormatError

ARRAY, SCALAR = b"__ndarray__", b"__npgeneric__"
_NAMES = ("uint8", "int8", "uint16", "int16", "uint32", "int32", "uint64", "int64",
          "float16", "float32", "float64", "bool")  # fmt: skip
DTYPES: dict[str, np.dtype[Any]] = {name: np.dtype(name) for name in _NAMES}
for _dtype in list(DTYPES.values()):
    for _other in (_dtype.newbyteorder("<"), _dtype.newbyteorder(">")):
        DTYPES[_other.str] = _other
_REMEDY = "send msgpack as in docs/policies.md"


@dataclass(frozen=True)
class WireLimits:
    """What a message may hold.

    Attributes:
        size: bytes of a message.
        values: numbers, texts, lists and maps in a message, an array counting as a few.
        depth: lists and maps within each other.
        text: bytes of a text.
        dimensions: of an array.
    """

    size: int = 256 << 20
    values: int = 100_000
    depth: int = 16
    text: int = 1 << 20
    dimensions: int = 8


REQUEST_LIMITS = WireLimits(size=16 << 20)
REPLY_LIMITS = WireLimits(size=4 << 20)


def encode_message(value: Any, *, text_keys: bool = False) -> bytes:
    """A value of None, bool, int, float, str, bytes, lists, maps and NumPy arrays as a message.

    Args:
        value: the value.
        text_keys: write the keys inside of arrays as texts, not as byte strings, for peers whose
            maps have no others (JavaScript).

    Raises:
        FormatError: it holds something else.
    """
    try:
        return (_ENCODER_TEXT if text_keys else _ENCODER).encode(value)
    except (TypeError, ValueError, OverflowError, RecursionError) as error:
        raise FormatError(
            f"cannot be sent: {error}",
            where="message",
            remedy="send numbers, texts, lists, maps and plain arrays",
        ) from None


def _pack(value: Any) -> Any:
    """Arrays and NumPy scalars as the maps that stand for them."""
    if isinstance(value, np.ndarray | np.generic):
        if value.dtype.kind not in "biuf":
            raise TypeError(f"an array of dtype {value.dtype}")
        if isinstance(value, np.generic):
            return {SCALAR: True, b"data": value.item(), b"dtype": value.dtype.str}
        return {
            ARRAY: True,
            b"data": value.tobytes(),
            b"dtype": value.dtype.str,
            b"shape": value.shape,
        }
    raise TypeError(f"a {type(value).__name__}")


def _pack_text(value: Any) -> Any:
    return {_text(key): held for key, held in _pack(value).items()}


def _text(key: str | bytes) -> str:
    return key.decode() if isinstance(key, bytes) else key


_ENCODER = msgspec.msgpack.Encoder(enc_hook=_pack)
_ENCODER_TEXT = msgspec.msgpack.Encoder(enc_hook=_pack_text)


def decode_message(data: bytes, limits: WireLimits = REQUEST_LIMITS) -> Any:
    """The value of a message: keys as texts, whichever they are, arrays as read-only NumPy arrays.

    Raises:
        FormatError: not msgpack, truncated, trailed by other bytes, beyond the limits, or an array
            that is not what it says.
    """
    if len(data) > limits.size:
        raise FormatError(
            f"{len(data)} bytes, more than the {limits.size} allowed",
            where="message",
            remedy="send less at a time",
        )
    reader = _Reader(data, limits)
    value = reader.value(limits.depth)
    if reader.at != len(data):
        reader.refuse(f"{len(data) - reader.at} bytes follow the message")
    return value


_FIXED = {
    0xCA: (">f", 4), 0xCB: (">d", 8), 0xCC: (">B", 1), 0xCD: (">H", 2), 0xCE: (">I", 4),
    0xCF: (">Q", 8), 0xD0: (">b", 1), 0xD1: (">h", 2), 0xD2: (">i", 4), 0xD3: (">q", 8),
}  # fmt: skip
_LENGTHS = {
    0xC4: 1, 0xC5: 2, 0xC6: 4, 0xD9: 1, 0xDA: 2, 0xDB: 4, 0xDC: 2, 0xDD: 4, 0xDE: 2, 0xDF: 4,
}  # fmt: skip


class _Reader:
    """Reads one message from its first byte to its last."""

    def __init__(self, data: bytes, limits: WireLimits) -> None:
        self.data = data
        self.limits = limits
        self.at = 0
        self.left = limits.values

    def refuse(self, what: str, field: str = "") -> NoReturn:
        raise FormatError(what, where="message", offset=self.at, field=field, remedy=_REMEDY) from (
            None
        )

    def take(self, count: int) -> int:
        """Move past `count` bytes and say where they began."""
        begin = self.at
        if count > len(self.data) - begin:
            self.refuse(f"{count} bytes announced, {len(self.data) - begin} left")
        self.at = begin + count
        return begin

    def value(self, depth: int) -> Any:
        if self.left <= 0:
            self.refuse(f"more than {self.limits.values} values")
        self.left -= 1
        code = self.data[self.take(1)]
        if code <= 0x7F:
            return code
        if code >= 0xE0:
            return code - 0x100
        if code <= 0x8F:
            return self.mapping(code & 0x0F, depth)
        if code <= 0x9F:
            return self.sequence(code & 0x0F, depth)
        if code <= 0xBF:
            return self.text(code & 0x1F)
        if code in (0xC0, 0xC2, 0xC3):
            return {0xC0: None, 0xC2: False, 0xC3: True}[code]
        if code in _FIXED:
            form, size = _FIXED[code]
            return struct.unpack_from(form, self.data, self.take(size))[0]
        if code not in _LENGTHS:
            self.at -= 1
            self.refuse(f"type byte 0x{code:02x} is not allowed")
        width = _LENGTHS[code]
        begin = self.take(width)
        count = int.from_bytes(self.data[begin : begin + width], "big")
        if code <= 0xC6:
            begin = self.take(count)
            return self.data[begin : begin + count]
        if code <= 0xDB:
            return self.text(count)
        return (self.sequence if code <= 0xDD else self.mapping)(count, depth)

    def text(self, count: int) -> str:
        if count > self.limits.text:
            self.refuse(f"a text of {count} bytes, {self.limits.text} allowed")
        begin = self.take(count)
        try:
            return self.data[begin : begin + count].decode()
        except UnicodeDecodeError:
            self.refuse("a text that is not UTF-8")

    def room(self, count: int, depth: int) -> None:
        """Refuse a count of values that the message cannot hold."""
        if depth <= 0:
            self.refuse(f"nested deeper than {self.limits.depth}")
        if count > min(len(self.data) - self.at, self.left):
            self.refuse(f"{count} values announced, {len(self.data) - self.at} bytes left")

    def sequence(self, count: int, depth: int) -> list[Any]:
        self.room(count, depth)
        return [self.value(depth - 1) for _ in range(count)]

    def mapping(self, count: int, depth: int) -> Any:
        self.room(2 * count, depth)
        found: dict[Any, Any] = {}
        for _ in range(count):
            key = self.value(depth - 1)
            if not isinstance(key, str | bytes):
                self.refuse(f"a key that is a {type(key).__name__}")
            found[key] = self.value(depth - 1)
        try:
            found = {_text(key): held for key, held in found.items()}
        except UnicodeDecodeError:
            self.refuse("a key that is not UTF-8")
        if _text(ARRAY) in found:
            return self.array(found)
        if _text(SCALAR) in found:
            return self.scalar(found)
        return found

    def dtype(self, found: dict[Any, Any]) -> np.dtype[Any]:
        name = found.get("dtype")
        if isinstance(name, bytes):
            name = name.decode("ascii", "replace")
        if not isinstance(name, str) or name not in DTYPES:
            self.refuse(f"dtype {str(name)[:40]!r} is not allowed", "dtype")
        return DTYPES[name]

    def array(self, found: dict[Any, Any]) -> np.ndarray[Any, Any]:
        dtype = self.dtype(found)
        shape, data = found.get("shape"), found.get("data")
        if not isinstance(shape, list) or len(shape) > self.limits.dimensions:
            self.refuse(f"a shape is a list of at most {self.limits.dimensions} sizes", "shape")
        count = dtype.itemsize
        for size in shape:
            if type(size) is not int or not 0 <= size <= self.limits.size:
                self.refuse(f"{str(size)[:40]} is not a size", "shape")
            count *= size
        if not isinstance(data, bytes) or len(data) != count:
            held = f"{len(data)} bytes" if isinstance(data, bytes) else type(data).__name__
            self.refuse(f"shape {shape} of {dtype.name} needs {count} bytes, data holds {held}")
        values = np.frombuffer(data, dtype).reshape(shape)
        if dtype.kind == "b":
            values = np.asarray(np.frombuffer(data, np.uint8).reshape(shape) != 0)
        elif not dtype.isnative:
            values = values.astype(dtype.newbyteorder("="))
        values.setflags(write=False)
        return values

    def scalar(self, found: dict[Any, Any]) -> np.generic:
        dtype = self.dtype(found).newbyteorder("=")
        data = found.get("data")
        if isinstance(data, bool | int | float):
            try:
                with np.errstate(all="ignore"):
                    value = dtype.type(data)
                if dtype.kind not in "iu" or value == data:
                    return value
            except (OverflowError, ValueError, TypeError):
                pass
        self.refuse(f"{str(data)[:40]!r} is not a {dtype.name}", "data")
