"""People on the live pages: they move while the agent acts, and stand where a run had them."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
import pytest

from gn0.avatars.bank import digest_avatar
from gn0.avatars.detail import build_levels
from gn0.bench.replay import replay_run
from gn0.bench.runner import run_suite
from gn0.bench.walk_recording import open_recorder
from gn0.cli import view
from gn0.errors import ConfigError
from gn0.people.cast import Actor, Cast
from gn0.people.walk import walk_alone
from gn0.suites.suite import Suite
from gn0.viewer.live import WAIT, SceneView
from gn0.viewer.live_loop import LiveLoop
from gn0.viewer.live_map import FOLLOWED, PERSON, MapPerson, plan_map
from gn0.viewer.live_people import frame_person, mark_people, wear_colours
from gn0.viewer.live_record import RecordView
from gn0.viewer.live_server import open_server
from gn0.viewer.recorded_runs import load_replay
from gn0.viewer.replay_live import ReplayView
from gn0_trials.follow_suite_small import STANDER, WALKER, follow_episode, goal_episode, save_small
from gn0_trials.people_small import small_person

pytestmark = pytest.mark.usefixtures("workers_here", "one_actor")
pytest.importorskip("viser")
STEP = 0.2  # s, of the follower
SHORT = msgspec.structs.replace(WALKER, path=((2.7, 2.25), (4.4, 2.25)))
ASIDE = msgspec.structs.replace(STANDER, path=((5.2, 3.3),))


@pytest.fixture(scope="module")
def actor() -> Actor:
    person = small_person(0, 0.05)
    return Actor("small", digest_avatar(person), build_levels(person))


@pytest.fixture(scope="module")
def one_actor(actor: Actor) -> Iterator[None]:
    """Everybody is played by one small person: nobody has to be built."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Cast, "find", lambda self, identity: actor)
        yield


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Suite:
    following = msgspec.structs.replace(follow_episode(), people=(SHORT, ASIDE))
    episodes = (following, goal_episode(SHORT))
    return save_small(tmp_path_factory.mktemp("people") / "suite", *episodes)


