"""Files made by others: every PLY of the data folder is read, or refused for the right reason."""

from __future__ import annotations

import json

import numpy as np
import pytest

from gn0.errors import FormatError
from gn0.gaussians.files import load_cloud
from gn0.gaussians.ply_packed import save_ply_packed

FIXTURES = "splats/fixtures/gaussian-ply/tests/fixtures"
READ = {  # (Gaussians, SH degree in the file)
    "degree-1-sh": (1, 1),
    "degree-2-sh": (1, 2),
    "degree-3-sh": (1, 3),
    "degree-4-sh": (1, 4),
    "one-gaussian-ascii": (1, 0),
    "one-gaussian-binary-le": (1, 0),
    "reordered-properties": (1, 1),
    "three-gaussian-binary-le": (3, 1),
}
REFUSED = {
    "duplicate-sh-index": "bad SH property name",
    "empty-vertex": "holds no Gaussians",
    "invalid-sh-name": "bad SH property name",
    "list-property": "a vertex property is a list",
    "mesh-not-gaussian": "this is a mesh",
    "missing-opacity": "missing: opacity",
    "nan-opacity-binary-le": "all 1 Gaussians hold NaN",
    "non-contiguous-sh": "f_rest_2 is missing",
    "out-of-range-double": "all 1 Gaussians hold NaN, infinite",
    "overflow-scale": "all 1 Gaussians hold NaN, infinite",
    "sh-count-not-rgb": "fit no SH degree",
    "sh-invalid-degree": "fit no SH degree",
    "truncated-binary-le": "truncated",
}


def test_the_table_covers_every_fixture(shared_data):
    names = {p.stem for p in (shared_data / FIXTURES).glob("*.ply")}
    assert names == set(READ) | set(REFUSED)


@pytest.mark.parametrize("name", READ)
def test_sound_fixture(name, shared_data):
    file = load_cloud(shared_data / FIXTURES / f"{name}.ply")
    assert (len(file.cloud), file.sh_degree, file.dropped) == (*READ[name], 0)
    cloud = file.cloud
    if file.stored == 1:
        np.testing.assert_array_equal(cloud.means, [[1, 2, 3]])
        np.testing.assert_array_equal(cloud.quats, [[1, 0, 0, 0]])
        np.testing.assert_allclose(cloud.sh[0, 0], [0.1, 0.2, 0.3], rtol=1e-6)
        np.testing.assert_allclose(cloud.opacities, [0.5])
    if name in ("degree-1-sh", "one-gaussian-ascii", "reordered-properties"):
        np.testing.assert_allclose(cloud.scales, [[1, 2, 0.5]], rtol=1e-6)
    if name in ("degree-1-sh", "reordered-properties"):  # R0..R2 G0..G2 B0..B2 = 1..9
        np.testing.assert_array_equal(cloud.sh[0, 1:], [[1, 4, 7], [2, 5, 8], [3, 6, 9]])


@pytest.mark.parametrize("name", REFUSED)
def test_malformed_fixture(name, shared_data):
    path = shared_data / FIXTURES / f"{name}.ply"
    with pytest.raises(FormatError, match=REFUSED[name]) as caught:
        load_cloud(path)
    assert caught.value.file == str(path)
    assert caught.value.offset is not None and caught.value.remedy


OTHERS = {
    "*.spz": "SPZ|gzip|no splat file",
    "*.sog": "SOG|zip|no splat file",
    "*.ksplat": "KSPLAT",
    "*.splat": r"\.splat",
    "*.glb": "binary glTF",
    "*.gltf": "JSON",
    "meta.json": "JSON",
    "*.webp": "no splat file",
}


@pytest.mark.parametrize("pattern", OTHERS)
def test_formats_without_a_reader_are_named(pattern, shared_data):
    paths = sorted((shared_data / "splats").rglob(pattern))
    assert paths
    for path in paths:
        with pytest.raises(FormatError, match=OTHERS[pattern]):
            load_cloud(path)


def test_inria_order(shared_data):
    file = load_cloud(shared_data / "splats/fixtures/pc_short.ply")
    assert (file.stored, file.dropped, file.sh_degree) == (100, 0, 3)
    assert file.extra_properties == ("nx", "ny", "nz")


def test_leica_against_its_provenance_and_plain_numpy(shared_data):
    """Brush order: f_dc first, f_rest sorted as text, x y z last."""
    path = shared_data / "splats/leica-sofort/leica-sofort-top8192.ply"
    said = json.loads((path.parent / f"{path.name}.provenance.json").read_text())
    file = load_cloud(path)
    assert file.stored == said["output"]["gaussian_count"] == 8192
    assert file.sh_degree == said["output"]["sh_degree"] == 3
    assert "Vertical axis: y" in file.comments and file.dropped == 0
    names = said["source"]["property_order"]
    raw = np.frombuffer(path.read_bytes()[-8192 * 59 * 4 :], "<f4").reshape(8192, 59)
    column = {name: raw[:, i].astype(np.float64) for i, name in enumerate(names)}
    cloud = file.cloud
    np.testing.assert_array_equal(cloud.means[:, 2], column["z"])
    np.testing.assert_allclose(cloud.scales[:, 1], np.exp(column["scale_1"]), rtol=1e-6)
    np.testing.assert_allclose(cloud.opacities, 1 / (1 + np.exp(-column["opacity"])), rtol=1e-6)
    for channel in range(3):
        for k in range(15):
            stored = column[f"f_rest_{channel * 15 + k}"]
            np.testing.assert_array_equal(cloud.sh[:, 1 + k, channel], stored)
    length = np.sqrt(sum(column[f"rot_{i}"] ** 2 for i in range(4)))
    np.testing.assert_allclose(cloud.quats[:, 3], column["rot_3"] / length, atol=1e-7)


def test_guitar_has_the_facts_of_its_readme(shared_data, tmp_path):
    path = shared_data / "splats/playcanvas/guitar.compressed.ply"
    file = load_cloud(path)
    assert (file.format, file.stored, file.dropped) == ("ply-packed", 90_854, 0)
    assert file.comments == ("Generated by SuperSplat 2.7.1",)
    # repacking finds the chunks of the original: most values come back as they were
    order = save_ply_packed(file.cloud, tmp_path / "again.ply")
    again = load_cloud(tmp_path / "again.ply").cloud
    error = np.abs(again.means - file.cloud.means[order])
    assert np.median(error) < 1e-6 and error.max() < 2e-3
    assert (tmp_path / "again.ply").stat().st_size < path.stat().st_size + 100
