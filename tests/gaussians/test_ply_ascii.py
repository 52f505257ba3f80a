"""Ascii PLY at its edges: endless lines, integers that are none, tables before the splats."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.errors import FormatError
from gn0.gaussians.splat_files import load_cloud
from gn0_trials.splat_corpus import (
    DIALECTS,
    PlyDialect,
    build_ply,
    packed_file,
    ply_columns,
    small_cloud,
)

PLAIN = DIALECTS["ascii"].order
SOUND = build_ply(DIALECTS["ascii"], ply_columns(small_cloud(4, 0)))


def ascii_packed(cloud) -> bytes:
    """A compressed PLY in ascii: nobody writes one, but the format allows it."""
    head, _, data = packed_file(cloud).partition(b"end_header\n")
    chunks = -(-len(cloud) // 256)
    tables = [np.frombuffer(data[: chunks * 72], "<f4").reshape(-1, 18)]
    words = np.frombuffer(data[chunks * 72 :][: len(cloud) * 16], "<u4").reshape(-1, 4)
    sh = np.frombuffer(data[chunks * 72 + len(cloud) * 16 :], np.uint8).reshape(len(cloud), -1)
    tables += [words, sh] if sh.size else [words]
    lines = [" ".join(f"{v:.9g}" if t.dtype.kind == "f" else str(v) for v in row)
             for t in tables for row in t]  # fmt: skip
    head = head.replace(b"binary_little_endian", b"ascii")
    return head + b"end_header\n" + "\n".join(lines).encode() + b"\n"


def load_bytes(tmp_path, data: bytes):
    path = tmp_path / "cloud.ply"
    path.write_bytes(data)
    return load_cloud(path)


def test_packed_words_survive_ascii(tmp_path):
    cloud = small_cloud(300, 1)
    file = load_bytes(tmp_path, ascii_packed(cloud))
    binary = load_bytes(tmp_path, packed_file(cloud))
    assert file.format == "ply-packed" and file.encoding == "ascii"
    for name in ("means", "quats", "scales", "opacities", "sh"):
        np.testing.assert_array_equal(getattr(file.cloud, name), getattr(binary.cloud, name))


@pytest.mark.parametrize("value", ["-1", "4294967296", "0.5", "nan", "1e99"])
def test_words_must_be_whole_numbers(value, tmp_path):
    data = ascii_packed(small_cloud(3, 0))
    lines = data.split(b"\n")
    row = lines.index(next(s for s in lines if s.startswith(b"end_header"))) + 2
    lines[row] = value.encode() + b" " + lines[row].split(b" ", 1)[1]
    with pytest.raises(FormatError, match="not a whole number") as caught:
        load_bytes(tmp_path, b"\n".join(lines))
    assert caught.value.field == "packed_position" and caught.value.offset is not None


def test_a_line_without_end_is_refused_not_hoarded(tmp_path):
    """A megabyte of blanks in a row: refused once the row is longer than any row can be."""
    data = SOUND[:-30] + b" " * 2_000_000 + SOUND[-30:]
    with pytest.raises(FormatError, match="bytes long"):
        load_bytes(tmp_path, data)


def test_too_few_lines_before_the_splats(tmp_path):
    before = (["element note 100000", "property list uchar char text"], b"1 1\n" * 99_000)
    data = build_ply(PlyDialect(PLAIN, "ascii", before=before), ply_columns(small_cloud(4, 0)))
    with pytest.raises(FormatError, match="rows are missing") as caught:
        load_bytes(tmp_path, data + b" " * 5000)
    assert caught.value.field == "note"


def test_many_lines_before_the_splats_are_passed_over(tmp_path):
    before = (["element note 100000", "property list uchar char text"], b"1 1\n" * 100_000)
    cloud = small_cloud(4, 0)
    file = load_bytes(
        tmp_path, build_ply(PlyDialect(PLAIN, "ascii", before=before), ply_columns(cloud))
    )
    np.testing.assert_allclose(file.cloud.means, cloud.means, rtol=1e-6)