@pytest.fixture(scope="module")
def run(
    suite: Suite, workers_here: None, one_actor: None, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    folder = tmp_path_factory.mktemp("run") / "run"
    run_suite(suite, "oracle", folder)
    return folder


def test_a_replay_shows_people_where_they_were_and_whom_to_follow(run: Path) -> None:
    assert replay_run(run).ok
    with open_server(port=0) as live:
        page = ReplayView(
            live, LiveLoop(), replay=load_replay([run]), splats=2000, first="a-follow"
        )
        page.open()
        page.finish()
        assert "2 people are there; whom to follow is green" in page._crowd.content
        assert "Not as recorded" not in page._crowd.content
        assert "TR mean" in page._scores.content and "SPL" not in page._scores.content
        alone = walk_alone(SHORT, 20.0)  # nobody is in its way
        pictures = []
        for step in (0, 4, 8):
            page._seek(step)
            page._draw()
            pictures.append(np.array(page._map.image))
            walker, stander = page._mark_people()
            place = alone.place[round(step * STEP / 0.1)]
            assert (walker.pose.x, walker.pose.y) == pytest.approx(tuple(place), abs=1e-9)
            assert walker.followed and not stander.followed
            assert len(np.asarray(stander.trail)) == 1  # it never moved
        length = np.hypot(*np.diff(np.asarray(walker.trail), axis=0).T).sum()
        assert length == pytest.approx(alone.walked[16], abs=1e-6)
        green = [(np.abs(p.astype(int) - FOLLOWED).max(axis=2) < 12).sum() for p in pictures]
        assert green[0] and green[2] > green[0]  # the track grew
        page._turn_to(page.replay.find("b-goal"))
        page._draw()
        assert (
            page._crowd.content.startswith("One person is there") and "SPL" in page._scores.content
        )
        assert not page._mark_people()[0].followed


def test_a_run_of_other_people_is_told(run: Path, tmp_path: Path) -> None:
    run = Path(shutil.copytree(run, tmp_path / "run"))
    lines = (run / "trajectories.jsonl").read_bytes().splitlines(keepends=True)
    other = msgspec.json.decode(lines[1])
    other["people"] = "0" * 32
    (run / "trajectories.jsonl").write_bytes(lines[0] + msgspec.json.encode(other) + b"\n")
    with open_server(port=0) as live:
        page = ReplayView(live, LiveLoop(), replay=load_replay([run]), splats=2000, first="b-goal")
        page.open()
        page.finish()
        assert "**Not as recorded** in oracle" in page._crowd.content


def test_people_move_while_the_agent_acts_and_go_on_wherever_it_is_put(suite: Suite) -> None:
    build = view.find_view(view.Args(paths=(str(suite.folder),), episode="a-follow"))
    with open_server(port=0) as live:
        page = build(live, LiveLoop())
        assert isinstance(page, SceneView)
        page.open()
        page.finish()
        assert page.ready and page.walk is not None
        walk = page.walk
        assert (walk.pose.x, walk.pose.y) == (1.2, 2.25)
        first = walk.picture("RGB")
        page._draw()
        still = np.array(page._plan_image.image)
        page._draw()  # time stands still while nobody acts
        assert np.array_equal(page._plan_image.image, still)
        for _ in range(5):
            page._move(WAIT)
        alone = walk_alone(SHORT, 10.0).place
        walker, _ = walk.marks
        assert (walker.pose.x, walker.pose.y) == pytest.approx(tuple(alone[10]), abs=1e-9)
        assert walker.followed and "step 5: wait" in page._status.content
        assert walk.pose.x == 1.2 and not np.array_equal(walk.picture("RGB"), first)
        framed = walk.picture("RGB")
        assert (framed == FOLLOWED).all(axis=2).any()
        page._draw()
        assert not np.array_equal(page._plan_image.image, still)
        assert walk.place(1.4, 2.4, 0.0)  # they do not begin again
        assert (walk.marks[0].pose.x, walk.marks[0].pose.y) == (walker.pose.x, walker.pose.y)
        assert not walk.place(5.2, 3.1, 0.0) and walk.last.word == "somebody stands there"
        assert walk.pose.x == 1.4
        assert page.tick(10.0) is None
        page._toggle()
        rest = page.tick(20.0)
        assert rest is not None and 0 < rest <= STEP and page.walk.simulator.steps == 1
        page.tick(20.0 + 0.9 * rest)
        assert page.walk.simulator.steps == 1
        page.tick(20.0 + 1.1 * rest)
        assert page.walk.simulator.steps == 2


def test_a_walk_by_hand_of_following_ends_by_its_rules(suite: Suite, tmp_path: Path) -> None:
    with open_server(port=0) as live, open_recorder(suite, tmp_path / "run") as recorder:
        page = RecordView(live, LiveLoop(), recorder=recorder, first="a-follow")
        page.open()
        page.finish()
        page.stop()
        assert page.walking  # STOP is to wait
        while page.walking:
            page.move("forward")
        score = page._status.content
        assert "touched somebody" in score and "followed" in score
        assert page._list.value[0] in "✓✗"
        assert page._simulator is not None
        assert page._simulator.show_people(page._simulator.pose, 100.0) is not None
    assert replay_run(tmp_path / "run").ok


def test_suites_and_scenes_are_walked_with_people(suite: Suite, tmp_path: Path) -> None:
    scene = str(next((suite.folder / "scenes").iterdir()))
    build = view.find_view(view.Args(paths=(scene,), people=2, people_seed=3))
    assert len(build.args[4].people) == 2
    with pytest.raises(ConfigError, match="people are put into a scene"):
        view.find_view(view.Args(paths=(str(suite.folder),), people=2))
    with pytest.raises(ConfigError, match="none are asked for"):
        view.find_view(view.Args(paths=(scene,), people_seed=3))
    with pytest.raises(ConfigError, match="of the people of a suite's episode"):
        view.find_view(view.Args(paths=(scene,), bank="bank"))
    with pytest.raises(ConfigError, match="no episode 'a-folow'") as caught:
        view.find_view(view.Args(paths=(str(suite.folder),), episode="a-folow"))
    assert "'a-follow'" in caught.value.remedy


def test_marks_of_people_say_where_they_are_where_they_look_and_where_they_were(suite) -> None:
    path = [np.array([[1.0, 2.0], [4.0, 1.0]])] * 2 + [np.array([[1.0, 2.5], [4.0, 1.0]])]
    first, second = mark_people(path, np.array([[0.0, 1.0], [-1.0, 0.0]]), 1)
    assert (first.pose.x, first.pose.y, first.pose.yaw) == (1.0, 2.5, pytest.approx(np.pi / 2))
    assert np.array_equal(first.trail, [[1.0, 2.0], [1.0, 2.5]]) and len(second.trail) == 1
    assert (first.colour, second.colour) == (PERSON, FOLLOWED)
    from gn0.suites.suite import load_suite_scene

    name = "example-flat"
    scene = load_suite_scene(suite.scene_folder(name), name, suite.scene_hash(name))
    plan = plan_map(scene)
    drawn = plan.draw([], people=[first, second])
    for mark in (first, second):
        ((u, v),) = plan.pixels([(mark.pose.x, mark.pose.y)]).astype(int)
        assert tuple(drawn[v, u]) == mark.colour
    other = plan.draw([], people=[MapPerson(mark.pose) for mark in (first, second)])
    assert not np.array_equal(other, drawn)


def test_a_frame_stays_in_the_picture_and_nobody_has_none() -> None:
    picture = np.zeros((20, 30, 3), np.uint8)
    frame_person(picture, None)
    assert not picture.any()
    frame_person(picture, (-4, 5, 40, 30))
    assert (picture[2] == FOLLOWED).all() and not picture[8, 10].any()
    assert picture[:, 0].any()


def test_figures_wear_what_the_record_says() -> None:
    from gn0.avatars.identity import draw_identity

    seen = set()
    for number in range(6):
        top, bottom, skin = wear_colours(f"drawn:0:{number}")
        who = draw_identity(0, number)
        if who.top_colour == who.bottom_colour:
            assert top == bottom
        if who.top_colour == "black":
            assert max(top) < 60
        seen.add((top, bottom, skin))
    assert len(seen) > 3
    assert wear_colours("p0001")[0] == (140, 140, 146)  # of a bank that is not at hand
