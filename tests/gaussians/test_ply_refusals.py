"""What is not a sound splat file is refused once, with file, place and remedy."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from gn0.errors import FormatError, StorageError
from gn0.gaussians.ply_header import HEADER_LIMIT, parse_ply_header
from gn0.gaussians.splat_files import load_cloud
from gn0_trials.peak_memory import peak_memory_bytes
from gn0_trials.splat_corpus import (
    DIALECTS,
    build_ply,
    packed_file,
    ply_columns,
    small_cloud,
)

SOUND = build_ply(DIALECTS["inria-sh0"], ply_columns(small_cloud(4, 0)))
ASCII = build_ply(DIALECTS["ascii"], ply_columns(small_cloud(4, 0)))
PACKED = packed_file(small_cloud(300, 1))
FACES = build_ply(DIALECTS["faces-before"], ply_columns(small_cloud(4, 0)))


def swap(data: bytes, old: bytes, new: bytes) -> bytes:
    assert old in data
    return data.replace(old, new, 1)


CASES = {
    "empty file": (b"", "the file is empty"),
    "three bytes": (b"ply", "not a splat file of a known format"),
    "magic only": (b"ply\n", "cut off"),
    "header cut": (SOUND[:60], "cut off"),
    "header without end": (b"ply\ncomment " + b"x" * HEADER_LIMIT, "no end_header within"),
    "long header": (
        swap(SOUND, b"element", b"comment " + b"x" * HEADER_LIMIT + b"\nelement"),
        "no end_header within",
    ),
    "no format": (swap(SOUND, b"format binary_little_endian 1.0\n", b""), "no format line"),
    "two formats": (swap(SOUND, b"element", b"format ascii 1.0\nelement"), "second format"),
    "unknown format": (swap(SOUND, b"binary_little", b"binary_middle"), "unknown PLY format"),
    "unknown version": (swap(SOUND, b"endian 1.0", b"endian 2.0"), "unknown PLY format"),
    "unknown line": (swap(SOUND, b"element", b"elephant"), "unknown PLY header line"),
    "unknown type": (swap(SOUND, b"property float x", b"property half x"), "malformed PLY prop"),
    "property first": (swap(SOUND, b"element", b"property float q\nelement"), "before any element"),
    "duplicate property": (swap(SOUND, b"float y", b"float x"), "declared twice"),
    "duplicate element": (
        swap(SOUND, b"element vertex", b"element vertex 0\nelement vertex"), "declared twice"
    ),
    "negative count": (swap(SOUND, b"vertex 4", b"vertex -4"), "not a whole number"),
    "fraction count": (swap(SOUND, b"vertex 4", b"vertex 4.0"), "not a whole number"),
    "unicode count": (swap(SOUND, b"vertex 4", "vertex ٤".encode()), "not a whole number"),
    "no count": (swap(SOUND, b"vertex 4", b"vertex"), "malformed PLY header line"),
    "count + 1": (swap(SOUND, b"vertex 4", b"vertex 5"), "truncated or its header is forged"),
    "count 10^12": (swap(SOUND, b"vertex 4", b"vertex 1000000000000"), "truncated"),
    "count 2^63": (swap(SOUND, b"vertex 4", b"vertex 9223372036854775808"), "truncated"),
    "count of 4000 digits": (swap(SOUND, b"vertex 4", b"vertex " + b"9" * 4000), "truncated"),
    "one byte short": (SOUND[:-1], "truncated"),
    "no data": (SOUND[: SOUND.index(b"end_header\n") + 11], "truncated"),
    "ascii cut in a row": (ASCII[:-200], "row 2 .* has 12 values, not 14"),
    "ascii cut after a row": (b"\n".join(ASCII.split(b"\n")[:-3]), "2 of 4 rows"),
    "ascii count 10^12": (swap(ASCII, b"vertex 4", b"vertex 1000000000000"), "truncated"),
    "ascii word": (ASCII[:-20] + b"x" + ASCII[-19:], "not a number"),
    "ascii digit groups": (ASCII[:-6] + b"_" + ASCII[-6:], "not a number"),
    "ascii value missing": (ASCII[: ASCII.rindex(b" ")] + b"\n", "has 13 values, not 14"),
    "ascii value too many": (ASCII[:-1] + b" 1\n", "has 15 values, not 14"),
    "no vertices": (swap(SOUND, b"vertex 4", b"vertex 0"), "holds no Gaussians"),
    "no vertex element": (swap(SOUND, b"element vertex", b"element points"), "no vertex element"),
    "point cloud": (
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
        b"property float z\nproperty uchar red\nend_header\n0 0 0 0\n",
        "this is a point cloud",
    ),
    "mesh": (
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
        b"property float z\nelement face 0\nproperty list uchar int vertex_index\n"
        b"end_header\n0 0 0\n",
        "this is a mesh",
    ),
    "no rotation": (swap(SOUND, b"rot_2", b"rot_9"), "missing: rot_2"),
    "list in vertex": (
        swap(SOUND, b"property float nx", b"property list uchar float nx"), "is a list"
    ),
    "forged list": (swap(FACES, b"\x03\0\0\0\0", b"\xff\0\0\0\0"), "truncated or forged"),
    "packed without chunks": (swap(PACKED, b"element chunk", b"element chonk"), "no chunk element"),
    "packed with too few chunks": (
        swap(PACKED, b"element vertex 300", b"element vertex 600"), "truncated"
    ),
    "packed, chunk count forged": (
        swap(PACKED, b"element vertex 300", b"element vertex 200"), "2 chunks for 200 splats"
    ),
    "packed, wrong type": (swap(PACKED, b"uint packed_scale", b"int packed_scale"), "not uint"),
    "packed, bound missing": (swap(PACKED, b"max_scale_z", b"max_scale_q"), "is missing"),
    "packed, colour missing": (swap(PACKED, b"max_r", b"max_q"), "is missing"),
    "packed, odd SH": (swap(PACKED, b"property uchar f_rest_8\n", b""), "8 SH properties"),
    "packed, SH rows": (swap(PACKED, b"element sh 300", b"element sh 299"), "299 SH rows"),
    "packed, cut": (PACKED[:-1], "truncated"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_bad_file_is_refused(case, tmp_path):
    data, reason = CASES[case]
    path = tmp_path / "bad.ply"
    path.write_bytes(data)
    with pytest.raises(FormatError, match=reason) as caught:
        load_cloud(path)
    error = caught.value
    assert error.file == str(path) and str(path) in str(error)
    assert error.offset is not None and 0 <= error.offset <= len(data)
    assert error.remedy


@pytest.mark.parametrize("data", [SOUND, FACES, PACKED[:900]], ids=["ply", "lists", "packed"])
def test_no_cut_of_a_file_is_read_or_leaks(data, tmp_path):
    """Truncation anywhere is refused; nothing else comes out."""
    path = tmp_path / "cut.ply"
    for end in range(0, len(data), 3):
        path.write_bytes(data[:end])
        with pytest.raises(FormatError):
            load_cloud(path)


def test_a_crowded_header_takes_linear_work(tmp_path):
    """Thousands of elements and properties within 64 KiB are read, or refused, as any other."""
    elements = "".join(f"element e{i} 0\n" for i in range(4000)).encode()
    path = tmp_path / "many.ply"
    path.write_bytes(swap(SOUND, b"element", elements + b"element"))
    file = load_cloud(path)
    assert len(file.cloud) == 4 and len(file.extra_elements) == 4000
    properties = "".join(f"property uchar q{i}\n" for i in range(3000)).encode()
    path.write_bytes(swap(SOUND, b"element", b"element many 9\n" + properties + b"element"))
    with pytest.raises(FormatError, match="truncated"):
        load_cloud(path)


def test_the_place_of_a_fault_is_its_byte():
    bad = swap(SOUND, b"property float y", b"property floot y")
    with pytest.raises(FormatError) as caught:
        parse_ply_header(bad, "file.ply")
    assert caught.value.offset == bad.index(b"property floot y")


def test_the_place_of_a_faulty_element_is_its_line(tmp_path):
    bad = swap(PACKED, b"uint packed_scale", b"int packed_scale")
    path = tmp_path / "packed.ply"
    path.write_bytes(bad)
    with pytest.raises(FormatError) as caught:
        load_cloud(path)
    assert caught.value.offset == bad.index(b"element vertex")
    path.write_bytes(swap(PACKED, b"element vertex", b"element vertax"))
    with pytest.raises(FormatError, match=r"vertex|chunk"):
        load_cloud(path)


FOREIGN = {
    "zip": (b"PK\x03\x04" + b"\0" * 60, "the zip has no directory"),
    "json": (b'{"version": 2}', "JSON"),
    "webp": (b"RIFF\0\0\0\0WEBPVP8L", "a picture"),
    "lfs": (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "Git LFS pointer"),
    "page": (b"\n<!DOCTYPE html><html></html>", "a web page"),
    "text": (b"hello, world", "not a splat file of a known format"),
}


@pytest.mark.parametrize("kind", FOREIGN)
def test_other_formats_are_named(kind, tmp_path):
    data, reason = FOREIGN[kind]
    path = tmp_path / "scene.ply"  # content decides, not the name
    path.write_bytes(data)
    with pytest.raises(FormatError, match=reason) as caught:
        load_cloud(path)
    assert caught.value.remedy and caught.value.file


def test_missing_file_and_folder(tmp_path):
    with pytest.raises(StorageError, match="cannot read"):
        load_cloud(tmp_path / "none.ply")
    with pytest.raises(StorageError, match="NUL"):
        load_cloud("a\0b.ply")
    with pytest.raises(FormatError, match="is a folder"):
        load_cloud(tmp_path)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_pipe_does_not_hang(tmp_path):
    os.mkfifo(tmp_path / "pipe.ply")
    with pytest.raises(FormatError, match="not a regular file"):
        load_cloud(tmp_path / "pipe.ply")


def test_limit_is_checked_before_reading(tmp_path):
    path = tmp_path / "cloud.ply"
    path.write_bytes(SOUND)
    load_cloud(path, limit_bytes=4 * 56)
    with pytest.raises(FormatError, match="more than the 223 allowed"):
        load_cloud(path, limit_bytes=223)


_MEASURE = """
import sys, warnings
warnings.simplefilter("error")
from gn0.errors import FormatError
from gn0.gaussians.splat_files import load_cloud
from gn0_trials.peak_memory import peak_memory_bytes
before = peak_memory_bytes()
try:
    cloud = load_cloud(sys.argv[1]).cloud
    decoded = sum(getattr(cloud, n).nbytes for n in ("means", "quats", "scales", "opacities", "sh"))
