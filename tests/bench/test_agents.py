"""Episodes side by side in a worker: the bytes of one at a time, whatever goes wrong in company."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest

from gn0.bench import runner
from gn0.bench.episode_worker import WorkerObedient
from gn0.bench.results import iterate_results
from gn0.bench.run_settings import build_settings
from gn0.bench.runner import run_suite
from gn0.bench.worker_messages import Done, Lease
from gn0.errors import BenchError
from gn0.maps.distance import GeodesicField, GeodesicMap
from gn0.suites.suite import Suite

SAME = ("results.jsonl", "trajectories.jsonl", "summary.json")
PLUGIN = Path(__file__).parent / "plugin"


def outputs(folder: Path) -> dict[str, bytes]:
    return {name: (folder / name).read_bytes() for name in SAME}


@pytest.fixture(scope="module", autouse=True)
def still_code() -> Iterator[None]:
    """Pretend that nobody edits the package while these tests stop and resume runs."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "code_version", lambda: "1.0+still")
        yield


@pytest.fixture(autouse=True)
def own_policies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(PLUGIN))


def run(suite: Suite, out: Path, policy: str, agents: int, **more: object) -> Path:
    modules = {"odd": ("odd_policies",), "crowd": ("crowd_policies",)}.get(policy, ())
    options = {k: more.pop(k) for k in ("odd", "when", "counts") if k in more}
    run_suite(
        suite, policy, out, agents=agents, plugin_modules=modules, policy_options=options, **more,  # type: ignore[arg-type]
    )  # fmt: skip
    return out


@pytest.mark.parametrize("policy", ["odd", "wall_follower", "explorer", "crowd"])
def test_any_number_of_agents_gives_the_bytes_of_one(
    flats_suite: Suite, tmp_path: Path, policy: str, worker_here: None
) -> None:
    few = {"max_episodes": 5 if policy == "explorer" else 9}
    alone = outputs(run(flats_suite, tmp_path / "1", policy, 1, **few))
    for agents in (3,) if policy == "explorer" else (3, 8):
        assert outputs(run(flats_suite, tmp_path / str(agents), policy, agents, **few)) == alone
    about = json.loads((tmp_path / "3" / "run.json").read_text())
    assert about["sessions"][0]["agents"] == 3 and about["settings"]["agents"] == 3
    assert all(e["seconds"] > 0 for e in about["episodes"].values())


def test_a_policy_of_many_agents_is_asked_once_a_step(
    flats_suite: Suite, tmp_path: Path, worker_here: None
) -> None:
    run(flats_suite, tmp_path / "run", "crowd", 4, counts=str(tmp_path), max_episodes=8)
    asked = [int(n) for path in tmp_path.glob("asked-*") for n in path.read_text().split()]
    assert max(asked) == 4
    steps = sum(r.metrics.steps for r in iterate_results(tmp_path / "run") if r.metrics)
    assert sum(asked) == steps and len(asked) < steps / 2


@pytest.mark.parametrize(
    ("odd", "when"), [("raise", "sofa"), ("exit", "wardrobe"), ("nan", "sofa")]
)
def test_who_fails_in_company_fails_alone_and_takes_nobody_along(
    flats_suite: Suite,
    tmp_path: Path,
    odd: str,
    when: str,
    request: pytest.FixtureRequest,
) -> None:
    """A teleport is nothing for many agents at once: alone it is a move like any other."""
    if odd != "exit":  # a process is ended by it
        request.getfixturevalue("worker_here")
    alone = run(flats_suite, tmp_path / "1", "odd", 1, odd=odd, when=when)
    beside = run(flats_suite, tmp_path / "5", "odd", 5, odd=odd, when=when)
    assert outputs(beside) == outputs(alone)
    assert ('"type": "parted"' in (beside / "journal.jsonl").read_text()) == (odd != "exit")


