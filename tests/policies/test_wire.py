"""The wire format: the same bytes as the released client, and nothing but refusals for the rest."""

from __future__ import annotations

import struct
import tracemalloc

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.errors import FormatError
from gn0.policies.remote.wire import DTYPES, WireLimits, decode_message, encode_message


def pack_official(value: object) -> bytes:
    """The layout of the released client, written down again from its description."""

    def default(item: object) -> object:
        if isinstance(item, np.ndarray):
            return {
                b"__ndarray__": True,
                b"data": item.tobytes(),
                b"dtype": item.dtype.str,
                b"shape": item.shape,
            }
        if isinstance(item, np.generic):
            return {b"__npgeneric__": True, b"data": item.item(), b"dtype": item.dtype.str}
        raise TypeError(item)

    return msgpack.packb(value, default=default)


def unpack_official(data: bytes) -> object:
    """What the released server side makes of our bytes."""

    def hook(found: dict) -> object:
        if b"__ndarray__" in found:
            return np.ndarray(found[b"shape"], np.dtype(found[b"dtype"]), found[b"data"])
        if b"__npgeneric__" in found:
            return np.dtype(found[b"dtype"]).type(found[b"data"])
        return found

    return msgpack.unpackb(data, object_hook=hook)


def same(a: object, b: object) -> bool:
    if isinstance(a, np.ndarray):
        return (
            isinstance(b, np.ndarray)
            and a.dtype == b.dtype
            and a.tobytes() == b.tobytes()
            and (a.shape == b.shape)
        )
    if isinstance(a, dict):
        return isinstance(b, dict) and a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, list | tuple):
        return isinstance(b, list | tuple) and len(a) == len(b) and all(map(same, a, b))
    return type(a) is type(b) and (a == b or a != a)


def test_a_reset_is_these_bytes() -> None:
    assert encode_message({"endpoint": "reset"}) == b"\x81\xa8endpoint\xa5reset"


def test_a_query_is_these_bytes() -> None:
    """Written out by hand: keys in this order, byte-string keys inside the picture."""
    picture = np.arange(6, dtype=np.uint8).reshape(1, 2, 3)
    array = (
        b"\x84\xc4\x0b__ndarray__\xc3\xc4\x04data\xc4\x06\x00\x01\x02\x03\x04\x05"
        b"\xc4\x05dtype\xa3|u1\xc4\x05shape\x93\x01\x02\x03"
    )
    pose = (
        b"\x84\xc4\x0b__ndarray__\xc3\xc4\x04data\xc4\x0c"
        + struct.pack("<3f", 1.0, -2.0, 0.5)
        + b"\xc4\x05dtype\xa3<f4\xc4\x05shape\x91\x03"
    )
    expected = (
        b"\x85\xa8endpoint\xa5infer\xa6images" + array + b"\xabinstruction\xabGo to sofa."
        b"\xaasession_id\xa3a_1\xaestate.nav_pose" + pose
    )
    query = {
        "endpoint": "infer",
        "images": picture,
        "instruction": "Go to sofa.",
        "session_id": "a_1",
        "state.nav_pose": np.array([1.0, -2.0, 0.5], np.float32),
    }
    assert encode_message(query) == expected == pack_official(query)
    assert same(decode_message(expected), query)


arrays = st.builds(
    lambda name, shape, seed: np.asarray(
        np.random.default_rng(seed).integers(0, 2 if name == "bool" else 100, shape), name
    ),
    st.sampled_from([name for name in DTYPES if name[0] not in "<>|"]),
    st.lists(st.integers(0, 4), max_size=4).map(tuple),
    st.integers(0, 2**32),
)
plain = st.recursive(
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**64 - 1)
    | st.floats()
    | st.text(max_size=40)
    | st.binary(max_size=40)
    | arrays,
    lambda inner: (
        st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=8), inner, max_size=5)
    ),
    max_leaves=20,
)


@settings(max_examples=150, deadline=None)
@given(plain)
def test_what_we_write_the_msgpack_package_writes_too_and_both_read_it(value: object) -> None:
    data = encode_message(value)
    assert data == pack_official(value)
    assert same(unpack_official(data), value)
    assert same(decode_message(data), value)


@given(st.sampled_from(sorted(DTYPES.keys() - {"float64", "<f8", ">f8"})), st.integers(0, 100))
def test_scalars_are_numpy_scalars(name: str, number: int) -> None:
    """All but float64, which is a plain float to both."""
    dtype = DTYPES[name].newbyteorder("=")
    value = dtype.type(number % 2 if dtype.kind == "b" else number)
    found = decode_message(pack_official(value))
    assert type(found) is type(value) and found == value


