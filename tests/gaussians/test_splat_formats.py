"""What a user may rely on whatever the format: the same Gaussians, in the axes of the PLY."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.errors import FormatError
from gn0.gaussians.cloud import GaussianCloud
from gn0.gaussians.splat import looks_like_splat
from gn0.gaussians.splat_files import describe_cloud_file, load_cloud
from gn0.gaussians.transform import transform_cloud
from gn0.geometry import rotation_from_quaternion
from gn0.testing.splat_writers import (
    build_gltf,
    build_ksplat,
    build_sog,
    build_sog_files,
    build_sog_streamed,
    build_splat,
    build_spz,
)
from gn0_trials.splat_corpus import check_cloud_file, small_cloud

# SPZ 1 and 2 hold x y z in steps of 1/127.5 and make w of them: where w is near 0, an error of
# 2 √3 / 255 in its square is √0.0136 in w, 0.24 rad. The others are half a step of their format.
# format -> (file of a cloud, largest errors: position, log scale, rotation [rad], opacity, DC, SH)
FORMATS = {
    "splat": (build_splat, (0, 1e-6, 0.02, 0.003, 0.008, None)),
    "spz-v1": (lambda c: build_spz(c, 1), (0.01, 0.032, 0.24, 0.003, 0.014, 0.005)),
    "spz-v2": (lambda c: build_spz(c, 2), (1.3e-4, 0.032, 0.24, 0.003, 0.014, 0.005)),
    "spz-v3": (lambda c: build_spz(c, 3), (1.3e-4, 0.032, 0.005, 0.003, 0.014, 0.005)),
    "spz-v4": (lambda c: build_spz(c, 4), (1.3e-4, 0.032, 0.005, 0.003, 0.014, 0.005)),
    "sog-v1": (lambda c: build_sog(c, 1), (1e-3, 0.03, 0.02, 0.02, 0.02, 0.02)),
    "sog-v2": (lambda c: build_sog(c, 2), (1e-3, 0.03, 0.02, 0.003, 0.02, 0.02)),
    "ksplat-0": (lambda c: build_ksplat(c, 0), (0, 1e-6, 2e-3, 0.003, 0.008, 0)),
    "ksplat-1": (lambda c: build_ksplat(c, 1), (1e-3, 1e-3, 2e-3, 0.003, 0.008, 1e-3)),
    "ksplat-2": (lambda c: build_ksplat(c, 2), (1e-3, 1e-3, 2e-3, 0.003, 0.008, 0.02)),
    "gltf": (lambda c: build_gltf(c)["splats.glb"], (0, 1e-6, 2e-3, 1e-6, 0, 1e-6)),
}


def mild(cloud: GaussianCloud) -> GaussianCloud:
    """The cloud with SH that every format can hold: SPZ ends at ±1."""
    cloud.sh[:] = np.clip(cloud.sh, -0.95, 0.95)
    return cloud


def read(tmp_path: Path, data: bytes):
    path = tmp_path / "cloud"
    path.write_bytes(data)
    file = load_cloud(path)
    check_cloud_file(file)
    return file


def assert_alike(got: GaussianCloud, cloud: GaussianCloud, errors) -> None:
    position, scale, angle, opacity, dc, sh = errors
    assert len(got) == len(cloud)
    assert np.abs(got.means - cloud.means).max() <= position
    assert np.abs(np.log(got.scales) - np.log(cloud.scales)).max() <= scale
    dots = np.abs((got.quats.astype(np.float64) * cloud.quats).sum(axis=1))
    assert (2 * np.arccos(np.clip(dots, 0, 1))).max() <= angle
    assert np.abs(got.opacities - cloud.opacities).max() <= opacity
    assert np.abs(got.sh[:, 0] - cloud.sh[:, 0]).max() <= dc
    if sh is not None and cloud.sh_degree:
        assert got.sh.shape == cloud.sh.shape
        assert np.abs(got.sh[:, 1:] - cloud.sh[:, 1:]).max() <= sh


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_same_gaussians(name, degree, tmp_path):
    write, errors = FORMATS[name]
    cloud = mild(small_cloud(700, degree))
    file = read(tmp_path, write(cloud))
    assert_alike(file.cloud, cloud, errors)
    assert file.sh_degree == (0 if name == "splat" else degree)
    assert (file.stored, file.dropped, file.levels) == (700, 0, 1)


@pytest.mark.parametrize("name", FORMATS)
def test_blocks_join_without_a_seam(name, tmp_path):
    """More Gaussians than any reader decodes at a time, palettes and buckets included."""
    write, errors = FORMATS[name]
    cloud = mild(small_cloud(70_001, 1))
    got = read(tmp_path, write(cloud)).cloud
    if name.startswith("sog"):  # its palette ends at 65536 entries; the writer here wraps round
        got.sh[65536:, 1:] = cloud.sh[65536:, 1:]
    assert_alike(got, cloud, errors)


@settings(max_examples=25, deadline=None)
@given(
    count=st.integers(1, 300),
    degree=st.integers(0, 3),
    name=st.sampled_from(sorted(FORMATS)),
    seed=st.integers(0, 99),
)
def test_any_count_and_degree(count, degree, name, seed, tmp_path_factory):
    write, errors = FORMATS[name]
    cloud = mild(small_cloud(count, degree, seed))
    file = read(tmp_path_factory.mktemp("any"), write(cloud))
    # a lone Gaussian has bounds without width, which no quantiser minds
    assert_alike(file.cloud, cloud, errors)


@pytest.mark.parametrize("name", ["spz-v2", "spz-v4", "gltf"])
def test_formats_with_axes_say_so(name, tmp_path):
    file = read(tmp_path, FORMATS[name][0](small_cloud(3, 0)))
    assert "x right, y down, z forward" in file.frame
    assert read(tmp_path, build_splat(small_cloud(3, 0))).frame == ""


def test_a_turned_cloud_has_the_same_covariances(tmp_path):
    """SPZ turns the Gaussians' own axes as well: other quaternions, the same ellipsoids."""

    def covariances(cloud):
        axes = rotation_from_quaternion(cloud.quats.astype(np.float64))
        axes = axes * cloud.scales[:, None, :]
        return axes @ axes.transpose(0, 2, 1)

    cloud = small_cloud(50, 0)
    got = read(tmp_path, build_spz(cloud, 4)).cloud
    wanted = covariances(cloud)
    size = np.abs(wanted).max(axis=(1, 2), keepdims=True)
    assert (np.abs(covariances(got) - wanted) / size).max() < 0.1