def test_a_run_of_one_number_of_agents_is_gone_on_with_by_another(
    flats_suite: Suite, tmp_path: Path, worker_here: None
) -> None:
    whole = outputs(run(flats_suite, tmp_path / "whole", "odd", 1))
    cut = tmp_path / "cut"

    class CutError(Exception):
        pass

    def stop(stage: str, done: int, total: int) -> None:
        if stage == "episodes" and done == 4:
            raise CutError

    with pytest.raises(CutError):
        run(flats_suite, cut, "odd", 5, progress=stop)
    assert not (cut / "summary.json").exists()
    assert outputs(run(flats_suite, cut, "odd", 3)) == whole


def test_an_episode_that_cannot_begin_is_invalid_as_ever(
    flats_suite: Suite, tmp_path: Path, worker_here: None
) -> None:
    lost = msgspec.structs.replace(flats_suite.episodes[2], start=(-90.0, 0.0, 0.0))
    episodes = (*flats_suite.episodes[:2], lost, *flats_suite.episodes[3:6])
    suite = replace(flats_suite, episodes=episodes)
    alone = outputs(run(suite, tmp_path / "1", "odd", 1))
    assert outputs(run(suite, tmp_path / "4", "odd", 4)) == alone
    assert b'"status":"invalid"' in alone["results.jsonl"]


def test_an_oracle_runs_one_at_a_time_and_it_is_said(
    flats_suite: Suite, tmp_path: Path, worker_here: None
) -> None:
    told: list[str] = []
    few = {"max_episodes": 3}
    alone = outputs(run(flats_suite, tmp_path / "1", "oracle", 1, **few))
    beside = outputs(run(flats_suite, tmp_path / "4", "oracle", 4, tell=told.append, **few))
    assert alone == beside
    assert any("run one at a time" in line for line in told)


def test_who_is_run_alone_in_another_scene_leaves_the_group_its_ground(
    flats_suite: Suite, tmp_path: Path, worker_here: None
) -> None:
    """Walks that go on in the scene of before are scored on its map, not on the last one opened."""
    run(flats_suite, tmp_path / "alone", "wall_follower", 1)
    want = {result.episode: result for result in iterate_results(tmp_path / "alone")}
    said: list[Any] = []
    worker = WorkerObedient(said.append)
    settings = build_settings(flats_suite, "wall_follower", {})
    worker.obey(msgspec.structs.replace(settings, agents=2))
    here = [e for e in flats_suite.episodes if e.scene_id == flats_suite.episodes[0].scene_id]
    there = next(e for e in flats_suite.episodes if e.scene_id != here[0].scene_id)
    for episode, alone in ((here[0], False), (there, True), (here[1], False)):
        name = episode.scene_id
        folder, digest = flats_suite.scene_folder(name), flats_suite.scene_hash(name)
        worker.obey(Lease(episode=episode, folder=str(folder), hash=digest, alone=alone))
        while worker.is_busy:
            assert worker.step()
    found = [message.result for message in said if isinstance(message, Done)]
    assert found == [want[e.id] for e in (here[0], there, here[1])]


def test_no_agents_are_refused(flats_suite: Suite, tmp_path: Path) -> None:
    for agents in (0, -1, 5000):
        with pytest.raises(BenchError, match="agents"):
            run(flats_suite, tmp_path / "run", "odd", agents)
    assert not (tmp_path / "run").exists()


def test_a_field_is_built_once_for_a_walk_and_its_score(
    flats_suite: Suite, tmp_path: Path, worker_here: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Agents side by side, and who scores them, ask one map for the distance to a goal."""
    built: list[object] = []
    build = GeodesicMap.build_field

    def note(self: GeodesicMap, goal: Any) -> GeodesicField:
        built.append(goal)
        return build(self, goal)

    monkeypatch.setattr(GeodesicMap, "build_field", note)
    run(flats_suite, tmp_path / "run", "odd", 3, max_episodes=9)
    there = {(e.scene_id, e.destination) for e in flats_suite.episodes[:9]}
    assert len(built) == len(there)