def test_other_byte_orders_and_type_names_arrive_as_native_arrays() -> None:
    for dtype in (">f4", ">i2", "float32"):
        values = np.array([1, 2, 3], np.dtype(dtype))
        wire = {b"__ndarray__": True, b"data": values.tobytes(), b"dtype": dtype, b"shape": [3]}
        found = decode_message(msgpack.packb(wire))
        assert found.dtype.isnative and found.tolist() == [1, 2, 3]


def test_arrays_are_read_only_and_byte_string_keys_are_texts() -> None:
    found = decode_message(msgpack.packb({b"actions": [1]}))
    assert found == {"actions": [1]}
    with pytest.raises(ValueError, match="read-only"):
        decode_message(encode_message(np.zeros(3)))[0] = 1


def array(**changes: object) -> bytes:
    wire: dict[bytes, object] = {
        b"__ndarray__": True, b"data": bytes(12), b"dtype": "<f4", b"shape": [3]
    }  # fmt: skip
    wire |= {key.encode(): value for key, value in changes.items()}
    return msgpack.packb({k: v for k, v in wire.items() if v is not None})


LIES = {
    "object dtype": array(dtype="|O"),
    "void dtype": array(dtype="|V4"),
    "complex dtype": array(dtype="<c8"),
    "text dtype": array(dtype="<U3"),
    "date dtype": array(dtype="<M8[s]"),
    "record dtype": array(dtype="f4,f4,f4"),
    "no dtype": array(dtype=None),
    "a number as dtype": array(dtype=4),
    "too little data": array(data=bytes(11)),
    "too much data": array(data=bytes(13)),
    "data that is a text": array(data="abcdefghijkl"),
    "no data": array(data=None),
    "shape too large": array(shape=[4]),
    "shape that overflows": array(shape=[2**62, 4, 2**62]),
    "negative shape": array(shape=[-3]),
    "shape of floats": array(shape=[3.0]),
    "shape of booleans": array(shape=[True]),
    "shape that is a number": array(shape=3),
    "too many dimensions": array(shape=[3] + [1] * 8),
    "no shape": array(shape=None),
    "scalar of an unknown type": msgpack.packb(
        {b"__npgeneric__": True, b"data": 1, b"dtype": "|O"}
    ),
    "scalar out of range": msgpack.packb({b"__npgeneric__": True, b"data": 300, b"dtype": "|u1"}),
    "scalar of text": msgpack.packb({b"__npgeneric__": True, b"data": "1", b"dtype": "<f4"}),
    "scalar of not a number": msgpack.packb(
        {b"__npgeneric__": True, b"data": float("nan"), b"dtype": "<i4"}
    ),
    "nothing": b"",
    "a truncated map": b"\x82\xa1a\x01",
    "two messages": b"\x80\x80",
    "the unused type byte": b"\xc1",
    "an extension": b"\xd4\x01\x00",
    "a timestamp": msgpack.packb(msgpack.Timestamp(0, 0)),
    "a number as key": b"\x81\x01\x02",
    "a list as key": b"\x81\x90\x02",
    "a key that is no UTF-8": b"\x81\xc4\x01\xff\x02",
    "a text that is no UTF-8": b"\xa1\xff",
    "four billion values": b"\xdd\xff\xff\xff\xff",
    "four billion keys": b"\xdf\xff\xff\xff\xff",
    "four billion bytes": b"\xc6\xff\xff\xff\xff",
    "four billion letters": b"\xdb\xff\xff\xff\xff",
    "a million lists within each other": b"\x91" * 1_000_000 + b"\x90",
    "a million maps within each other": b"\x81\xa0" * 500_000,
    "a quarter million values": b"\xdd" + struct.pack(">I", 250_000) + bytes(250_000),
    "many lists of many values": b"\xdc\x01\x00" + (b"\xdc\x10\x00" + bytes(4096)) * 256,
}


@pytest.mark.parametrize("name", LIES)
def test_lies_are_refused_before_memory_is_spent_on_them(name: str) -> None:
    tracemalloc.start()
    try:
        with pytest.raises(FormatError) as caught:
            decode_message(LIES[name])
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert caught.value.remedy and "message" in caught.value.where
    assert peak < 16 << 20


def test_a_message_beyond_its_size_is_refused() -> None:
    with pytest.raises(FormatError, match="bytes"):
        decode_message(bytes(101), WireLimits(size=100))
    with pytest.raises(FormatError, match="text"):
        decode_message(encode_message("x" * 101), WireLimits(text=100))


@pytest.mark.parametrize(
    "value",
    [object(), {"a": np.array([object()])}, np.array(["a"]), 1j, np.zeros(2, complex), 2**70],
)
def test_what_cannot_be_sent_is_refused(value: object) -> None:
    with pytest.raises(FormatError, match="cannot be sent"):
        encode_message(value)


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes_are_read_or_refused(data: bytes) -> None:
    try:
        value = decode_message(data)
    except FormatError as error:
        assert error.remedy
    else:
        encode_message(value)