def test_spz_without_gzip_and_with_other_fractions(tmp_path):
    cloud = small_cloud(30, 1)
    plain = read(tmp_path, build_spz(cloud, 2, packed=False))
    packed = read(tmp_path, build_spz(cloud, 2))
    assert plain.cloud.content_hash == packed.cloud.content_hash
    assert (plain.encoding, packed.encoding) == ("bare", "gzip")
    fine = read(tmp_path, build_spz(cloud, 3, bits=18)).cloud
    assert np.abs(fine.means - cloud.means).max() < 2e-6


def test_spz_notes_what_was_not_read(tmp_path):
    data = build_spz(small_cloud(3, 0), 2, packed=False)
    flagged = data[:14] + b"\x03" + data[15:] + b"extension"
    notes = " ".join(read(tmp_path, gzip.compress(flagged)).notes)
    assert "antialiasing" in notes and "extensions" in notes and "9 unpacked bytes" in notes


def test_gltf_layouts_are_alike(tmp_path):
    cloud = small_cloud(40, 2)
    hashes, sizes = set(), []
    for layout in ("glb", "text", "beside"):
        files = build_gltf(cloud, layout)
        for name, data in files.items():
            (tmp_path / name).write_bytes(data)
        file = load_cloud(tmp_path / next(iter(files)))
        hashes.add(file.cloud.content_hash)
        sizes.append(file.size == sum(map(len, files.values())))
    assert len(hashes) == 1 and all(sizes)


def test_gltf_nodes_place_their_splats(tmp_path):
    """glTF's x and y are the PLY's reversed, so the node acts between two half turns."""
    cloud = small_cloud(20, 1)
    half = np.sqrt(0.5)
    node = {"translation": [1, 2, 3], "rotation": [half, 0, 0, half], "scale": [2, 2, 2]}
    data = build_gltf(cloud, node=node)["splats.glb"]
    turn = np.diag([-1.0, -1.0, 1.0])
    about_x = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    wanted = transform_cloud(
        cloud, rotation=turn @ about_x @ turn, scale=2.0, shift=turn @ np.array([1.0, 2, 3])
    )
    assert_alike(read(tmp_path, data).cloud, wanted, (1e-5, 1e-5, 2e-3, 1e-6, 1e-5, 1e-5))


@pytest.mark.parametrize("scale", [[1, 2, 1], [-1, 1, 1], [0, 0, 0]])
def test_gltf_nodes_that_bend_splats_are_refused(scale, tmp_path):
    (tmp_path / "a.glb").write_bytes(
        build_gltf(small_cloud(3, 0), node={"scale": scale})["splats.glb"]
    )
    with pytest.raises(FormatError, match="mirrors, flattens or stretches"):
        load_cloud(tmp_path / "a.glb")


