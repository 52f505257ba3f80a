"""`webdataset` and `datasets` over the shards alone: every field, and the card's head."""

from __future__ import annotations

import io
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from gn0.data.dataset import Dataset
from gn0.data.episode_frames import read_frames

pytestmark = pytest.mark.filterwarnings("ignore")
PICTURES = ("rgb", "history", "bev", "occupancy", "goal")


@pytest.fixture
def alone(shards: Path, tmp_path: Path) -> Path:
    """The shards and their card, and nothing that lay beside them."""
    for path in (*shards.glob("*.tar"), shards / "README.md"):
        shutil.copy(path, tmp_path)
    return tmp_path


def _compare(walks: Dataset, about: dict[str, Any], pictures: dict[str, Any], depth: Any) -> None:
    name, t = about["episode_id"], about["step"]
    rows, episode = walks.rows(name), walks.episode(name)
    assert about["instruction"] == episode.instruction and about["split"] == episode.split
    assert about["pose"] == rows.poses[t].tolist()
    assert about["actions"] == rows.actions[t].tolist()
    assert np.allclose(about["waypoints"], rows.waypoints[t], atol=1e-6)
    assert about["tokens_xy"] == rows.pixels[t].tolist()
    assert about["hashes"] == {key: own[t] for key, own in rows.hashes.items()}
    kinds = ["rgb", "history", "bev", "occupancy", "depth"]
    if name != "words":
        kinds.append("goal_picture")
    for number, frame in enumerate(read_frames(walks, name, kinds, exact=True)):
        if number != t:
            continue
        for kind in PICTURES:
            wanted = frame.get("goal_picture" if kind == "goal" else kind)
            assert (wanted is None) == (pictures.get(kind) is None), kind
            if wanted is not None:
                difference = np.asarray(pictures[kind], float) - wanted
                assert difference.shape == wanted.shape
                assert np.sqrt((difference**2).mean()) < 12
        seen = np.asarray(depth)
        assert seen.shape == frame["depth"].shape
        metres = np.where(seen == 0, np.inf, seen / 1000).clip(0, frame["depth"].max())
        assert np.abs(metres - frame["depth"]).max() < 0.001
        x, y = about["occupancy"]["current_xy"]
        assert frame["occupancy"][y, x].tolist() == [255, 0, 0]


def test_webdataset_reads_every_field(alone: Path, walks: Dataset) -> None:
    webdataset = pytest.importorskip("webdataset")
    urls = sorted(map(str, alone.glob("*.tar")))
    samples = list(webdataset.WebDataset(urls, shardshuffle=False).decode("rgb8"))
    assert len(samples) == walks.about.rows
    for sample in samples[:: len(samples) // 5]:
        pictures = {name: sample.get(f"{name}.jpg") for name in PICTURES}
        assert sample["depth.npy"].dtype == np.uint16
        _compare(walks, sample["json"], pictures, sample["depth.npy"])
    shown = {name: "goal.jpg" in s for s in samples for name in [s["json"]["episode_id"]]}
    assert shown == {name: name != "words" for name in walks.sampled}


@pytest.mark.parametrize("streaming", [True, False])
def test_datasets_reads_every_field_by_the_card(
    alone: Path, walks: Dataset, streaming: bool, tmp_path_factory: Any
) -> None:
    datasets = pytest.importorskip("datasets")
    cache = str(tmp_path_factory.mktemp("hub"))
    found = datasets.load_dataset(str(alone), streaming=streaming, cache_dir=cache)
    assert set(found) == {"train"}
    samples = list(found["train"])
    assert len(samples) == walks.about.rows
    for sample in samples[:: len(samples) // 5]:
        pictures = {
            name: None if sample[f"{name}.jpg"] is None else np.asarray(sample[f"{name}.jpg"])
            for name in PICTURES
        }
        _compare(walks, sample["json"], pictures, sample["depth.npy"])
        assert sample["depth.png"].mode.startswith("I")
        assert np.array_equal(np.asarray(sample["depth.png"]), np.asarray(sample["depth.npy"]))


def test_the_card_says_what_a_reader_would_infer(alone: Path) -> None:
    datasets = pytest.importorskip("datasets")
    told = datasets.load_dataset_builder(str(alone)).info.features
    (alone / "README.md").unlink()
    guessed = datasets.load_dataset_builder("webdataset", data_dir=str(alone))
    one = next(iter(guessed.as_streaming_dataset(split="train")))
    assert set(told) == {*one, "goal.jpg"}
    assert set(told["json"]) == set(one["json"])


def test_a_member_is_a_whole_file(alone: Path) -> None:
    import tarfile

    with tarfile.open(next(iter(sorted(alone.glob("*.tar"))))) as shard:
        for member in shard.getmembers()[:6]:
            stream = shard.extractfile(member)
            assert stream is not None
            if member.name.endswith(".jpg"):
                Image.open(io.BytesIO(stream.read())).verify()
