"""JPEG files and whole datasets made on the device: the bytes of Pillow, through the real path."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from gn0.data.build import build_dataset
from gn0.data.cache_webdataset import ShardReader
from gn0.data.drawing_process import with_backend
from gn0.data.episode_frames import read_frames
from gn0.data.picture_build import render_dataset
from gn0.data.settings import BuildSettings, PictureSettings
from gn0.data.verify import verify_dataset
from gn0.device.device import Device
from gn0.render.cuda.depth import scale_on_device
from gn0.render.depth import to_millimetres
from gn0.render.share.jpeg import JpegEncoder
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import save_scene
from gn0.suites.suite import build_suite, load_suite


def pillow(picture: np.ndarray, quality: int) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, "JPEG", quality=quality, subsampling=2)
    return stream.getvalue()


def drawn(width: int, height: int, count: int) -> np.ndarray:
    """Pictures from smooth to noisy, with saturated edges."""
    rng = np.random.default_rng(width)
    y, x = np.mgrid[:height, :width]
    smooth = np.stack([x * 3 + y, x + y * 2, 255 - x], 2) % 256
    edges = np.where(((x // 7 + y // 5) % 2)[..., None], (255, 0, 0), (0, 0, 255))
    noise = [rng.normal(0, 4.0 * k, smooth.shape) for k in range(count)]
    found = [(edges if k % 3 == 2 else smooth) + noise[k] for k in range(count)]
    return np.clip(np.stack(found), 0, 255).astype(np.uint8)


@pytest.mark.small
@pytest.mark.parametrize("size", [(64, 48), (33, 17)])
def test_files_are_pillows(device: Device, size: tuple[int, int]) -> None:
    shown = drawn(*size, 4)
    for quality in (85, 100):
        files = JpegEncoder(device).encode(device.upload(shown), quality).files()
        assert files == [pillow(picture, quality) for picture in shown]


def test_views_and_mosaics_of_their_real_sizes(card: Device) -> None:
    encoder = JpegEncoder(card)
    shown = drawn(480, 360, 64)
    views = card.upload(shown)
    assert encoder.encode(views, 85).files() == [pillow(picture, 85) for picture in shown]
    tiles = encoder.reduce(views, 160, 120)
    host = tiles.numpy()
    for picture, tile in zip(shown, host, strict=True):
        wanted = Image.fromarray(picture).resize((160, 120), Image.Resampling.BOX)
        np.testing.assert_array_equal(tile, np.asarray(wanted))
    numbers = np.random.default_rng(0).integers(-1, 64, (32, 16))
    table = np.where(numbers < 0, 0, tiles.pointer + numbers * host[0].nbytes).astype(np.uint64)
    files = encoder.encode_mosaics(table, (160, 120), 4, 85).files()
    for row, file in zip(numbers, files, strict=True):
        cells = [np.zeros_like(host[0]) if n < 0 else host[n] for n in row]
        rows = [np.concatenate(cells[i : i + 4], axis=1) for i in range(0, 16, 4)]
        assert file == pillow(np.concatenate(rows), 85)


@pytest.mark.small
def test_depth_becomes_the_hosts_millimetres(device: Device) -> None:
    """Every half millimetre as well, where rounding shows, and what is no distance."""
    depth = (np.arange(1 << 14, dtype=np.float32) / 16).reshape(2, 64, 128)
    depth[0, 0, :6] = np.inf, np.nan, -1.0, 0.0004, 65.5354, 3e38
    found = scale_on_device(device, device.upload(depth)).numpy()
    np.testing.assert_array_equal(found, to_millimetres(depth))


def test_a_dataset_comes_out_the_same_twice(card: Device, tmp_path: Path) -> None:
    """Drawn by the process that owns the card: files are Pillow's, workers change nothing."""
    save_scene(build_example_scene(), tmp_path / "flat")
    build_suite([tmp_path / "flat"], tmp_path / "suite", 6, 0)
    suite = load_suite(tmp_path / "suite")
    pictures = with_backend(PictureSettings(quality=85, depth=True), "cuda")
    settings = BuildSettings(chunk=2, pictures=pictures)
    one = build_dataset(suite, tmp_path / "one", settings, workers=1)
    build_dataset(suite, tmp_path / "two", settings, workers=3, batch=17)

    def files(folder: Path) -> dict[str, bytes]:
        return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*"))
                if p.is_file() and p.name != ".lock"}  # fmt: skip

    assert files(tmp_path / "one") == files(tmp_path / "two")
    assert verify_dataset(tmp_path / "one", pixels=True).ok
    before = files(tmp_path / "one")
    for path in sorted((tmp_path / "one" / "pictures").rglob("*"), reverse=True):
        path.rmdir() if path.is_dir() else path.unlink()
    render_dataset(tmp_path / "one", workers=2)
    assert files(tmp_path / "one") == before
    name = one.sampled[0]
    reader = ShardReader(one.folder, one.part_of(name).name, pictures)
    for row, frame in enumerate(read_frames(one, name, ("rgb", "history", "depth"), exact=True)):
        stored = reader.depth(row)
        near = (stored > 0) & (stored < 10_000)  # mm: the sensor's range
        np.testing.assert_array_equal(stored[near], to_millimetres(frame["depth"])[near])
        assert near.mean() > 0.5
        for kind in ("rgb", "history"):
            encoded = Image.open(io.BytesIO(pillow(frame[kind], 85)))
            np.testing.assert_array_equal(reader.picture(row, kind), np.asarray(encoded))
