"""A dataset's samples in an order that a run can be told to repeat, on any number of processes."""

from __future__ import annotations

import dataclasses
import json
import os
import shutil
import signal
from collections import Counter
from pathlib import Path

import msgspec
import numpy as np
import pytest

pytest.importorskip("torch")
pytest.importorskip("transformers")

import torch

from gn0.data.answer_form import AnswerForm
from gn0.data.answer_slots import compile_slots
from gn0.data.balance import BalanceSettings, balance_dataset
from gn0.data.build import build_dataset
from gn0.data.cache_webdataset import load_index
from gn0.data.codec import decode_waypoints, write_answer
from gn0.data.dataset import Dataset, open_dataset
from gn0.data.episode_frames import read_frames
from gn0.data.settings import BuildSettings, PictureSettings
from gn0.errors import ConfigError, DataError, FormatError, JobError, StorageError
from gn0.maps.grid import UNKNOWN, OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.missions.goal import sample_goal_episodes
from gn0.policies.bae.prompt_fields import render_prompt, sample_answer, sample_state
from gn0.policies.bae.prompt_table import build_prompt_table
from gn0.policies.bae.prompt_template import load_prompt
from gn0.policies.bae.tokenizer import read_token_ids, train_tokenizer
from gn0.policies.bae.tokenizer_file import TokenizerFile
from gn0.policies.qwen.layout import PictureSize
from gn0.render.light import LightCondition
from gn0.scenes.example import build_example_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.sim.ego_map import EgoSquare, MapView
from gn0.suites.suite import build_suite, save_suite
from gn0.training.streams.picture_jitter import PictureJitter
from gn0.training.streams.samples import LabelledStates, SampleMaker
from gn0.training.streams.stream_dataset import StreamDataset

VIEW = MapView((EgoSquare(48), EgoSquare(40, metres_per_pixel=0.15, content="occupancy")))
NAMES = ("rgb", "history", "bev", "occupancy", "near", "far", "goal_picture")
LABELS = ("episode", "pose", "last", "collided", "actions", "waypoints", "distance")


@pytest.fixture(scope="module")
def suite(tmp_path_factory):
    """Seven short walks, two of them in the evening."""
    root = tmp_path_factory.mktemp("walks")
    save_scene(build_example_scene(), root / "flat")
    scene = load_scene(root / "flat")
    navigation = NavigationMap(scene.grid, 0.2)
    short = {"minimum_length": 1.5, "maximum_length": 2.5}
    found = sample_goal_episodes(scene, navigation, 7, 0, **short)
    evening = LightCondition(name="evening", exposure=-1.0, kelvin=3200.0)
    change = msgspec.structs.replace
    lit = [change(e, light=evening) if n in (2, 3) else e for n, e in enumerate(found)]
    return save_suite(root / "suite", [scene], lit, name="walks", camera="tiny_128", max_steps=60)


def build(suite, out: Path, layout: str) -> Dataset:
    settings = BuildSettings(chunk=2, pictures=PictureSettings(layout=layout))  # type: ignore[arg-type]
    return build_dataset(suite, out, settings)


@pytest.fixture(scope="module")
def cached(suite, tmp_path_factory) -> Dataset:
    """With pictures in shards; do not write to it."""
    return build(suite, tmp_path_factory.mktemp("c") / "data", "webdataset")


@pytest.fixture(scope="module")
def bare(suite, tmp_path_factory) -> Dataset:
    """Poses and labels alone; do not write to it."""
    return build(suite, tmp_path_factory.mktemp("b") / "data", "none")


def total(dataset: Dataset) -> int:
    return sum(part.rows for part in dataset.about.parts)


def names_of(states: LabelledStates) -> list[tuple[int, ...]]:
    """What tells a sample from another: its episode and its pose."""
    return [
        (int(e), *map(float, pose)) for e, pose in zip(states.episode, states.pose, strict=True)
    ]


def same(one: LabelledStates, other: LabelledStates) -> bool:
    return all(torch.equal(getattr(one, k), getattr(other, k)) for k in LABELS) and all(
        torch.equal(one.pictures[k], other.pictures[k]) for k in one.pictures
    )


