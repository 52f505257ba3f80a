"""Files made by others: all of the data folder are read, or refused for the right reason."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial import cKDTree

from gn0.errors import FormatError
from gn0.gaussians.ply_packed import save_ply_packed
from gn0.gaussians.splat_files import load_cloud
from gn0_trials.splat_corpus import check_cloud_file

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


ELSEWHERE = "splats/fixtures/gaussian-ply"  # READ and REFUSED above
SOUND: dict[str, tuple[str, int, int]] = {  # (format, Gaussians, SH degree in the file)
    "splats/fixtures/gaussian-sog/tests/fixtures/decode-degree1.sog": ("sog-v2", 2, 1),
    "splats/fixtures/gaussian-sog/tests/fixtures/kit-multi-degree3-deflated.sog": ("sog-v2", 3, 3),
    "splats/fixtures/gaussian-sog/tests/fixtures/kit-multi-degree3.sog": ("sog-v2", 3, 3),
    "splats/fixtures/gaussian-sog/tests/fixtures/kit-one-degree0.sog": ("sog-v2", 1, 0),
    "splats/fixtures/gaussian-spz/tests/fixtures/decode-degree1-v2.spz": ("spz-v2", 2, 1),
    "splats/fixtures/gaussian-spz/tests/fixtures/decode-degree3-v2.spz": ("spz-v2", 2, 3),
    "splats/fixtures/gaussian-spz/tests/fixtures/decode-degree4-v2.spz": ("spz-v2", 1, 4),
    "splats/fixtures/gaussian-spz/tests/fixtures/decode-v1.spz": ("spz-v1", 1, 0),
    "splats/fixtures/gaussian-spz/tests/fixtures/decode-v3.spz": ("spz-v3", 1, 0),
    "splats/fixtures/gaussian-spz/tests/fixtures/degree3-v2.spz": ("spz-v2", 1, 3),
    "splats/fixtures/gaussian-spz/tests/fixtures/degree4-v2.spz": ("spz-v2", 1, 4),
    "splats/fixtures/gaussian-spz/tests/fixtures/extensions-v2.spz": ("spz-v2", 1, 0),
    "splats/fixtures/gaussian-spz/tests/fixtures/header-fields-v2.spz": ("spz-v2", 1, 0),
    "splats/fixtures/gaussian-spz/tests/fixtures/long-fname-v2.spz": ("spz-v2", 1, 0),
    "splats/fixtures/gaussian-spz/tests/fixtures/minimal-v1.spz": ("spz-v1", 1, 0),
    "splats/fixtures/gaussian-spz/tests/fixtures/minimal-v2.spz": ("spz-v2", 1, 0),
    "splats/fixtures/gaussian-spz/tests/fixtures/minimal-v3.spz": ("spz-v3", 1, 0),
    "splats/fixtures/gaussian-spz/tests/fixtures/plaintext-v2.spz": ("spz-v2", 1, 0),
    "splats/fixtures/gaussian-spz/tests/fixtures/three-points-degree1-v2.spz": ("spz-v2", 3, 1),
    "splats/fixtures/gaussian-spz/tests/fixtures/trailing-after-member-v2.spz": ("spz-v2", 1, 0),
    "splats/fixtures/gaussian-spz/tests/fixtures/trailing-decompressed-v2.spz": ("spz-v2", 1, 0),
    "splats/fixtures/khr_gaussian_splatting/khr_conformance_matrix.glb": ("gltf", 15, 3),
    "splats/fixtures/khr_gaussian_splatting/khr_conformance_matrix.gltf": ("gltf", 15, 3),
    "splats/fixtures/khr_gaussian_splatting/khr_extensible_fallback.gltf": ("gltf", 1, 0),
    "splats/fixtures/minimal-raw.spz": ("spz-v2", 4, 0),
    "splats/fixtures/minimal-v2.spz": ("spz-v2", 4, 0),
    "splats/fixtures/minimal-v3.spz": ("spz-v3", 4, 0),
    "splats/fixtures/minimal-v4.spz": ("spz-v4", 4, 0),
    "splats/fixtures/minimal.ksplat": ("ksplat", 4, 0),
    "splats/fixtures/minimal.splat": ("splat", 4, 0),
    "splats/fixtures/pc_short.ply": ("ply", 100, 3),
    "splats/leica-sofort/leica-sofort-top8192.ply": ("ply", 8192, 3),
    "splats/leica-sofort/leica-sofort-top8192.sog": ("sog-v2", 8192, 3),
    "splats/leica-sofort/leica-sofort-top8192.spz": ("spz-v2", 8192, 3),
    "splats/luma-seal/luma-seal.splat": ("splat", 101_780, 0),
    "splats/playcanvas/guitar.compressed.ply": ("ply-packed", 90_854, 0),
    "splats/playcanvas/playcanvas-logo/meta.json": ("sog-v1", 307_128, 0),
    "splats/statues/angel.sog": ("sog-v2", 71_359, 0),
    "splats/statues/massa.sog": ("sog-v2", 58_649, 0),
    "splats/statues/narcissus.sog": ("sog-v2", 101_275, 0),
    "splats/statues/trumpet.sog": ("sog-v2", 89_292, 0),
}
BROKEN = {  # by file name: what the refusal says
    "bad-bands.sog": "SH of 4 bands",
    "bad-quat-tag.sog": "has the tag 100, not 252 to 255",
    "bad-zip.sog": "no directory at its end",
    "corrupt-plane.sog": "damaged WebP",
    "count-exceeds-plane.sog": "fewer than the 4096 needed",
    "device-plane-name.sog": "device on Windows",
    "empty-count.sog": "holds no Gaussians",
    "escaping-plane-name.sog": "climbs out of its folder",
    "huge-bands.sog": r"shN\.bands",
    "huge-count.sog": r"\$\.count",
    "huge-palette-count.sog": r"shN\.count",
    "huge-version.sog": "SOG version 1e.300 is not read",
    "labels-out-of-range.sog": "SH label 1 of Gaussian 1",
    "lossy-plane.sog": "lossy WebP",
    "malformed-meta.sog": "truncated",
    "missing-plane.sog": "a plane is missing",
    "no-meta.sog": "no meta.json",
    "not-sog.sog": "not a splat file of a known format",
    "short-codebook.sog": "255 values, not 256",
    "version-1.sog": "SOG v1 .* missing required field `shape`",
    "version-3.sog": "SOG version 3",
    "bad-crc-v2.spz": "incorrect data check",
    "bad-fhcrc-v2.spz": "header crc mismatch",
    "bad-isize-v2.spz": "incorrect length check",
    "corrupt-deflate.spz": "invalid block type",
    "count-exceeds-stream-v2.spz": "forged: 1000000 Gaussians",
    "decode-nonfinite-v1.spz": "all 1 Gaussians hold NaN",
    "empty-points-v2.spz": "holds no Gaussians",
    "gzip-not-spz.spz": "holds no SPZ",
    "huge-count-v2.spz": "forged: 2147483648 Gaussians",
    "not-spz.spz": "not a splat file of a known format",
    "plaintext-v4.spz": "the table of streams needs 96 bytes",
    "sh-degree-5-v2.spz": "SH degree 5",
    "short-stream.spz": "10 of 16 bytes",
    "truncated-deflate-v2.spz": "ends within the alphas",
    "truncated-gzip-header.spz": "0 of 16 bytes",
    "truncated-payload-v2.spz": "ends within the colours",
    "version-0.spz": "SPZ version 0",
    "version-5.spz": "SPZ version 5",
}
NO_SPLATS = {".webp": "a picture", ".json": "neither SOG"}


def test_the_tables_cover_the_whole_folder(shared_data):
    known = set(SOUND)
    for path in sorted((shared_data / "splats").rglob("*")):
        name = path.relative_to(shared_data).as_posix()
        if path.is_dir() or name.startswith(ELSEWHERE):
            continue
        assert name in known or path.name in BROKEN or path.suffix in NO_SPLATS, name


@pytest.mark.parametrize("name", SOUND)
def test_sound_file(name, shared_data):
    file = load_cloud(shared_data / name)
    assert (file.format, file.stored, file.sh_degree) == SOUND[name]
    assert file.dropped == 0 and file.size > 0
    check_cloud_file(file)


@pytest.mark.parametrize("name", BROKEN)
def test_broken_file(name, shared_data):
    (path,) = (shared_data / "splats").rglob(name)
    with pytest.raises(FormatError, match=BROKEN[name]) as caught:
        load_cloud(path)
    error = caught.value
    assert error.file == str(path) and error.remedy
    assert error.offset is not None and 0 <= error.offset <= path.stat().st_size


@pytest.mark.parametrize("suffix", NO_SPLATS)
def test_what_lies_beside_is_named(suffix, shared_data):
    for path in sorted((shared_data / "splats").rglob(f"*{suffix}")):
        if path.name != "meta.json":
            with pytest.raises(FormatError, match=NO_SPLATS[suffix]) as caught:
                load_cloud(path)
            assert caught.value.remedy


def test_a_sog_folder_may_be_named_itself(shared_data):
    folder = shared_data / "splats/playcanvas/playcanvas-logo"
    by_folder, by_meta = load_cloud(folder), load_cloud(folder / "meta.json")
    assert by_folder.cloud.content_hash == by_meta.cloud.content_hash
    assert by_folder.size == sum(path.stat().st_size for path in folder.iterdir())


def test_leica_ply_and_sog_are_one_reconstruction(shared_data):
    """Each Gaussian of one is one of the other; what differs is what SOG rounds away."""
    stem = shared_data / "splats/leica-sofort/leica-sofort-top8192"
    ply = load_cloud(stem.with_suffix(".ply")).cloud
    sog = load_cloud(stem.with_suffix(".sog")).cloud

    def key(cloud):  # SOG is written in another order, and many Gaussians share a place
        logs = np.sign(cloud.means) * np.log1p(np.abs(cloud.means.astype(np.float64)))
        return logs, np.c_[logs, cloud.sh[:, 0] * 0.05, cloud.opacities[:, None] * 0.05]

    _, index = cKDTree(key(ply)[1]).query(key(sog)[1])
    assert len(np.unique(index)) == len(ply) == len(sog) == 8192
    same = ply.select(index)
    step = np.ptp(key(ply)[0], axis=0) / 65535
    assert (np.abs(key(same)[0] - key(sog)[0]) <= 1.01 * step).all()
    assert np.abs(sog.opacities - same.opacities).max() <= 1.01 / 255
    logs = np.log(np.maximum(same.scales, 1e-9)) - np.log(sog.scales)
    assert np.median(np.abs(logs)) < 0.02 and np.abs(logs).max() < 0.1
    dots = np.abs((same.quats.astype(np.float64) * sog.quats).sum(axis=1))
    assert (2 * np.arccos(np.clip(dots, 0, 1))).max() < 0.03
    assert np.abs(sog.sh[:, 0] - same.sh[:, 0]).max() < 0.04
    assert np.corrcoef(sog.sh[:, 1:].ravel(), same.sh[:, 1:].ravel())[0, 1] > 0.9999


def test_draft_gltf_has_scales_in_logs(shared_data):
    """The matrix says what each node tests, in the draft's logs: 0, ½, −½ and so on."""
    folder = shared_data / "splats/fixtures/khr_gaussian_splatting"
    file = load_cloud(folder / "khr_conformance_matrix.glb")
    cloud = file.cloud
    assert any("scales are logs" in note for note in file.notes)
    assert any("lin_rec709_display" in note for note in file.notes)
    np.testing.assert_allclose(cloud.scales[0], np.exp([0, 0.5, -0.5]), rtol=1e-6)
    np.testing.assert_allclose(cloud.scales[4], np.exp([1, -2, 3]), rtol=1e-6)  # plain int8
    np.testing.assert_allclose(cloud.scales[5], np.exp([1, 0, -1]), rtol=1e-6)  # fractions
    np.testing.assert_allclose(cloud.opacities[8:11], [0.75, 64 / 255, 16384 / 65535], rtol=1e-6)
    np.testing.assert_array_equal(cloud.means, np.tile(np.float32([-1, -2, 3]), (15, 1)))
    text = load_cloud(folder / "khr_conformance_matrix.gltf").cloud
    assert text.content_hash == cloud.content_hash


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
