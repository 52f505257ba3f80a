"""Every dialect of 3DGS PLY gives the same Gaussians."""

from __future__ import annotations

import numpy as np
import pytest

from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.splat_files import load_cloud
from gn0_trials.splat_corpus import (
    DC,
    DIALECTS,
    POSITION,
    ROTATION,
    SCALE,
    PlyDialect,
    build_ply,
    dialect_degree,
    packed_file,
    ply_columns,
    rest,
    small_cloud,
)

PLAIN = (*POSITION, *DC, "opacity", *SCALE, *ROTATION)


def assert_same(actual: GaussianCloud, expected: GaussianCloud, digits: float = 2e-6) -> None:
    for name in ("means", "quats", "scales", "opacities", "sh"):
        a, b = getattr(actual, name), getattr(expected, name)
        np.testing.assert_allclose(a, b, rtol=digits, atol=digits, err_msg=name)


def load_bytes(tmp_path, data: bytes):
    path = tmp_path / "cloud.anything"  # the name tells nothing
    path.write_bytes(data)
    return load_cloud(path)


@pytest.mark.parametrize("name", DIALECTS)
def test_each_dialect_gives_the_same_cloud(name, tmp_path):
    dialect = DIALECTS[name]
    cloud = small_cloud(40, dialect_degree(dialect))
    file = load_bytes(tmp_path, build_ply(dialect, ply_columns(cloud)))
    assert_same(file.cloud, cloud)
    assert (file.stored, file.dropped, file.format) == (40, 0, "ply")
    assert file.sh_degree == dialect_degree(dialect)
    assert file.encoding == dialect.encoding


def test_there_are_at_least_25_dialects():
    assert len(DIALECTS) >= 25


def test_a_dialect_larger_than_a_block_is_read_whole(tmp_path):
    """Blocks end in the middle of nothing: 9,000 rows in ascii and in binary are several."""
    cloud = small_cloud(9000, 1)
    order = (*POSITION, *DC, *rest(1), "opacity", *SCALE, *ROTATION)
    for encoding in ("ascii", "binary_little_endian", "binary_big_endian"):
        file = load_bytes(tmp_path, build_ply(PlyDialect(order, encoding), ply_columns(cloud)))
        assert_same(file.cloud, cloud)


def test_what_was_not_used_is_listed(tmp_path):
    dialect = DIALECTS["extra-floats"]
    file = load_bytes(tmp_path, build_ply(dialect, ply_columns(small_cloud(3, 0))))
    assert file.extra_properties == ("filter_3D", "semantic_0", "confidence")
    dialect = DIALECTS["faces-before"]
    file = load_bytes(tmp_path, build_ply(dialect, ply_columns(small_cloud(3, 0))))
    assert file.extra_elements == (("face", 2),)


def test_bytes_behind_the_data_are_said(tmp_path):
    """A count that is too small leaves splats unread: the reader says how much it left."""
    file = load_bytes(
        tmp_path, build_ply(DIALECTS["trailing-bytes"], ply_columns(small_cloud(3, 0)))
    )
    assert file.notes == ("3 bytes after the last row were not read",)
    data = packed_file(small_cloud(3, 0)) + b"more"
    assert load_bytes(tmp_path, data).notes == ("4 bytes after the last row were not read",)


def test_comments_are_kept_and_never_mistaken(tmp_path):
    file = load_bytes(tmp_path, build_ply(DIALECTS["comments"], ply_columns(small_cloud(3, 0))))
    assert file.comments == ("", "element vertex 9", "größe end_header", "spaced  out")


@pytest.mark.parametrize("degree", [4, 5])
def test_sh_above_three_is_cut_and_said(degree, tmp_path):
    """Bands are orthogonal: bands 0 to 3 of a degree-4 file are the degree-3 file."""
    cloud = small_cloud(6, 3)
    columns = ply_columns(cloud)
    k, wide = 15, (degree + 1) ** 2 - 1
    moved = {n: v for n, v in columns.items() if not n.startswith("f_rest_")}
    for channel in range(3):
        for i in range(k):
            moved[f"f_rest_{channel * wide + i}"] = columns[f"f_rest_{channel * k + i}"]
    order = (*PLAIN, *rest(degree))
    file = load_bytes(tmp_path, build_ply(PlyDialect(order), moved))
    assert_same(file.cloud, cloud)
    assert file.sh_degree == degree and file.cloud.sh_degree == 3
    assert file.notes == (f"SH degree {degree} cut to 3",)


