"""Splats behind a mesh: list rows of any shape are walked exactly, forged ones refused."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.errors import FormatError
from gn0.gaussians.ply import decode_ply
from gn0.gaussians.ply_header import PlyElement, PlyProperty, load_ply_header
from gn0.gaussians.ply_lists import end_of_list_rows
from gn0.gaussians.ply_rows import PlySource
from gn0.gaussians.splat_files import load_cloud
from gn0_trials.splat_corpus import DIALECTS, PlyDialect, build_ply, ply_columns, small_cloud

PLAIN = DIALECTS["inria-sh0"].order
CODES = {"i1": "b", "u1": "B", "i2": "h", "u2": "H", "i4": "i", "u4": "I", "f4": "f", "f8": "d"}
scalars = st.sampled_from(sorted(CODES))
counts = st.sampled_from([None, "u1", "i1", "u2", "i2", "u4", "i4"])


@given(
    st.lists(st.tuples(scalars, counts), min_size=1, max_size=4),
    st.integers(0, 30),
    st.sampled_from("<>"),
    st.data(),
)
@settings(max_examples=60, deadline=None)
def test_rows_end_where_they_were_written_to_end(columns, rows, order, data):
    properties = tuple(PlyProperty(f"p{i}", t, c) for i, (t, c) in enumerate(columns))
    body = b""
    for _ in range(rows):
        for kind, count_type in columns:
            length = 1
            if count_type:
                length = data.draw(st.integers(0, 6))
                body += struct.pack(order + CODES[count_type], length)
            body += struct.pack(f"{order}{length}{CODES[kind]}", *[1] * length)
    element = PlyElement("thing", rows, properties)
    stream = io.BytesIO(b"head" + body + b"tail")
    size = 8 + len(body)
    end = end_of_list_rows(stream, 4, element, order, Path("f.ply"), size)
    assert end == 4 + len(body)


def test_a_mesh_larger_than_a_block_stands_before_the_splats(tmp_path):
    """150,000 triangles, 2 MB: the walk crosses block ends, and lists longer than a block."""
    triangles = 150_000
    faces = np.zeros(triangles, [("n", "u1"), ("v", ">i4", 3)])
    faces["n"] = 3
    long = struct.pack(">I", 600_000) + bytes(4 * 600_000)
    dialect = PlyDialect(
        PLAIN,
        "binary_big_endian",
        before=(
            [
                f"element face {triangles}", "property list uchar int vertex_indices",
                "element strip 1", "property list uint int vertex_indices",
            ],
            faces.tobytes() + long,
        ),
    )  # fmt: skip
    cloud = small_cloud(9, 0)
    (tmp_path / "mesh.ply").write_bytes(build_ply(dialect, ply_columns(cloud)))
    file = load_cloud(tmp_path / "mesh.ply")
    np.testing.assert_array_equal(file.cloud.means, cloud.means)
    assert file.extra_elements == (("face", triangles), ("strip", 1))


@pytest.mark.parametrize(
    ("count_type", "length"),
    [("i1", b"\xff"), ("i4", b"\xff\xff\xff\xff"), ("u4", b"\xff\xff\xff\xff"), ("u1", b"\xff")],
)
def test_forged_lengths_are_refused_at_their_byte(count_type, length):
    element = PlyElement("face", 1, (PlyProperty("v", "f8", count_type),))
    stream = io.BytesIO(b"head" + length + bytes(16))
    with pytest.raises(FormatError, match="does not fit") as caught:
        end_of_list_rows(stream, 4, element, "<", Path("f.ply"), 20 + len(length))
    assert caught.value.offset == 4 and caught.value.field == "v"


def test_splats_cut_behind_lists_are_refused(tmp_path):
    """Before the walk the header fits the file; after it, it does not."""
    before = (["element face 1", "property list uchar int v"], b"\x05" + bytes(20))
    data = build_ply(PlyDialect(PLAIN, before=before), ply_columns(small_cloud(4, 0)))
    (tmp_path / "cut.ply").write_bytes(data[:-10])
    with pytest.raises(FormatError, match="truncated") as caught:
        load_cloud(tmp_path / "cut.ply")
    assert caught.value.offset == len(data) - 10


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
def test_a_file_that_shrinks_while_being_read(encoding):
    """The size was right when the header was checked; the rows are gone when they are read."""
    data = build_ply(PlyDialect(PLAIN, encoding), ply_columns(small_cloud(50, 0)))
    stream = io.BytesIO(data[:-300])
    header = load_ply_header(stream, "f.ply", len(data))
    with pytest.raises(FormatError, match=r"row|shrank"):
        decode_ply(PlySource(stream, Path("f.ply"), len(data), header))