@pytest.mark.parametrize(("kind", "paint"), [("cached", "scene"), ("bare", "categories")])
def test_samples_are_the_datasets_row_by_row(kind: str, paint: str, request) -> None:
    dataset: Dataset = request.getfixturevalue(kind)
    view = msgspec.structs.replace(VIEW, paint=paint)
    stream = StreamDataset(dataset, NAMES, map_view=view, blackout=0, buffer=30)
    states = stream.draw(total(dataset))
    seen = {}
    sensors = ("rgb", "history", "bev", "occupancy", "ego_map", "goal_picture")
    for number, name in enumerate(dataset.sampled):
        rows = dataset.rows(name)
        for step, frame in enumerate(read_frames(dataset, name, sensors, map_view=view)):
            frame["near"], frame["far"] = VIEW.split(frame.pop("ego_map"))
            seen[(number, *rows.poses[step].tolist(), step == 0)] = rows, step, frame
        assert stream.texts[number] == dataset.episode(name).instruction
    assert len(seen) >= total(dataset) - 7
    for k, name in enumerate(names_of(states)):
        rows, step, frame = seen[(*name, int(states.last[k]) < 0)]
        assert states.last[k] == (rows.executed[step - 1] if step else -1)
        assert states.collided[k] == (bool(rows.collided[step - 1]) if step else False)
        assert states.actions[k].tolist() == rows.actions[step].tolist()
        assert np.array_equal(states.waypoints[k].numpy(), rows.waypoints[step])
        assert states.distance[k] == rows.distance[step]
        for picture in NAMES:
            assert np.array_equal(states.pictures[picture][k].numpy(), frame[picture]), picture
        assert step or not states.pictures["history"][k].any()  # no past: black


def test_the_sequence_is_the_same_for_any_number_of_workers(cached: Dataset) -> None:
    drawn = {}
    for workers in (0, 1, 2, 3):
        with StreamDataset(
            cached, ("rgb", "history", "near"), map_view=VIEW, workers=workers, seed=3, buffer=40,
            jitter=PictureJitter(), blackout=0.3,
        ) as stream:  # fmt: skip
            drawn[workers] = [stream.draw(count) for count in (25, 25, 25, 70, 70, 25)]
    for workers in (1, 2, 3):
        assert all(map(same, drawn[0], drawn[workers]))


def test_ranks_share_an_epoch_without_overlap(cached: Dataset) -> None:
    count = total(cached)
    streams = [StreamDataset(cached, (), rank=rank, ranks=3, seed=1) for rank in range(3)]
    steps = [[s.draw(1) for s in streams] for _ in range(count)]  # three epochs over all ranks
    order = [name for step in steps for states in step for name in names_of(states)]
    alone = StreamDataset(cached, (), seed=1)
    assert order == names_of(alone.draw(3 * count))
    for epoch in range(3):
        assert Counter(order[epoch * count : (epoch + 1) * count]) == Counter(order[:count])
    assert streams[0].state() == streams[2].state() == alone.state()


@pytest.mark.parametrize("workers", [0, 2])
def test_a_stream_goes_on_where_it_was_left(cached: Dataset, workers: int) -> None:
    settings = {"map_view": VIEW, "seed": 9, "buffer": 32, "jitter": PictureJitter()}
    whole = StreamDataset(cached, ("history", "near"), **settings).draw(2 * total(cached))
    places = np.random.default_rng(0).integers(1, 2 * total(cached) - 12, 5).tolist()
    with StreamDataset(cached, ("history", "near"), workers=workers, **settings) as again:
        for place in places:
            first = StreamDataset(cached, ("history", "near"), **settings)
            first.draw(place)
            again.restore(json.loads(json.dumps(first.state())))
            for begin in (place, place + 6):
                assert same(again.draw(6), whole.pick(slice(begin, begin + 6)))


