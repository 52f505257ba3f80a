"""The card of a WebDataset cache: README.md, with the YAML header that Hugging Face reads.

The head names the shards of each split and the type of every field, so that
`datasets.load_dataset(FOLDER, streaming=True)` need not guess from the first samples.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any

from gn0.data.dataset import Dataset, FileRecord
from gn0.data.picture_cache import cache_folder, write_recorded
from gn0.data.sample_table import DEPTH, PICTURES
from gn0.data.settings import PictureSettings
from gn0.missions.episode import MissionGoal
from gn0.scenes.folder import load_scene_file
from gn0.sim.history import mosaic_size
from gn0.sim.presets import find_preset
from gn0.storage import safe_join
from gn0.yaml_file import encode_yaml

CARD = "README.md"
MIXED = "mixed"  # split of the shards whose episodes are of several
_HUB = {"CC0-1.0", "CC-BY-4.0", "CC-BY-SA-4.0", "CC-BY-NC-4.0", "Apache-2.0", "MIT"}
_SIZES = ((10**3, "n<1K"), (10**4, "1K<n<10K"), (10**5, "10K<n<100K"), (10**6, "100K<n<1M"),
          (10**7, "1M<n<10M"), (10**8, "10M<n<100M"))  # fmt: skip
Field = dict[str, Any]


def write_card(dataset: Dataset, settings: PictureSettings) -> FileRecord:
    """Write `README.md` of a dataset's shards.

    Raises:
        StorageError: it cannot be written.
    """
    folder = cache_folder(dataset.folder, "webdataset")
    data = describe_card(dataset, settings).encode()
    return write_recorded(folder, CARD, lambda put: (put(data), None)[1])


def describe_card(dataset: Dataset, settings: PictureSettings) -> str:
    """The text of the card."""
    licences = {
        scene.id: load_scene_file(safe_join(dataset.folder, scene.folder)).licence
        for scene in dataset.about.scenes
    }
    head = encode_yaml(_head(dataset, settings, licences))
    return f"---\n{head}---\n\n" + "\n".join(_body(dataset, settings, licences)) + "\n"


def _head(
    dataset: Dataset, settings: PictureSettings, licences: Mapping[str, str]
) -> dict[str, Any]:
    about = dataset.about
    only = set(licences.values())
    known = next(iter(only)) if len(only) == 1 else ""
    licence = {"license": known.lower()} if known in _HUB else {
        "license": "other", "license_name": "of-each-scene"
    }  # fmt: skip
    return {
        "pretty_name": about.suite.name or "GN0 samples",
        **licence,
        "task_categories": ["robotics", "image-text-to-text"],
        "tags": ["webdataset", "embodied-navigation", "gaussian-splatting", "gn0"],
        "size_categories": [next((text for most, text in _SIZES if about.rows < most), "n>100M")],
        "configs": [
            {
                "config_name": "default",
                "data_files": [
                    {"split": split, "path": paths}
                    for split, paths in split_shards(dataset).items()
                ],
            }
        ],
        "dataset_info": {"features": describe_fields(dataset, settings)},
    }


def split_shards(dataset: Dataset) -> dict[str, list[str]]:
    """The shards of each split; those whose episodes are of several are `MIXED`."""
    found: dict[str, list[str]] = {}
    for part in dataset.about.parts:
        if not part.rows:
            continue
        splits = {dataset.episode(name).split for name in part.episodes}
        split = splits.pop() if len(splits) == 1 else MIXED
        split = re.sub(r"\W", "_", split) or "train"
        found.setdefault(split, []).append(f"{part.name}.tar")
    return found


def describe_fields(dataset: Dataset, settings: PictureSettings) -> list[Field]:
    """The type of every field of a sample, as Hugging Face's cards say it."""
    kind = settings.format
    pictures = ["rgb", "history"]
    if settings.maps == "every":
        pictures += ["bev", "occupancy"]
    if has_goals(dataset):
        pictures.append("goal")
    fields: list[Field] = [{"name": f"{name}.{kind}", "dtype": "image"} for name in pictures]
    if "npy" in settings.depth_files:
        fields.append({"name": "depth.npy", "list": {"list": "uint16"}})
    if "png" in settings.depth_files:
        fields.append({"name": "depth.png", "dtype": "image"})
    hashed = (*PICTURES, DEPTH) if dataset.about.settings.pictures.depth else PICTURES
    pair = {"list": "int64"}
    label = {
        "actions": pair,
        "bev": "string",
        "collided": "bool",
        "episode_id": "string",
        "executed": "int64",
        "hashes": [{"name": name, "dtype": "string"} for name in sorted(hashed)],
        "instruction": "string",
        "mission": "string",
        "occupancy": [
            {"name": "current_xy", **pair},
            {"name": "map", "dtype": "string"},
            {"name": "radius", "dtype": "int64"},
            {"name": "size_xy", **pair},
            {"name": "start_xy", **pair},
        ],
        "policy_actions": pair,
        "pose": {"list": "float64"},
        "scene": "string",
        "source": "string",
        "split": "string",
        "step": "int64",
        "tokens_xy": {"list": {"list": "int64"}},
        "valid": "int64",
        "waypoints": {"list": {"list": "float64"}},
    }
    fields.append({"name": "json", "struct": [_field(name, own) for name, own in label.items()]})
    return [*fields, {"name": "__key__", "dtype": "string"}, {"name": "__url__", "dtype": "string"}]


