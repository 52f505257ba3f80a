"""The overlay shows what it says: paths over the map, red where they leave the floor."""

from __future__ import annotations

import msgspec
import numpy as np
import pytest
from PIL import Image

from gn0.maps.navigation import NavigationMap
from gn0.missions.episode import Episode, MissionFollow
from gn0.missions.goal import sample_goal_episodes
from gn0.people.person import EpisodePerson
from gn0.render.open import build_renderer
from gn0.render.renderer import Renderer
from gn0.scenes.example import build_example_scene
from gn0.scenes.scene import Scene
from gn0.viewer.overlay import BLOCKED_PATH, GOAL, OTHERS, PATH, START, render_overlay, render_paths


@pytest.fixture(scope="module")
def room() -> Scene:
    return build_example_scene()


@pytest.fixture(scope="module")
def renderer(room: Scene) -> Renderer:
    return build_renderer(room.gaussians, "cpu")


@pytest.fixture(scope="module")
def episode(room: Scene) -> Episode:
    return sample_goal_episodes(room, NavigationMap(room.grid), 1, 0, minimum_length=2.0)[0]


def amount(picture: Image.Image, colour: tuple[int, int, int]) -> int:
    near = np.abs(np.asarray(picture, np.int64) - colour).max(axis=2) < 12
    return int(near.sum())


def news(picture: Image.Image, before: Image.Image, colour: tuple[int, int, int]) -> int:
    """How many pixels have that colour now and had another before; not those of the legend."""
    now, then = (np.asarray(p, np.int64)[:400] for p in (picture, before))
    near = np.abs(now - colour).max(axis=2) < 40
    return int((near & (np.abs(then - colour).max(axis=2) >= 40)).sum())


def test_a_good_path_is_blue_from_start_to_goal(
    room: Scene, renderer: Renderer, episode: Episode
) -> None:
    picture = render_overlay(room, [episode], renderer, width=700)
    assert amount(picture, PATH) > 200 and amount(picture, BLOCKED_PATH) == 0
    assert amount(picture, START) > 80 and amount(picture, GOAL) > 40


def test_the_goals_star_stands_on_two_tips(
    room: Scene, renderer: Renderer, episode: Episode
) -> None:
    still = msgspec.structs.replace(episode, path=())
    picture = np.asarray(render_overlay(room, [still], renderer, width=1400), np.int64)
    rows, cols = np.nonzero(np.abs(picture - GOAL).max(axis=2) < 12)
    near = np.abs(cols - np.median(cols)) < 60  # the legend has one, too
    rows, cols = rows[near], cols[near]
    near = np.abs(rows - np.median(rows)) < 60
    rows, cols = rows[near], cols[near]
    low, high = cols[rows >= rows.max() - 2], cols[rows <= rows.min() + 2]
    assert np.ptp(low) > 2 * np.ptp(high)


def test_what_leaves_the_floor_is_red(room: Scene, renderer: Renderer, episode: Episode) -> None:
    x0, y0, x1, _ = room.grid.bounds
    through = msgspec.structs.replace(episode, path=((x0 - 0.2, y0 + 1.0), (x1 + 0.2, y0 + 1.0)))
    picture = render_overlay(room, [through], renderer, width=700)
    assert amount(picture, BLOCKED_PATH) > 50


def test_the_same_episode_is_the_same_picture_and_rooms_can_be_left_out(
    room: Scene, renderer: Renderer, episode: Episode
) -> None:
    first = render_overlay(room, [episode], renderer, width=600)
    again = render_overlay(room, [episode], renderer, width=600)
    bare = render_overlay(room, [episode], renderer, width=600, rooms=False)
    assert first.tobytes() == again.tobytes()
    assert (first.tobytes() != bare.tobytes()) == bool(room.rooms)


def test_captions_grow_the_picture_whatever_they_hold(
    room: Scene, renderer: Renderer, episode: Episode
) -> None:
    text = msgspec.structs.replace(episode.mission, instruction="走到 „sofa“ \x00 " + "word " * 80)
    long = msgspec.structs.replace(episode, mission=text)
    short = render_overlay(room, [episode], renderer, width=600)
    tall = render_overlay(room, [long], renderer, width=600, caption=["a line more"])
    assert tall.size[1] > short.size[1] and tall.size[0] == short.size[0]
    many = render_overlay(room, [episode, long], renderer, width=600)
    assert amount(many, PATH) > 100


def test_a_page_of_all_shows_people_their_ways_and_where_they_begin(
    room: Scene, renderer: Renderer, episode: Episode
) -> None:
    walker = EpisodePerson(number=1, identity="drawn:0:3", path=((3.4, 2.5), (1.3, 2.5)), speed=0.8)
    other = msgspec.structs.replace(walker, number=2, path=((3.4, 1.5), (1.3, 1.5)))
    mission = MissionFollow(
        goal=(1.3, 2.5), person=1, human="drawn:0:3", instruction="Follow the man."
    )
    crowd = msgspec.structs.replace(episode, id="crowd", people=(walker,))
    follow = msgspec.structs.replace(crowd, mission=mission, people=(walker, other))
    plain = msgspec.structs.replace(episode, id="plain", start=(6.0, 2.5, 0.0))
    before = render_overlay(room, [episode, plain], renderer, width=600)
    grey = render_overlay(room, [crowd, plain], renderer, width=600)
    # the same path with other people is another line of the page
    both = render_overlay(room, [crowd, follow, plain], renderer, width=600)
    assert news(grey, before, OTHERS) > 60 and news(grey, before, GOAL) == 0
    assert news(both, grey, GOAL) > 60 and news(both, grey, OTHERS) > 60


def test_paths_without_a_map() -> None:
    straight = np.array([[0.0, 0.0], [3.0, 4.0]])
    picture = render_paths([straight, straight + 1.0], width=300)
    assert amount(picture, PATH) > 100 and max(picture.size) <= 301
    assert render_paths([]).size[0] > 0 and render_paths([np.array([[1.0, 1.0]])]).size[0] > 0
