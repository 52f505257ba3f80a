"""`gn0 policy examine`: the benchmark's walks on a device, kept, and gone on with."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("transformers")

from gn0.bench.results import load_results  # noqa: E402
from gn0.cli.main import main  # noqa: E402
from gn0.data.answer_form import AnswerForm  # noqa: E402
from gn0.errors import TrainingError  # noqa: E402
from gn0.missions.controls import CONTROL_TEXT  # noqa: E402
from gn0.policies.bae.policy_settings import PolicySettings  # noqa: E402
from gn0.policies.bae.tokenizer import train_tokenizer  # noqa: E402
from gn0.policies.cma.cma_checkpoint import (  # noqa: E402
    CmaCheckpoint,
    build_net,
    save_cma_checkpoint,
)
from gn0.policies.cma.cma_settings import SIZES, CmaSettings  # noqa: E402
from gn0.sim.ego_map import EgoSquare, MapView  # noqa: E402
from gn0.training.exams.policy_examination import WalkJob, examine_policy  # noqa: E402
from gn0.training.exams.walks import Walk  # noqa: E402
from gn0.training.exams.walks_folder import load_walks  # noqa: E402
from gn0.training.pupil import build_pupil  # noqa: E402

VIEW = MapView(squares=(EgoSquare(32, 0.24, content="occupancy"),))
SETTINGS = PolicySettings(
    prompt="short", pictures=("near",), form=AnswerForm(layout="compact"), view=VIEW
)


def _save(suite, folder: Path, seed: int) -> str:
    pupil = build_pupil("nano", SETTINGS, [e.instruction for e in suite.episodes], seed=seed)
    with torch.no_grad(), torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        for weight in pupil.model.parameters():
            weight.add_(0.1 * torch.randn_like(weight))
    pupil.save(folder)
    return str(folder)


@pytest.fixture(scope="module")
def policy(flats_suite, tmp_path_factory: pytest.TempPathFactory) -> str:
    if not shutil.which("g++"):
        pytest.skip("the host emulation needs g++")
    return _save(flats_suite, tmp_path_factory.mktemp("policy") / "one", 3)


@pytest.fixture(autouse=True)
def _cache(own_cache, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GN0_CACHE", str(own_cache))


def _examine(policy: str, suite, out: Path, *more: str) -> int:
    return main(
        ["policy", "examine", policy, str(suite.folder), "--split", "all", "--agents", "5",
         "--device", "host", "--out", str(out), *more]
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    "own, theirs",
    [
        ([], []),
        (["--executed", "1"], ["--policy-option", "executed=1"]),
        (["--control", "shuffled", "--confirm-stop"],
         ["--control", "shuffled", "--policy-option", "confirm_stop=true"]),
        (["--carried", "waypoints"], ["--policy-option", "carried=waypoints"]),
    ],
    ids=["plain", "one action", "shuffled, STOP confirmed", "along waypoints"],
)  # fmt: skip
def test_its_walks_are_those_of_the_benchmark(
    own, theirs, policy, flats_suite, tmp_path: Path, worker_here: None
) -> None:
    assert _examine(policy, flats_suite, tmp_path / "walks", *own) == 0
    assert main(
        ["bench", "run", str(flats_suite.folder), "--policy", "bae", "--policy-option",
         f"checkpoint={policy}", "--policy-option", "backend=torch", *theirs, "--no-report",
         "--out", str(tmp_path / "bench")]
    ) == 0  # fmt: skip
    for walk in _compare(tmp_path, flats_suite):
        carried = 1 if "--executed" in own else 3
        assert walk.decisions >= -(-walk.steps // carried)
        if "--confirm-stop" not in own:
            assert walk.decisions == -(-walk.steps // carried)


def _compare(folder: Path, suite) -> list[Walk]:
    """Walks of a folder, held against the results of the benchmark beside them."""
    about, walks = load_walks(folder / "walks")
    scored = {one.episode: one for one in load_results(folder / "bench")}
    assert [walk.episode for walk in walks] == [e.id for e in suite.episodes]
    assert about.finished and about.episodes == len(scored) == 12
    for walk in walks:
        metrics = scored[walk.episode].metrics
        assert metrics is not None
        assert (walk.steps, walk.stopped) == (metrics.steps, scored[walk.episode].stopped)
        assert (walk.success, walk.oracle) == (metrics.success, metrics.oracle_success)
        assert walk.success_straight == metrics.success_euclid
        assert walk.cut_short == metrics.collisions
        assert walk.spl == pytest.approx(metrics.spl, abs=1e-6)
        assert walk.length == pytest.approx(metrics.trajectory_length, abs=1e-6)
        assert walk.left == pytest.approx(metrics.navigation_error_geodesic, abs=1e-6)
        assert walk.left_straight == pytest.approx(metrics.navigation_error_euclid, abs=1e-6)
        share = metrics.shortest_length / max(metrics.shortest_length, metrics.trajectory_length)
        assert walk.spl_straight == pytest.approx(share * walk.success_straight, abs=1e-6)
        assert walk.spl_near == pytest.approx(share * walk.success_near, abs=1e-6)
    return walks


@pytest.fixture(scope="module")
def baseline(flats_suite, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recurrent baseline that does not know where to go, but goes; in the folder of its run."""
    texts = [episode.instruction for episode in flats_suite.episodes]
    tokenizer = train_tokenizer([*texts, CONTROL_TEXT], 40).backend_tokenizer
    settings = CmaSettings(
        pictures=("near",), sizes=SIZES["nano"], view=VIEW,
        vocabulary=tokenizer.get_vocab_size(with_added_tokens=True),
    )  # fmt: skip
    net = build_net(settings, 3)
    with torch.no_grad():
        net.choose.weight.mul_(200)  # unlike actions in unlike places
        net.choose.bias[0] = -2.0
    run = tmp_path_factory.mktemp("baseline")
    save_cma_checkpoint(run / "policy", CmaCheckpoint(net, tokenizer.to_str().encode()))
    return run


