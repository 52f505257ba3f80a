"""Instances of which the host hears late: scenes are listed before, and pictures stay the same."""

from __future__ import annotations

import shutil
from collections.abc import Callable
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

    def ask(self, first: int, **more) -> PartsDevice:
        codes = np.array([0, *range(first, first + 7)], np.uint64)
        self.bank.ask(self.batch.device.upload(codes), self.chosen)
        return PartsDevice(None, self.poses, self.chosen, 2, **more)

    def answer(self) -> int:
        return self.bank.answer(POSES)

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


def test_pictures_are_those_of_people_who_were_settled_before() -> None:
    """Also where the table of clouds grows meanwhile (16 slots at first), and nobody lacks."""
    late, early = Party(), Party()
    for first in (1, 8, 15, 22, 22):
        drawn = late.draw(late.ask(first, settle=late.answer))
        assert drawn == settled_before(early, first)
    assert len(late.batch._named.table) > 16
    assert late.batch.drawer.repeats == early.batch.drawer.repeats


def test_scenes_are_listed_before_anybody_is_waited_for() -> None:
    """The device has work while the host hears who lacks: from the second call on, when lists
    have room by the first."""
    party, told = Party(), []

    def settle() -> None:
        told.append("here")
        party.answer()

    for first in (1, 8):
        told.clear()
        party.batch.drawer.on_stage = told.append
        party.draw(party.ask(first, settle=settle))
        party.batch.drawer.on_stage = None
    assert told == ["upload", "emit", "settle", "here", "emit", "scan", "blend", "end"]


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
    assert party.answer() == 0, "it was answered"


def test_who_cannot_be_posed_is_told_and_the_next_call_draws() -> None:
    party, other = Party(), Party()
    settled_before(party, 1)

    def refuse() -> None:
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
        waited: list[int] = []
        settle: Callable[[], object] = lambda late=late, w=waited: w.append(late.answer())  # noqa: E731
        found = look(late, late.ask(first, settle=settle))
        parts = early.ask(first)
        early.answer()
        assert found == look(early, parts) and waited[0] == 7


def test_slots_are_written_where_they_lie() -> None:
    """A call without `settle` means what stands there already, as before."""
    party = Party()
    parts = party.ask(1)
    party.answer()
    assert isinstance(parts.chosen, DeviceArray) and parts.settle is None
    one = party.draw(parts)
    assert party.draw(replace(parts, settle=lambda: None)) == one
