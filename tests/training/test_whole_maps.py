"""Whole maps, as in the paper: the same pictures and tokens live, of a dataset and in acting."""

from __future__ import annotations

import shutil
from pathlib import Path

import msgspec
import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("transformers")

from gn0.bench.results import load_results  # noqa: E402
from gn0.bench.runner import run_suite  # noqa: E402
from gn0.data.answer_form import AnswerForm  # noqa: E402
from gn0.data.build import build_dataset  # noqa: E402
from gn0.data.codec import encode_waypoints, parse_answer  # noqa: E402
from gn0.data.settings import BuildSettings, LabelSettings, PictureSettings  # noqa: E402
from gn0.device.host import DeviceHost  # noqa: E402
from gn0.errors import ConfigError, PolicyError  # noqa: E402
from gn0.geometry import Pose2D  # noqa: E402
from gn0.policies.bae.engines import open_engine  # noqa: E402
from gn0.policies.bae.policy_settings import PolicySettings, load_policy_settings  # noqa: E402
from gn0.policies.bae.questions import Questions  # noqa: E402
from gn0.sim.device_env import VectorEnvDevice  # noqa: E402
from gn0.sim.ego_map import EgoSquare, MapView  # noqa: E402
from gn0.sim.state import Observation  # noqa: E402
from gn0.training.exams.evaluation import ClosedLoop  # noqa: E402
from gn0.training.inputs import fit_prompt, read_inputs  # noqa: E402
from gn0.training.pupil import Pupil, build_pupil, load_pupil  # noqa: E402
from gn0.training.streams.step_ring import StepRing  # noqa: E402
from gn0.training.streams.stream_dataset import StreamDataset  # noqa: E402
from gn0.training.streams.stream_live import StreamLive  # noqa: E402
from gn0.training.streams.stream_uniform import StreamUniform  # noqa: E402
from gn0.training.worlds import list_squares, list_whole  # noqa: E402

torch.set_num_threads(1)
VIEW = MapView((EgoSquare(20, 0.2, content="occupancy"),))
BASE = PolicySettings(
    prompt="short", pictures=("occupancy",), form=AnswerForm(layout="compact"), view=VIEW,
    map_size=(48, 32), coordinates="map",
)  # fmt: skip
needs_device = pytest.mark.skipif(not shutil.which("g++"), reason="the emulation needs g++")


def shake(pupil: Pupil) -> Pupil:
    """The same with weights of some size, as if trained."""
    with torch.no_grad(), torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        for weight in pupil.model.parameters():
            weight.add_(0.1 * torch.randn_like(weight))
    return pupil


def open_device(suite, count: int) -> VectorEnvDevice:
    return VectorEnvDevice(count, suite=suite.folder, device=DeviceHost(2), map_view=VIEW,
                           sensors=("ego_map",))  # fmt: skip


def test_the_papers_prompts_bring_their_pictures_and_coordinates() -> None:
    plain = msgspec.structs.replace(BASE, coordinates="square")
    maps = fit_prompt(msgspec.structs.replace(plain, prompt="paper_planning_maps"))
    assert (maps.pictures, maps.coordinates) == (("bev", "occupancy"), "map")
    assert (maps.form.layout, maps.form.points, maps.frame) == ("json", 13, None)
    assert maps.sensors(maps.load_template()) == ("bev", "occupancy", "pose")
    assert not maps.view.arrow
    ours = fit_prompt(msgspec.structs.replace(plain, prompt="planning_maps"))
    assert ours.view.arrow
    with pytest.raises(ConfigError, match="speaks of the agent as an arrow"):
        msgspec.structs.replace(ours, view=VIEW).load_template()
    with pytest.raises(ConfigError, match="does not say where on the map"):
        msgspec.structs.replace(
            BASE, form=AnswerForm(layout="json"), without=("current_pixel",)
        ).load_template()
    assert fit_prompt(plain).coordinates == "map"  # it shows no square
    both = msgspec.structs.replace(plain, pictures=("near", "occupancy"))
    assert fit_prompt(both).coordinates == "square"
    mixed, _ = read_inputs("paper_planning_maps,paper_planning_views", plain)
    assert [own.coordinates for own in mixed.by_input.values()] == ["map", "square"]


