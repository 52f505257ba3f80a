"""Posed clouds on demand: what is kept, what makes room, and that bytes and names stay bounded."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.avatars.posed_bank import SPLAT_BYTES, PosedBank
from gn0.avatars.poses import stride_pose
from gn0.avatars.reuse import GONE, ReuseOrder
from gn0.errors import ConfigError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import view_from_pose
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.instance import Instance
from gn0_trials.people_small import small_person


def dots(count: int, shade: float = 0.0) -> GaussianCloud:
    return GaussianCloud(
        means=np.zeros((count, 3), np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        scales=np.full((count, 3), 0.1, np.float32),
        opacities=np.ones(count, np.float32),
        sh=np.full((count, 1, 3), shade, np.float32),
    )


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.lists(st.integers(0, 11), max_size=4), max_size=40),
    st.integers(40, 130),
)
def test_bytes_stay_under_the_budget_and_clouds_are_those_asked_for(
    pictures: list[list[int]], room: int
) -> None:
    """Keys 0 to 11 stand for clouds of 1 to 12 splats; at most four of them a picture."""
    bank = PosedBank(room * SPLAT_BYTES)
    asked = made = 0

    def pose(key: int) -> GaussianCloud:
        nonlocal made
        made += 1
        return dots(key + 1)

    for keys in pictures:
        found = bank.fetch([(key, lambda key=key: pose(key)) for key in keys])  # type: ignore[misc]
        asked += len(keys)
        assert [len(each.cloud) for each in found] == [key + 1 for key in keys]
        names = {each.key: each.name for each in found}
        assert len(set(names.values())) == len(set(keys))
        assert bank.bytes <= bank.budget
        assert all(key in bank for key in keys)
    assert (bank.hits + bank.misses, bank.misses) == (asked, made)


def test_what_was_asked_for_once_makes_room_before_what_comes_again() -> None:
    bank = PosedBank(3 * SPLAT_BYTES)
    for key in ("a", "b", "c", "a", "d"):
        bank.fetch([(key, lambda: dots(1))])
    assert "c" not in bank and all(key in bank for key in "abd")
    assert (bank.hits, bank.misses, bank.hit_rate, len(bank)) == (1, 4, 0.2, 3)


def test_of_a_cycle_that_does_not_fit_as_much_is_there_as_fits() -> None:
    """Where the least recent makes room, the next is always the one that is gone."""
    bank = PosedBank(60 * SPLAT_BYTES)
    hits = []
    for turn in range(8 * 50):
        before = bank.hits
        bank.fetch([((who, turn % 50), lambda: dots(1)) for who in "ab"])
        hits.append(bank.hits - before)
        assert bank.bytes <= bank.budget
    assert sum(hits[:100]) >= 0.25 * 200, "from the second cycle on"
    assert sum(hits[100:]) >= 0.55 * 600, "60 of 100 fit, of which the last may always go"


def test_people_who_come_instead_of_others_are_there_at_their_third_cycle() -> None:
    """What is not asked for grows old, however often it was."""
    bank = PosedBank(40 * SPLAT_BYTES)
    for who in ("first", "second", "third"):
        for turn in range(6 * 30):
            before = bank.misses
            bank.fetch([((who, turn % 30), lambda: dots(1))])
            assert turn < 3 * 30 or bank.misses == before, (who, turn)


def test_what_makes_room_does_not_depend_on_chance() -> None:
    stream = np.random.default_rng(2)
    asked = stream.integers(0, 60, (500, 3)).tolist()
    runs = []
    for _ in range(2):
        bank, misses = PosedBank(40 * SPLAT_BYTES), []
        for keys in asked:
            bank.fetch([(f"{key}", lambda: dots(1)) for key in keys])
            misses.append(bank.misses)
        runs.append(misses)
    assert runs[0] == runs[1] and 0.5 < bank.hit_rate < 0.9


def test_requests_are_remembered_of_few_that_are_gone() -> None:
    order = ReuseOrder()
    for key in range(3 * GONE):
        order.ask([key])
        if key >= 2:
            gone = order.choose()
            assert gone is not None
            order.drop(gone)
    sizes = [len(getattr(order, name)) for name in ("_last", "_gap", "_gone", "_ranked")]
    assert sizes[:2] == [2, 2] and sizes[2] <= GONE and sizes[3] < 200


def test_names_are_given_again_to_clouds_of_their_size() -> None:
    """However many poses go through, a renderer knows no more names than fitted at a time."""
    bank = PosedBank(10 * 8 * SPLAT_BYTES)
    names = set()
    for key in range(200):
        (found,) = bank.fetch([(key, lambda: dots(8))])
        names.add(found.name)
    assert len(names) == 10


def test_a_picture_that_does_not_fit_is_refused() -> None:
    bank = PosedBank(10 * SPLAT_BYTES)
    with pytest.raises(ConfigError, match="people of one picture"):
        bank.fetch([("a", lambda: dots(6)), ("b", lambda: dots(6))])
    assert bank.bytes <= bank.budget and len(bank.fetch([("c", lambda: dots(9))])) == 1
    with pytest.raises(ConfigError, match="0 bytes"):
        PosedBank(0)


def test_a_small_bank_shows_the_same_pictures_as_a_large_one() -> None:
    """Names that change hands are told to the renderer again."""
    person = small_person()
    camera, view = Camera.from_hfov(96, 96, 90.0), view_from_pose(-2.0, 0.0, 1.2, 0.0)
    poses = [k / 3 * stride_pose() for k in range(4)]
    pictures = []
    for room in (1, 10):
        bank = PosedBank(room * len(person.pose()) * SPLAT_BYTES)
        renderer = RendererCpu(dots(0))
        shown = []
        for k in (0, 1, 2, 3, 1, 0):
            found = bank.fetch([(k, lambda k=k: person.pose(poses[k]))])  # type: ignore[misc]
            bank.tell(renderer, found)
            picture = renderer.render(camera, view, parts=[Instance(found[0].name, np.eye(4))])
            assert picture.rgb is not None
            shown.append(picture.rgb)
        pictures.append(np.stack(shown))
    np.testing.assert_array_equal(*pictures)
    assert (pictures[0][1] != pictures[0][2]).any()


def test_posed_clouds_of_a_person_share_what_no_pose_changes() -> None:
    person = small_person()
    one, two = person.pose(), person.pose(stride_pose())
    for name in ("scales", "sh", "label", "albedo"):
        assert np.shares_memory(getattr(one, name), getattr(two, name)), name
    assert not np.shares_memory(one.means, two.means)
    assert len(person.pose(shadow=False)) == len(person)
    assert 0 < len(one) - len(person) < 64  # the contact shadow