except FormatError:
    decoded = 0
print(decoded, peak_memory_bytes() - before)
"""


def peak_growth(path) -> tuple[int, int]:
    """(decoded bytes, growth of peak memory) of reading a file in a process of its own."""
    if not peak_memory_bytes():
        pytest.skip("this system does not tell a process its peak memory")
    out = subprocess.run(
        [sys.executable, "-c", _MEASURE, str(path)], capture_output=True, text=True, check=True
    )
    decoded, growth = out.stdout.split()
    return int(decoded), int(growth)


def wide_rows(count: int) -> bytes:
    """Rows of 400 extra doubles: the file is sixty times its decoded cloud."""
    head = swap(SOUND, b"vertex 4", f"vertex {count}".encode())
    extra = "".join(f"property double e{i}\n" for i in range(400)).encode()
    head = swap(head, b"end_header", extra + b"end_header")
    row = SOUND[-68:] + b"\0" * 3200
    return head[: head.index(b"end_header\n") + 11] + row * count


def many(data: bytes, row: int, count: int) -> bytes:
    return swap(data, b"vertex 4", f"vertex {count}".encode()) + data[-row:] * (count - 4)


MEMORY = {
    "plain": lambda: many(SOUND, 68, 400_000),
    "one non-finite": lambda: many(SOUND, 68, 400_000)[:-68] + b"\xff" * 68,
    "ascii": lambda: many(ASCII, len(ASCII.splitlines()[-1]) + 1, 100_000),
    "packed": lambda: packed_file(small_cloud(200_000, 3)),
    "wide rows": lambda: wide_rows(40_000),
    "forged count": lambda: swap(SOUND, b"vertex 4", b"vertex 1000000000000"),
    "forged, large file": lambda: wide_rows(20_000)[:-1],
    "forged packed": lambda: swap(PACKED, b"chunk 2", b"chunk 20000000000"),
    "face count forged": lambda: swap(FACES, b"face 2", b"face 1000000000000000"),
}


@pytest.mark.parametrize("case", MEMORY)
def test_memory_stays_within_two_and_a_half_clouds(case, tmp_path):
    """Peak memory is at most 2.5 × the decoded cloud + 64 MB; refused files decode to nothing."""
    path = tmp_path / "cloud.ply"
    path.write_bytes(MEMORY[case]())
    decoded, growth = peak_growth(path)
    assert growth <= 2.5 * decoded + 64e6
    if decoded > 16e6:
        assert growth > 0.9 * decoded, "the measurement itself is broken"
    if case.startswith("forged"):
        assert decoded == 0