@needs_device
def test_live_maps_and_tokens_are_a_datasets_of_the_same_states(
    flats_suite, own_cache, monkeypatch, tmp_path: Path
) -> None:
    monkeypatch.setenv("GN0_CACHE", str(own_cache))
    labels = LabelSettings(variant="field")
    dataset = build_dataset(
        flats_suite, tmp_path / "data",
        BuildSettings(labels=labels, pictures=PictureSettings(layout="none")),
    )  # fmt: skip
    kept = StreamDataset(dataset, ("occupancy",), map_view=VIEW, map_size=BASE.map_size)
    env = open_device(flats_suite, 12)
    ring = StepRing(env, 30, names=list_squares(BASE), whole=list_whole(BASE),
                    map_size=BASE.map_size)  # fmt: skip
    live = StreamLive(env, ring, seed=0, fill=1, stop_distance=labels.stop_distance)
    assert live.frames == kept.frames
    env.reset(options={"episode": list(range(12))})
    for _ in range(20):
        live.step()
    walked = ring.draw(np.arange(*ring.window))
    assert set(walked.pictures) == {"occupancy"}
    stored = kept.draw(sum(part.rows for part in dataset.about.parts))
    numbers = {episode.id: k for k, episode in enumerate(env.episodes)}
    at = {(n, p.tobytes()): k for k, (n, p) in enumerate(
        zip(walked.episode.tolist(), walked.pose.numpy(), strict=True))}  # fmt: skip
    pairs = []
    for k, (number, pose) in enumerate(zip(stored.episode.tolist(), stored.pose, strict=True)):
        key = numbers[dataset.sampled[number]], pose.numpy().tobytes()
        if key in at:
            pairs.append((at[key], k))
    assert len(pairs) > 100
    ours, theirs = (torch.tensor(one) for one in zip(*pairs, strict=True))
    one, other = walked.pick(ours), stored.pick(theirs)
    assert torch.equal(one.pictures["occupancy"], other.pictures["occupancy"])
    pupil = build_pupil("nano", BASE, live.texts)
    mine = pupil.maker_of(live, "cpu").make(one)
    known = pupil.maker_of(kept, "cpu").make(other)
    assert torch.equal(mine.answer, known.answer)
    settled = (one.last == other.last) & (one.collided == other.collided)
    assert settled.float().mean() > 0.9  # a pose that is stood at twice has another past
    assert torch.equal(mine.ids[settled], known.ids[settled])
    frames = [live.frames[n] for n in one.episode.tolist()]
    tokens = np.concatenate([
        encode_waypoints(frame, way[None], pose[None])
        for frame, way, pose in zip(frames, one.waypoints.numpy(), one.pose.numpy(), strict=True)
    ])  # fmt: skip
    said = mine.answer[:, torch.from_numpy(np.flatnonzero(pupil.slots.kinds == 1))]
    assert np.array_equal(said.numpy() - pupil.slots.vocabulary.number, tokens[:, 1:, 0])
    uniform = StreamUniform(env, seed=1, names=[], whole=["occupancy"], map_size=BASE.map_size)
    states = uniform.draw(12)
    assert set(states.pictures) == {"occupancy"} and uniform.frames == live.frames
    red, green, _ = states.pictures["occupancy"].int().flatten(1, 2).unbind(-1)
    for marked in (green - red, red - green):  # the discs of start and agent
        assert ((marked > 60).any(1)).float().mean() > 0.8
    with pytest.raises(ConfigError, match="0 maps of 12 episodes"):
        pupil.maker(live.texts, "cpu")


@pytest.fixture(scope="module")
def walker(flats_suite, tmp_path_factory: pytest.TempPathFactory) -> tuple[Pupil, Path]:
    """A policy of random weights whose coordinates are on the whole map, and its checkpoint."""
    texts = [episode.instruction for episode in flats_suite.episodes]
    folder = tmp_path_factory.mktemp("walker") / "checkpoint"
    shake(build_pupil("nano", BASE, texts, seed=3)).save(folder)
    return load_pupil(folder), folder


@needs_device
@pytest.mark.slow
def test_the_closed_loop_plays_what_the_benchmark_plays(
    walker, flats_suite, tmp_path: Path, worker_here: None
) -> None:
    pupil, folder = walker
    options = {"checkpoint": str(folder), "backend": "torch"}
    run_suite(flats_suite, "bae", tmp_path / "run", policy_options=options)
    theirs = {one.episode: one.metrics for one in load_results(tmp_path / "run")}
    loop = ClosedLoop(open_device(flats_suite, 4), pupil)
    walks = loop.play()
    assert len({walk.steps for walk in walks}) > 1
    for walk in walks:
        metrics = theirs[walk.episode]
        assert metrics is not None
        assert (walk.steps, walk.success) == (metrics.steps, metrics.success)
        assert walk.length == pytest.approx(metrics.trajectory_length, abs=1e-6)
    for control in ("no_words", "shuffled", "no_pictures"):
        assert len(loop.play([0, 1], control=control)) == 2


def test_numpy_and_torch_begin_an_answer_where_the_agent_stands(tmp_path: Path) -> None:
    """The paper's own prompt, in JSON, whose first point is the one that the prompt says."""
    settings = fit_prompt(msgspec.structs.replace(
        BASE, prompt="paper_planning_maps", coordinates="square", map_size=(16, 16)))  # fmt: skip
    folder = tmp_path / "policy"
    shake(build_pupil("nano", settings, ["go to the sofa"])).save(folder)
    assert load_policy_settings(folder).coordinates == "map"
    questions = Questions(folder)
    pictures = np.random.default_rng(0).integers(0, 256, (2, 70, 90, 3), np.uint8)
    seen = Observation(
        0, 0.0, "", bev=pictures[0], occupancy=pictures[1], bev_metres_per_pixel=0.05,
        map_origin=(-1.0, 2.0), pose=Pose2D(0.6, 3.4, 0.3),
    )  # fmt: skip
    frame = questions.find_frame(seen)
    assert (frame.width, frame.height) == (90, 70)
    ids = questions.fill("go to the sofa", -1, False, None, seen.pose, frame)[None]
    asked = questions.tokenizer.decode(ids[0].tolist())  # type: ignore[attr-defined]
    place = "(<350>,<593>)"  # x 1.6 m of 4.5, y 2.1 m from the top of 3.5, half a pixel less
    assert f"CURRENT_PIXEL (normalized): {place}" in asked and "W=90 px, H=70 px" in asked
    shown = [one[None].copy() for one in questions.show(seen)]
    said = [
        open_engine(questions, backend, "cpu", "float32", 1).answer(shown, ids)
        for backend in ("numpy", "torch")
    ]
    assert np.array_equal(*said)
    text = questions.tokenizer.decode(said[0][0].tolist())  # type: ignore[attr-defined]
    answer = parse_answer(text.removesuffix("<|im_end|>"))
    assert answer.tokens is not None and answer.tokens[0] == (350, 593)
    with pytest.raises(PolicyError, match="the agent has none"):
        questions.find_frame(Observation(0, 0.0, ""))