def _field(name: str, own: Any) -> Field:
    if isinstance(own, str):
        return {"name": name, "dtype": own}
    return {"name": name, "struct": own} if isinstance(own, list) else {"name": name, **own}


def has_goals(dataset: Dataset) -> bool:
    """Whether any sample has a picture of its goal."""
    return any(isinstance(dataset.episode(name).mission, MissionGoal) for name in dataset.sampled)


def _body(
    dataset: Dataset, settings: PictureSettings, licences: Mapping[str, str]
) -> Sequence[str]:
    about, kind = dataset.about, settings.format
    preset = find_preset(about.camera)
    width, height = preset.picture_size
    across, down = mosaic_size(preset.history_tile)
    rows = [
        (f"`rgb.{kind}`", f"the view, {width}×{height}, {preset.rgb.hfov:.2f}° wide"),
        (f"`history.{kind}`", f"the last sixteen views, newest at the top left, {across}×{down}"),
    ]
    if settings.maps == "every":
        rows += [
            (f"`bev.{kind}`", "the scene from above; its size is the scene's"),
            (f"`occupancy.{kind}`", "the map: start in green, agent in red"),
        ]
    if has_goals(dataset):
        rows.append((f"`goal.{kind}`", "what the goal looks like (goal missions)"))
    for ending in settings.depth_files:
        rows.append((f"`depth.{ending}`", "uint16 [H, W]: camera z in mm, 0 where nothing is seen"))
    rows.append(
        (
            "`json`",
            "pose (x, y [m], yaw [rad], world of the scene, z up), six next actions (0 STOP, "
            "1 FORWARD, 2 LEFT, 3 RIGHT), 13 waypoints (x forward, y left [m] in the agent's "
            "frame), the same as map tokens (x, y) of 0 to 999, instruction, scene, split",
        )
    )
    lines = [
        f"# {about.suite.name or 'GN0 samples'}",
        "",
        f"{about.rows:,} samples of {len(dataset.sampled):,} episodes in {len(licences):,} scenes "
        f"of Gaussian splats; camera `{about.camera}`; written by {about.software or 'gn0'}.",
        "",
        "| member | content |",
        "| --- | --- |",
        *(f"| {name} | {text} |" for name, text in rows),
        "",
        "```python",
        "import datasets",
        "",
        'for sample in datasets.load_dataset("THIS FOLDER", streaming=True)["SPLIT"]:',
        f'    print(sample["json"]["instruction"], sample["rgb.{kind}"].size)',
        "```",
        "",
        "```python",
        "import webdataset",
        "",
        'for sample in webdataset.WebDataset("SHARD.tar", shardshuffle=False).decode("rgb8"):',
        f'    print(sample["json"]["instruction"], sample["rgb.{kind}"].shape)',
        "```",
    ]
    if "png" in settings.depth_files:
        lines += ["", "`depth.png` has 16 bits: decoders that make RGB of every picture cut it."]
    if settings.maps == "once":
        lines += ["", "BEV and bare occupancy picture lie beside, named by `json`."]
    lines += ["", "| scene | licence |", "| --- | --- |"]
    lines += [f"| {name} | {text or 'not stated'} |" for name, text in sorted(licences.items())]
    return lines
