"""Instances of which the host hears late: some of the views go first, and pictures are the same."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from gn0.avatars.avatar import Avatar
from gn0.avatars.coded_poses import PosesOneByOne
from gn0.avatars.posed_device import PosedBankDevice
from gn0.avatars.poses import stride_pose
from gn0.device.device import DeviceArray
from gn0.device.host import DeviceHost
from gn0.errors import DeviceMemoryError, RenderError
from gn0.geometry import F64
from gn0.render.cuda import draw
from gn0.render.cuda.batch import RendererBatch
from gn0.render.instance import PartsDevice
from gn0.render.renderer import RenderOptions
from gn0_figures.flat import build_flat, flat_camera, flat_views
from gn0_figures.moving import pose_ahead
from gn0_trials.people_small import small_person

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")

CAMERA, VIEWS = flat_camera(48, 36), flat_views(4)
FLOAT = RenderOptions(rgb_float=True)
OUTPUTS = ("rgb", "depth", "alpha")


class Posture:
    """The small person, bent so far."""

    rest_key = "small"

    def __init__(self, bend: float) -> None:
        self._bend = bend

    @property
    def avatar(self) -> Avatar:
        return small_person(0, 0.1)

    def turn(self) -> tuple[F64, F64]:
        pose = np.array(stride_pose())
        pose[3] += (self._bend, 0.0, 0.0)
        return pose, np.zeros(3)


POSES = PosesOneByOne(lambda code: Posture(0.05 * code))


class Party:
    """Two people in each of four views, by codes; those of one call all lack in the next."""

    def __init__(self, *, budget: int = 2**24) -> None:
        self.batch = RendererBatch(DeviceHost(), FLOAT)
        for key, seed in (("a", 0), ("b", 1)):
            self.batch.add(key, lambda seed=seed: build_flat(1500, seed=seed))
        self.bank = PosedBankDevice(self.batch, budget)
        device = self.batch.device
        self.views, self.which = device.upload(VIEWS), device.upload(np.array([0, 1, 1, 0], "i4"))
        self.chosen = device.upload(np.full(8, -1, np.int32))
        self.poses = device.upload(
            np.stack([pose_ahead(v, 1.5, 0.4 * k - 0.2, 0.7 * k) for v in VIEWS for k in range(2)])
        )

    def ask(self, first: int, codes: Sequence[int] | None = None, **more) -> PartsDevice:
        asked = np.array(codes or [0, *range(first, first + 7)], np.uint64)
        late = self.bank.ask(self.batch.device.upload(asked), self.chosen, 2)
        return PartsDevice(None, self.poses, self.chosen, 2, late=late, **more)

    def answer(self) -> int:
        self.bank.answer(POSES)
        return self.bank.late_views

    def draw(self, parts: PartsDevice, **more) -> list[bytes]:
        drawn = self.batch.draw(
            CAMERA, self.views, ["a", "b"], chosen=self.which, parts=parts, **more
        )
        got = drawn.numpy()
        return [getattr(got, name).tobytes() for name in OUTPUTS]


def settled_before(party: Party, first: int) -> list[bytes]:
    parts = party.ask(first)
    party.answer()
    return party.draw(parts)


@pytest.fixture(params=[2, 1000], ids=["some of them first", "all wait"])
def many(request, monkeypatch) -> int:
    """Views from which on some of them are drawn before who lacks is waited for."""
    monkeypatch.setattr(draw, "_MANY", request.param)
    return request.param


def test_pictures_are_those_of_people_who_were_settled_before(many: int) -> None:
    """Also where the table of clouds grows meanwhile (16 slots at first), and nobody lacks."""
    late, early = Party(), Party()
    for first in (1, 8, 15, 22, 22):
        drawn = late.draw(late.ask(first, settle=late.answer))
        assert drawn == settled_before(early, first)
    assert len(late.batch._named.table) > 16
    assert late.batch.drawer.repeats == early.batch.drawer.repeats


@pytest.mark.parametrize("rows", [(0,), (1, 2), (0, 1, 3)])
def test_whoever_lacks_is_seen_wherever_he_is(rows: tuple[int, ...], monkeypatch) -> None:
    """In views that go first, and in others: where many lack, the first are drawn once more."""
    monkeypatch.setattr(draw, "_MANY", 2)
    late, early = Party(), Party()
    for party in (late, early):
        settled_before(party, 1)
    codes = [0, 1, 2, 3, 4, 0, 6, 7]
    for row in rows:
        codes[2 * row + 1] = 20 + row
    parts = late.ask(0, codes)
    assert parts.late is not None and late.answer() == len(rows)
    assert np.flatnonzero(parts.late.numpy()).tolist() == list(rows)
    for party in (late, early):  # as if nobody had asked
        party.bank = PosedBankDevice(party.batch, 2**24)
        settled_before(party, 1)
    drawn = late.draw(late.ask(0, codes, settle=late.answer))
    parts = early.ask(0, codes)
    early.answer()
    assert drawn == early.draw(parts)


def test_some_of_the_views_are_drawn_before_anybody_is_waited_for(monkeypatch) -> None:
    """The device paints them while the host hears who lacks and poses him."""
    monkeypatch.setattr(draw, "_MANY", 4)
    party, told = Party(), []

    def settle() -> int:
        told.append("here")
        return party.answer()

    party.draw(party.ask(1, settle=settle))
    told.clear()
    party.batch.drawer.on_stage = told.append
    codes = [0, 1, 2, 3, 4, 5, 6, 30]  # the last view has to wait
    before = party.batch.drawer.batches
    party.draw(party.ask(0, codes, settle=settle))
    batch = ["upload", "emit", "scan", "blend", "end"]
    assert told == [*batch, "settle", "here", *batch]
    assert party.batch.drawer.batches == before + 2


@pytest.mark.parametrize("again", [False, True], ids=["once", "listed once more"])
def test_more_is_done_while_the_device_draws(again: bool, many: int, monkeypatch) -> None:
    """Once, when it has all views; should they be drawn again, the table may have grown."""
    party, other, told, needs = Party(), Party(), [], [again]
    run_batch = draw.Drawer._run_batch

    def listed(drawer, work, views, *more):
        need = run_batch(drawer, work, views, *more)
        return need or (views.stop == work.count and bool(needs) and needs.pop())

    def meanwhile() -> None:
        told.append("meanwhile")
        party.bank.expect(party.batch.device.upload(np.arange(20, 60, dtype=np.uint64)))
        assert party.bank.pose_expected(POSES, shown=True) == 40

    settled_before(party, 1), settled_before(other, 1)
    slots, repeats = len(party.batch._named.table), party.batch.drawer.repeats
    monkeypatch.setattr(draw.Drawer, "_run_batch", listed)
    party.batch.drawer.on_stage = told.append
    found = party.draw(party.ask(8, settle=party.answer, meanwhile=meanwhile))
    assert len(party.batch._named.table) > slots
    assert party.batch.drawer.repeats == repeats + again
    batch = ["upload", "emit", "scan", "blend", "end"]
    first = batch if many == 2 else []
    assert told == [*first, "settle", *batch, "meanwhile", *batch * again]
    party.batch.drawer.on_stage = None
    assert found == settled_before(other, 8)
    assert party.draw(party.ask(20, settle=party.answer)) == settled_before(other, 20)


def test_views_of_one_scene_are_drawn_together(monkeypatch) -> None:
    """What lists a scene does so for many views at once; who is late comes last."""
    monkeypatch.setattr(draw, "_MANY", 4)
    party = Party()
    settled_before(party, 1)  # views are of scenes 0, 1, 1 and 0
    for codes, order in (
        ([0, 1, 2, 3, 4, 5, 6, 7], [0, 3, 1, 2]),
        ([9, 0] + [0] * 6, [3, 1, 2, 0]),
    ):
        party.draw(party.ask(0, codes, settle=party.answer))
        drawn, place = party.batch.drawer._held["order of views"].numpy()[:8].reshape(2, 4)
        assert drawn.tolist() == order and drawn[place].tolist() == [0, 1, 2, 3]


def test_what_failed_is_tried_again() -> None:
    """A device without room lets go of what it need not hold, and nobody is posed twice."""
    party, other, failed = Party(), Party(), []
    settled_before(party, 1), settled_before(other, 1)
    pose_parts = party.batch.pose_parts

    def fail_once(*given):
        if not failed:
            failed.append(True)
            raise DeviceMemoryError("no room", remedy="none")
        return pose_parts(*given)

    party.batch.pose_parts = fail_once  # type: ignore[method-assign]
    assert party.draw(party.ask(8, settle=party.answer)) == settled_before(other, 8)
    assert failed and (party.bank.misses, party.bank.hits) == (other.bank.misses, other.bank.hits)
    assert party.bank.answer(POSES) == 0, "it was answered"


def test_who_cannot_be_posed_is_told_and_the_next_call_draws() -> None:
    party, other = Party(), Party()
    settled_before(party, 1)

    def refuse() -> int:
        raise RenderError("nobody", where="pose 3")

    with pytest.raises(RenderError, match="nobody"):
        party.draw(party.ask(8, settle=refuse))
    party.answer()
    assert party.draw(party.ask(8, settle=party.answer)) == settled_before(other, 8)


@pytest.mark.parametrize("way", ["who", "tails", "no room"])
def test_other_ways_wait_first(way: str, monkeypatch) -> None:
    """Those that the host arranges read who stands where when that is known."""
    late, early = Party(), Party()
    if way == "no room":  # for both scenes at once: drawn one after the other
        for party in (late, early):
            monkeypatch.setattr(party.batch.store, "together", lambda *_: None)

    def look(party: Party, parts: PartsDevice) -> object:
        if way != "who":
            return party.draw(parts, tails=build_flat(50, seed=3) if way == "tails" else None)
        keys, which = ["a", "b"], party.which
        who = party.batch.draw_who(CAMERA, party.views, keys, chosen=which, parts=parts)
        told = who.fetch([2] * 4)
        return told.numbers.tobytes(), str(told.seen)

    for first in (1, 8):
        before = late.bank.misses
        found = look(late, late.ask(first, settle=late.answer))
        parts = early.ask(first)
        early.answer()
        assert found == look(early, parts) and late.bank.misses == before + 7


def test_slots_are_written_where_they_lie() -> None:
    """A call without `settle` means what stands there already, as before."""
    party = Party()
    parts = party.ask(1)
    party.answer()
    assert isinstance(parts.chosen, DeviceArray) and parts.settle is None
    one = party.draw(parts)
    assert party.draw(replace(parts, settle=lambda: 0)) == one