@pytest.mark.slow
@pytest.mark.parametrize("control", ["none", "shuffled", "no_pictures"])
def test_a_recurrent_baseline_walks_as_in_the_benchmark(
    control, baseline: Path, flats_suite, tmp_path: Path, worker_here: None
) -> None:
    with_control = ["--control", control] if control != "none" else []
    assert _examine(str(baseline), flats_suite, tmp_path / "walks", *with_control) == 0
    assert main(
        ["bench", "run", str(flats_suite.folder), "--policy", "cma", "--policy-option",
         f"checkpoint={baseline / 'policy'}", *with_control, "--no-report",
         "--out", str(tmp_path / "bench")]
    ) == 0  # fmt: skip
    walks = _compare(tmp_path, flats_suite)
    assert all(walk.decisions == walk.steps for walk in walks)
    if control != "no_pictures":  # in the dark it does the same everywhere
        assert len({walk.length for walk in walks}) > 2


def test_a_recurrent_baseline_says_one_action(baseline: Path, flats_suite, tmp_path: Path, capsys):
    for odd in (["--executed", "3"], ["--inputs", "maps"], ["--draw-after", "6"],
                ["--confirm-stop"], ["--carried", "waypoints"]):  # fmt: skip
        assert _examine(str(baseline), flats_suite, tmp_path / "walks", *odd) == 2
        said = capsys.readouterr().err
        assert "one action" in said and odd[0][2:].replace("-", "_") in said
    assert not (tmp_path / "walks").exists()


def test_an_examination_goes_on_and_is_of_one_policy(
    policy, flats_suite, tmp_path: Path, capsys
) -> None:
    job = WalkJob(checkpoint=policy, suite=str(flats_suite.folder), splits=(), agents=2, episodes=4)

    def stop(stage: str, done: int, total: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        examine_policy(job, tmp_path / "parts", device="host", progress=stop)
    with pytest.raises(TrainingError, match="not finished"):
        load_walks(tmp_path / "parts")
    told: list[int] = []
    parts = examine_policy(
        job, tmp_path / "parts", device="host", progress=lambda _, done, __: told.append(done)
    )
    assert told == sorted(told) and (told[0], told[-1]) == (3, 4)  # three were there
    whole = examine_policy(job, tmp_path / "whole", device="host")
    assert [replace(w, seconds=0.0) for w in parts] == [replace(w, seconds=0.0) for w in whole]
    assert load_walks(tmp_path / "parts")[1] == parts
    assert not (tmp_path / "parts" / "walks.journal").exists()
    again: list[str] = []
    assert examine_policy(job, tmp_path / "parts", device="host", say=again.append) == parts
    assert again == ["walked before: 4 episodes"]

    other = _save(flats_suite, tmp_path / "other", 4)
    few = ["--agents", "2", "--episodes", "4"]
    assert _examine(other, flats_suite, tmp_path / "parts", *few) == 2
    said = capsys.readouterr().err
    assert "holds other walks" in said and "weights was" in said and "--fresh" in said
    assert _examine(policy, flats_suite, tmp_path / "parts", *few, "--control", "no_words") == 2
    assert "control was none, is no_words" in capsys.readouterr().err


def test_walks_that_were_changed_are_refused(policy, flats_suite, tmp_path: Path, capsys) -> None:
    out = tmp_path / "walks"
    few = ["--agents", "2", "--episodes", "2"]
    assert _examine(policy, flats_suite, out, *few) == 0
    told = capsys.readouterr().out
    assert "SR %" in told and "goal" in told and "walks.jsonl" in told
    lines = (out / "walks.jsonl").read_text().splitlines()
    first = json.loads(lines[0])
    first["success"] = not first["success"]
    (out / "walks.jsonl").write_text("\n".join([json.dumps(first), *lines[1:]]) + "\n")
    with pytest.raises(TrainingError, match="not what the examination wrote"):
        load_walks(out)
    assert _examine(policy, flats_suite, out, *few) == 2
    assert _examine(policy, flats_suite, out, *few, "--fresh") == 0
    assert len(load_walks(out)[1]) == 2


def test_what_cannot_be_examined_is_told(policy, flats_suite, tmp_path: Path, capsys) -> None:
    out = tmp_path / "walks"
    assert _examine(policy, flats_suite, out, "--executed", "7") == 2
    assert "7 actions of an answer" in capsys.readouterr().err
    assert _examine(policy, flats_suite, out, "--inputs", "smell") == 2
    assert "no input 'smell'" in capsys.readouterr().err
    assert _examine(policy, flats_suite, out, "--split", "nowhere") == 2
    assert "no split 'nowhere'" in capsys.readouterr().err
    assert not out.exists()
    assert _examine(str(tmp_path), flats_suite, out) == 2
    assert "CHECKPOINT" in capsys.readouterr().err
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    assert _examine(policy, flats_suite, out) == 2
    assert "something else" in capsys.readouterr().err
    assert (out / "notes.txt").read_text() == "mine"