def test_other_ranks_go_on_with_what_is_left(cached: Dataset) -> None:
    whole = names_of(StreamDataset(cached, ()).draw(60))
    first = [StreamDataset(cached, (), rank=rank, ranks=2) for rank in range(2)]
    for stream in first:
        stream.draw(10)
    then = [StreamDataset(cached, (), rank=rank, ranks=4) for rank in range(4)]
    for stream in then:
        stream.restore(first[1].state())
    drawn = [names_of(stream.draw(10)) for stream in then]
    assert [drawn[k % 4][k // 4] for k in range(40)] == whole[20:]


def test_samples_are_shuffled_in_blocks_of_whole_parts(cached: Dataset) -> None:
    stream = StreamDataset(cached, (), buffer=1)
    parts = stream.order.part_of(stream.order.epoch(0))
    assert len(np.flatnonzero(np.diff(parts))) == len(cached.about.parts) - 1  # each part in one go
    free = StreamDataset(cached, (), buffer=10**6).order
    assert not np.array_equal(free.epoch(0), free.epoch(1))
    assert (np.diff(free.epoch(0)) != 1).mean() > 0.9


def test_weights_say_how_often_a_sample_comes(cached: Dataset, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(cached.folder, tmp_path / "data"))
    shares = {"forward": 40.0, "left": 25.0, "right": 25.0, "stop": 10.0}
    balance_dataset(open_dataset(folder), BalanceSettings(**shares))
    stream = StreamDataset(folder, (), seed=2)
    epochs = 40
    counts = sum(stream.order.count(epoch) for epoch in range(epochs))
    weights = stream.order.weights
    assert weights is not None and len(set(weights.tolist())) == 4
    assert (np.abs(counts - epochs * weights) <= 1 + 1e-6 * epochs).all()
    states = stream.draw(int(counts.sum()))
    first = np.bincount(states.actions[:, 0].numpy(), minlength=4) / len(states)
    wanted = np.array([shares[k] for k in ("stop", "forward", "left", "right")]) / 100
    assert np.abs(first - wanted).max() < 0.01
    plain = StreamDataset(folder, (), seed=2, weighted=False)
    assert len(set(names_of(plain.draw(total(cached))))) > 0.9 * total(cached)
    with pytest.raises(DataError, match="content hash"):
        plain.restore(stream.state())
    with pytest.raises(DataError, match="gn0 data balance"):
        StreamDataset(cached, (), weighted=True)


def test_one_mosaic_in_ten_is_black(cached: Dataset) -> None:
    stream = StreamDataset(cached, ("history",))
    states = stream.draw(12 * total(cached))
    black = (states.pictures["history"] == 0).flatten(1).all(1)
    with_past = states.last >= 0
    assert 0.07 < black[with_past].float().mean() < 0.13
    assert black[~with_past].all()


def test_jitter_changes_light_and_never_sides(cached: Dataset) -> None:
    one = StreamDataset(cached, ("rgb", "bev", "near")).draw(30).pictures
    other = StreamDataset(cached, ("rgb", "bev", "near"), jitter=PictureJitter()).draw(30).pictures
    assert torch.equal(one["bev"], other["bev"]) and torch.equal(one["near"], other["near"])
    changed = 0
    for plain, lit in zip(one["rgb"].float(), other["rgb"].float(), strict=True):
        changed += not torch.equal(plain, lit)
        if plain.std() > 5 and lit.std() > 2:
            straight = torch.corrcoef(torch.stack([plain.mean(-1).ravel(), lit.mean(-1).ravel()]))
            assert straight[0, 1] > 0.9
    assert changed == 30
    picture = np.random.default_rng(0).integers(0, 256, (6, 5, 3), np.uint8)
    assert np.array_equal(PictureJitter().apply(picture, np.full(6, 0.5)), picture)


def test_papers_prompts_and_answers_come_of_a_dataset(cached: Dataset) -> None:
    from gn0.policies.bae.sizes import build_model
    from gn0.policies.qwen.architecture import parse_architecture

    stream = StreamDataset(cached, ("bev", "occupancy"), map_size=(64, 64))
    template = load_prompt("paper_planning_maps")
    prompts = [template.fill(dict.fromkeys(template.fields, "x"))]
    tokenizer = train_tokenizer([*stream.texts, *prompts], 300)
    ids, words = read_token_ids(tokenizer), TokenizerFile(tokenizer.backend_tokenizer)
    architecture = parse_architecture(build_model("nano", ids, 0).config.to_dict())
    sizes = {name: PictureSize(*size) for name, size in stream.sizes().items()}
    table = build_prompt_table(template, stream.prompt_states(), sizes, architecture, words, ids)
    slots = compile_slots(AnswerForm(points=13, layout="json"), ids.vocabulary, words)
    maker = SampleMaker(table, slots, VIEW.squares[0], "cpu", stream.maps)  # type: ignore[arg-type]
    states = stream.draw(total(cached))
    batch = maker.make(states)
    assert [one.shape[1:] for one in batch.pictures] == [(64, 64, 3)] * 2
    assert torch.equal(maker.actions(batch.answer), states.actions.long())
    back = maker.waypoints(batch.answer, states.episode, states.pose)
    for k, (number, *pose) in enumerate(names_of(states)):
        name = cached.sampled[number]
        rows = cached.rows(name)
        found = (rows.poses == pose).all(1) & (rows.distance == states.distance[k].item())
        steps = [s for s in np.flatnonzero(found) if (s == 0) == (int(states.last[k]) < 0)]
        answer = sample_answer(cached, name, int(steps[0]), slots.form)
        text = words.decode(batch.answer[k].tolist()).removesuffix("<|im_end|>")
        assert text == write_answer(answer.actions, answer.tokens)
        tokens = rows.pixels[steps[0]][None]
        exact = decode_waypoints(stream.frames[number], tokens, np.array([pose]))[0]
        assert np.array_equal(back[k].numpy()[-12:], exact[-12:])
        asked = render_prompt(template, sample_state(cached, name, int(steps[0]))).text
        assert asked.replace("<image>", "") in words.decode(batch.ids[k].tolist())
    with pytest.raises(ConfigError, match="episodes and poses"):
        maker.answers(states.actions, states.waypoints)


def test_maps_of_several_scenes_are_brought_to_one_size(tmp_path: Path) -> None:
    folders = []
    for name, more in (("small", 6), ("large", 9)):
        scene = build_example_scene(spacing=0.5)
        grid = scene.grid
        wide = np.pad(grid.cells, ((0, 0), (0, more)), constant_values=UNKNOWN)
        scene = dataclasses.replace(
            scene, id=name, grid=OccupancyGrid(wide, grid.resolution, grid.origin)
        )
        save_scene(scene, tmp_path / name)
        folders.append(tmp_path / name)
    found = build_suite(folders, tmp_path / "suite", 2, max_steps=40, camera="tiny_128")
    dataset = build(found, tmp_path / "data", "none")
    with pytest.raises(DataError, match="give a map_size"):
        StreamDataset(dataset, ("bev",)).draw(total(dataset))
    stream = StreamDataset(dataset, ("bev", "occupancy"), map_size=(96, 80))
    assert stream.sizes() == {"bev": (96, 80), "occupancy": (96, 80)}
    assert stream.draw(total(dataset)).pictures["occupancy"].shape[1:] == (80, 96, 3)
    assert len({width for width, *_ in stream.maps.tolist()}) == 2


def test_several_datasets_are_one_stream(cached: Dataset, bare: Dataset) -> None:
    both, count = (cached, bare), 2 * total(cached)
    stream = StreamDataset(both, ("history",), seed=1, buffer=40, blackout=0)
    states = stream.draw(count)
    drawn = Counter(names_of(states))
    shift = len(cached.sampled)
    for number, dataset in enumerate(both):
        alone = names_of(StreamDataset(dataset, ()).draw(total(dataset)))
        own = {(e + number * shift, *pose): n for (e, *pose), n in Counter(alone).items()}
        assert {name: drawn[name] for name in own} == own
    assert stream.texts == 2 * StreamDataset(cached, ()).texts
    assert len(stream.maps) == 2 * shift
    early = set((states.episode[: count // 2] >= shift).tolist())
    assert early == {True, False}  # parts of both come mixed
    ranks = [
        StreamDataset(both, (), seed=1, buffer=40, rank=rank, ranks=2, blackout=0)
        for rank in range(2)
    ]
    halves = [names_of(one.draw(count // 2)) for one in ranks]
    assert [halves[k % 2][k // 2] for k in range(count)] == names_of(states)
    with StreamDataset(both, ("history",), seed=1, buffer=40, blackout=0, workers=2) as again:
        first = StreamDataset(both, ("history",), seed=1, buffer=40, blackout=0)
        first.draw(13)
        again.restore(json.loads(json.dumps(first.state())))
        for begin in (13, 30):
            assert same(again.draw(17), states.pick(slice(begin, begin + 17)))
    assert stream.hash != StreamDataset((bare, cached), ()).hash
    with pytest.raises(DataError, match="content hash"):
        StreamDataset(cached, ("history",), seed=1).restore(stream.state())


def test_datasets_have_their_shares_whatever_their_sizes(cached: Dataset, bare: Dataset) -> None:
    stream = StreamDataset((cached, bare), (), shares=(3, 1))
    count = 6 * total(cached)
    second = (stream.draw(count).episode >= len(cached.sampled)).sum().item()
    assert second == pytest.approx(count / 4, abs=total(cached) / 20)
    with pytest.raises(ConfigError, match="shares 1 of 2 datasets"):
        StreamDataset((cached, bare), (), shares=(1,))
    with pytest.raises(ConfigError, match="one number above 0"):
        StreamDataset((cached, bare), (), shares=(1, 0))
    with pytest.raises(DataError, match="content hash"):
        stream.restore(StreamDataset((cached, bare), (), shares=(1, 3)).state())


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="needs SIGKILL")
def test_a_worker_that_is_killed_is_named(cached: Dataset) -> None:
    whole = StreamDataset(cached, (), seed=4).draw(24)
    with StreamDataset(cached, (), workers=2, seed=4) as stream:
        assert same(stream.draw(8), whole.pick(slice(0, 8)))
        assert stream._workers is not None
        for process in stream._workers._hosts._processes.values():
            os.kill(process.pid, signal.SIGKILL)
        with pytest.raises(JobError, match="was killed by SIGKILL"):
            for _ in range(4):
                place = stream.state()
                stream.draw(8)
        stream.restore(place)  # with new workers, from where it stopped
        begin = place["place"]
        assert same(
            stream.draw(8), StreamDataset(cached, (), seed=4).draw(64).pick(slice(begin, begin + 8))
        )


def test_bad_input_says_what_to_do(cached: Dataset, tmp_path: Path) -> None:
    for wrong, text in (
        ({"pictures": ("lidar",)}, "no picture 'lidar'"),
        ({"pictures": ("rgb", "rgb")}, "a picture twice"),
        ({"rank": 2, "ranks": 2}, "rank 2 of 2"),
        ({"buffer": 0}, "a buffer of 0"),
        ({"blackout": 1.5}, "blackout 1.5"),
    ):
        with pytest.raises(ConfigError, match=text):
            StreamDataset(cached, **{"pictures": (), **wrong})  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match="0 samples"):
        StreamDataset(cached, ()).draw(0)
    stream = StreamDataset(cached, (), seed=1)
    state = stream.state()
    with pytest.raises(ConfigError, match="seed was 1, now it is 2"):
        StreamDataset(cached, (), seed=2).restore(state)
    with pytest.raises(ConfigError, match="epoch 'x'"):
        stream.restore({**state, "epoch": "x"})

    folder = Path(shutil.copytree(cached.folder, tmp_path / "data"))
    assert StreamDataset(folder, (), seed=1).hash == stream.hash
    about = json.loads((folder / "dataset.json").read_text())
    about["parts"][0]["labels"] = "0" * 32
    changed = Path(shutil.copytree(cached.folder, tmp_path / "changed"))
    (changed / "dataset.json").write_text(json.dumps(about))
    with pytest.raises(FormatError, match="changed after it was written"):
        StreamDataset(changed, ())
    shard = next((folder / "pictures/webdataset").glob("*.tar"))
    data = bytearray(shard.read_bytes())
    index = load_index(shard.with_suffix(".index.parquet"))
    begin, size, _ = next(place for name, place in index.items() if ".rgb." in name)
    data[begin + size // 2] ^= 255
    shard.write_bytes(data)
    for workers in (0, 2):
        with (
            StreamDataset(folder, ("rgb", "history", "bev", "occupancy"), workers=workers) as it,
            pytest.raises(FormatError, match="member is damaged"),
        ):
            it.draw(total(cached))
    shard.unlink()
    with pytest.raises((FormatError, StorageError), match="cannot be read"):
        StreamDataset(folder, ("rgb",)).draw(total(cached))
    table = next((folder / "samples").glob("*.parquet"))
    table.write_bytes(next((cached.folder / "samples").glob("*1.parquet")).read_bytes())
    with pytest.raises(FormatError, match="not the sample table"):
        StreamDataset(folder, ()).draw(total(cached))