def test_two_scales_are_flat_discs(tmp_path):
    cloud = small_cloud(6, 0)
    order = tuple(n for n in PLAIN if n != "scale_2")
    file = load_bytes(tmp_path, build_ply(PlyDialect(order), ply_columns(cloud)))
    np.testing.assert_allclose(file.cloud.scales[:, :2], cloud.scales[:, :2], rtol=1e-6)
    assert (file.cloud.scales[:, 2] == 0).all()
    assert "2D Gaussians" in file.notes[0]


def test_infinities_with_a_meaning_are_kept(tmp_path):
    """Opacity ±inf is opaque or invisible, scale −inf is flat: exporters write them on purpose."""
    columns = ply_columns(small_cloud(4, 0))
    columns["opacity"] = np.array([np.inf, -np.inf, 0, 0], np.float32)
    columns["scale_1"] = np.array([0, 0, -np.inf, 0], np.float32)
    file = load_bytes(tmp_path, build_ply(PlyDialect(PLAIN), columns))
    assert file.dropped == 0
    np.testing.assert_array_equal(file.cloud.opacities, [1, 0, 0.5, 0.5])
    np.testing.assert_array_equal(file.cloud.scales[:, 1], [1, 1, 0, 1])


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("x", np.nan), ("y", np.inf), ("z", -np.inf), ("scale_0", np.nan), ("scale_1", np.inf),
        ("scale_2", 100.0), ("opacity", np.nan), ("rot_0", np.nan), ("rot_3", np.inf),
        ("f_dc_1", np.nan), ("f_rest_7", -np.inf), ("f_rest_44", np.nan),
    ],
)  # fmt: skip
@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_non_finite_splats_are_dropped_and_counted(name, value, encoding, tmp_path):
    cloud = small_cloud(8, 3)
    columns = {n: v.copy() for n, v in ply_columns(cloud).items()}
    columns[name][[2, 5]] = value
    dialect = PlyDialect((*PLAIN, *rest(3)), encoding)
    file = load_bytes(tmp_path, build_ply(dialect, columns))
    assert (file.stored, file.dropped, len(file.cloud)) == (8, 2, 6)
    assert_same(file.cloud, cloud.select(np.array([0, 1, 3, 4, 6, 7])))


def test_a_zero_quaternion_drops_its_splat_and_others_are_normalised(tmp_path):
    columns = {n: v.copy() for n, v in ply_columns(small_cloud(3, 0)).items()}
    for i, n in enumerate(ROTATION):
        columns[n] = np.array([0.0, 3e-30 * (i == 1), 1e30 * (i == 2)], np.float32)
    file = load_bytes(tmp_path, build_ply(PlyDialect(PLAIN), columns))
    assert file.dropped == 1
    np.testing.assert_array_equal(file.cloud.quats, [[0, 1, 0, 0], [0, 0, 1, 0]])


def test_a_double_beyond_float_is_non_finite(tmp_path):
    columns = ply_columns(small_cloud(3, 0))
    columns["x"] = np.array([1.0, 1e39, 2.0])
    for encoding in ("ascii", "binary_little_endian"):
        dialect = PlyDialect(PLAIN, encoding, types={"x": "double"})
        file = load_bytes(tmp_path, build_ply(dialect, columns))
        assert file.dropped == 1


def test_ascii_values_are_exact(tmp_path):
    """A decimal becomes the nearest double and then the nearest float, as strtod would make it."""
    texts = ["0.1", "1e-7", "123456.789", "16777217", "3.4028235e38", "-0", "+.5", "1e-44"]
    columns = ply_columns(small_cloud(len(texts), 0))
    data = build_ply(PlyDialect(PLAIN, "ascii"), columns)
    head, _, body = data.partition(b"end_header\n")
    rows = [line.split() for line in body.splitlines()]
    for row, text in zip(rows, texts, strict=True):
        row[0] = text.encode()
    body = b"\n\n".join(b"\t ".join(row) for row in rows)  # blank lines, tabs, no last line end
    file = load_bytes(tmp_path, head + b"end_header\n" + body)
    np.testing.assert_array_equal(
        file.cloud.means[:, 0], np.array([float(t) for t in texts], np.float32)
    )