def streamed(tmp_path: Path, change=lambda index: None) -> tuple[Path, list[GaussianCloud]]:
    levels = [small_cloud(40, 1), small_cloud(15, 1, seed=1), small_cloud(4, 1, seed=2)]
    files = build_sog_streamed(levels)
    index = json.loads(files["lod-meta.json"])
    change(index)
    files["lod-meta.json"] = json.dumps(index).encode()
    for name, data in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(data)
    return tmp_path, levels


def test_streamed_sog_gives_one_level(tmp_path):
    folder, levels = streamed(tmp_path)
    for level, cloud in enumerate(levels):
        file = load_cloud(folder, level=level)
        assert (file.stored, file.level, file.levels) == (len(cloud), level, 3)
        assert_alike(file.cloud, cloud, (1e-3, 0.03, 0.02, 0.003, 0.02, 0.02))
    assert load_cloud(folder).level == 0
    said = describe_cloud_file(folder, level=2)
    assert said["gaussians"] == 4 and said["levels"] == 3 and said["level"] == 2
    for level in (3, -1):
        with pytest.raises(FormatError, match=f"no level {level}: the file has 3") as caught:
            load_cloud(folder, level=level)
        assert "0 to 2" in caught.value.remedy


def test_streamed_sog_with_runs_of_a_chunk(tmp_path):
    """A leaf may use any run of a chunk; what no leaf names is not read."""

    def only_second_half(index):
        index["tree"]["children"].pop(0)

    folder, levels = streamed(tmp_path, only_second_half)
    got = load_cloud(folder).cloud
    wanted = levels[0].select(slice(20, 40))
    assert_alike(got, wanted, (1e-3, 0.03, 0.02, 0.003, 0.02, 0.02))


def test_streamed_sog_names_its_environment(tmp_path):
    folder, _ = streamed(tmp_path, lambda index: index.update(environment="env/meta.json"))
    assert any("'env/meta.json' are left out" in note for note in load_cloud(folder).notes)


@pytest.mark.parametrize("name", ["splat", "spz-v1", "sog-v2", "ksplat-1", "gltf"])
def test_a_level_where_there_are_none(name, tmp_path):
    (tmp_path / "a").write_bytes(FORMATS[name][0](small_cloud(3, 0)))
    assert load_cloud(tmp_path / "a", level=0).stored == 3
    with pytest.raises(FormatError, match="has one level of detail"):
        load_cloud(tmp_path / "a", level=1)


def test_non_finite_gaussians_are_dropped_and_counted(tmp_path):
    cloud = small_cloud(6, 0)
    cloud.means[1, 2] = np.nan
    cloud.means[4, 0] = np.inf
    for data in (build_splat(cloud), build_gltf(cloud)["splats.glb"], build_ksplat(cloud, 0)):
        file = read(tmp_path, data)
        assert (file.stored, file.dropped, len(file.cloud)) == (6, 2, 4)
    negative = small_cloud(6, 0)
    negative.scales[3, 1] = -1
    assert read(tmp_path, build_splat(negative)).dropped == 1


def test_a_sog_bundle_may_hold_a_folder(tmp_path):
    import io
    import zipfile

    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in build_sog_files(small_cloud(9, 1)).items():
            archive.writestr(f"scene/{name}", data)
    assert read(tmp_path, out.getvalue()).stored == 9


def test_limits_hold_for_every_format(tmp_path):
    for name, (write, _) in FORMATS.items():
        (tmp_path / name).write_bytes(write(small_cloud(10, 0)))
        load_cloud(tmp_path / name, limit_bytes=560)
        with pytest.raises(FormatError, match="more than the 559 allowed"):
            load_cloud(tmp_path / name, limit_bytes=559)


@pytest.mark.parametrize("flat", [0, 3, 63])
def test_a_splat_file_with_discs_and_points_is_known_as_one(flat: int) -> None:
    """Scales of exactly 0 are allowed; a file of nothing but zeros is none."""
    rng = np.random.default_rng(flat)
    records = rng.integers(0, 255, (64, 32)).astype(np.uint8)
    places = rng.uniform(0.01, 2.0, (64, 6)).astype("<f4")
    places[:flat, 3:] = 0.0
    records[:, :24] = places.view(np.uint8).reshape(64, 24)
    assert looks_like_splat(records.tobytes(), records.nbytes)
    records[:, 12:24] = 0
    assert not looks_like_splat(records.tobytes(), records.nbytes)
