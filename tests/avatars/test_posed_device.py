"""Posed people on a device, in the host emulation: skinned there, packed, and kept in a bank."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest

from gn0.avatars.avatar import SHADOWS, Avatar
from gn0.avatars.coded_poses import PosesOneByOne
from gn0.avatars.posed_device import PosedBankDevice, posing_of, posings_of, rest_of
from gn0.avatars.poses import standing_pose, stride_pose
from gn0.device.device import DeviceArray
from gn0.device.host import DeviceHost
from gn0.errors import ConfigError, DeviceMemoryError, RenderError
from gn0.gaussians.cloud import GaussianCloud, join_clouds
from gn0.geometry import F64, rotation_from_quaternion, view_from_pose
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.cuda.batch import RendererBatch
from gn0.render.cuda.posed import bring_rest, pose_clouds, ready_poses
from gn0.render.cuda.posed_places import SLAB, Places, PosedPlaces
from gn0.render.cuda.slot_finder import SlotFinder, place_codes
from gn0.render.instance import Instance, PartsDevice, move_instance
from gn0.render.renderer import RenderOptions
from gn0.render.visible_places import VisibleOptions
from gn0.testing.renderer_check import psnr
from gn0_figures.flat import EYE, build_flat, flat_floor, flat_views
from gn0_trials.people_small import small_person

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")

CAMERA = Camera.from_hfov(48, 36, 70.0)
VIEW = flat_views(10)[7]  # 1.8 m from a wall
FLOAT = RenderOptions(rgb_float=True)
COARSE = VisibleOptions(cell=4.0, places=1, pixels=16, coarse=1)
GAIN = np.array([[0.7, 0.6, 0.5], [0.2, 0.1, 0.1], [0.1, -0.2, 0.0], [0.2, 0.2, 0.3]], np.float32)


@dataclass(frozen=True)
class Posture:
    """The small person in a stride so far into it."""

    bend: float = 0.0
    rest_key: str = "small"

    @property
    def avatar(self) -> Avatar:
        return small_person(0, 0.1)

    def turn(self) -> tuple[F64, F64]:
        pose = np.array(stride_pose())
        pose[3] += (self.bend, 0.0, 0.1 * self.bend)
        return pose, np.array([0.02, 0.01, -0.03])


def posed(bend: float = 0.0) -> GaussianCloud:
    return Posture().avatar.pose(*Posture(bend).turn())


def stand(ahead: float = 1.4, y: float = 0.1, turn: float = 2.5, cloud: str = "") -> Instance:
    """On the floor, so far ahead of the eye and to the left."""
    pose = np.eye(4)
    c, s = np.cos(turn), np.sin(turn)
    pose[:2, :2] = (c, -s), (s, c)
    pose[:2, 3] = (np.linalg.inv(VIEW) @ (-y, 0.0, ahead, 1.0))[:2]
    return Instance(cloud, pose, GAIN)


@pytest.mark.parametrize("pose", [standing_pose(), stride_pose()])
def test_the_device_skins_as_the_cpu_does(pose: F64) -> None:
    """Centres to 0.01 mm, axes and normals to hundredths of a degree."""
    avatar, device = small_person(1, 0.1), DeviceHost(checked=True)
    rest = bring_rest(device, rest_of(avatar))
    shift = np.array([0.1, 0.05, -0.2])
    (cloud,) = pose_clouds(device, [posing_of(avatar, rest, pose, shift)])
    want = avatar.pose(pose, shift)
    words, index = cloud.splats.numpy()[: cloud.alive], cloud.order.numpy()[: cloud.alive]
    assert sorted(index.tolist()) == list(range(len(want))), "each splat once"
    first, second = (words[:, k] | words[:, k + 1].astype(np.uint64) << 32 for k in (0, 2))
    steps = np.stack([(first >> 21 * k) & 0x1FFFFF for k in range(3)], axis=1)
    places = (steps.astype(np.float64) - 2**20) * cloud.step + (0, 0, 1)
    assert np.abs(places - want.means[index]).max() <= 1e-5 and cloud.step < 3e-6
    body = index < len(avatar)
    turn = (second[body] & (2**40 - 1)) | (first[body] >> 63) << 40
    three = np.stack([(turn >> 13 * k) & 0x1FFF for k in range(3)], axis=1).astype(np.float64)
    three = (three - 2**12) * (np.sqrt(0.5) / (2**12 - 1))
    out, rows = (turn >> 39).astype(int), np.arange(body.sum())
    quats = np.zeros((len(rows), 4))
    for k in range(3):
        quats[rows, k + (k >= out)] = three[:, k]
    quats[rows, out] = np.sqrt(1 - (three**2).sum(axis=1))
    got = rotation_from_quaternion(quats)
    truth = rotation_from_quaternion(want.quats[index[body]].astype(np.float64))
    assert np.abs(got - truth).max() < 8e-4
    x, y = ((second >> at & 0xFFF).astype(np.float64) / 2047.0 - 2048 / 2047 for at in (40, 52))
    z = 1 - abs(x) - abs(y)
    fold = np.maximum(-z, 0)
    normal = np.stack([x - np.copysign(fold, x), y - np.copysign(fold, y), z], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    assert np.abs(normal - want.normal[index]).max() < 1e-3


@pytest.fixture(scope="module")
def batch() -> RendererBatch:
    renderer = RendererBatch(DeviceHost(), FLOAT)
    renderer.keep("flat", SCENE)
    return renderer


SCENE = build_flat(2500)


def test_packed_people_are_as_good_as_moved_splats(batch: RendererBatch) -> None:
    bank = PosedBankDevice(batch)
    (slot,) = bank.fetch([("stride", Posture())])
    one = stand(cloud=bank.name(slot))
    drawn = [batch.render(CAMERA, VIEW, "flat", parts=[one]) for _ in range(4)]
    assert len({tuple(d.rgb.tobytes() for d in (one,)) for one in drawn}) == 1, "recorded as well"
    cpu = RendererCpu(SCENE, FLOAT)
    cpu.name_cloud("him", posed())
    moved = cpu.render(CAMERA, VIEW, extra=move_instance(posed(), stand()))
    for want in (moved, cpu.render(CAMERA, VIEW, parts=[stand(cloud="him")])):
        assert psnr(drawn[0].rgb[0], want.rgb[0]) >= 75
        both = np.isfinite(drawn[0].depth[0]) & np.isfinite(want.depth[0])
        assert np.quantile(abs(drawn[0].depth[0] - want.depth[0])[both], 0.99) <= 1e-4
    assert psnr(drawn[0].rgb[0], cpu.render(CAMERA, VIEW).rgb[0]) < 40, "somebody is there"


def test_a_call_lacks_some_and_one_launch_makes_them(batch: RendererBatch) -> None:
    bank = PosedBankDevice(batch)
    keys = [("walk", k) for k in range(5)]
    wanted = [(key, Posture(0.1 * key[1])) for key in keys]
    first = bank.fetch([*wanted, wanted[0]])
    assert (bank.hits, bank.misses, bank.launches, len(bank)) == (1, 5, 1, 5)
    assert len(set(first)) == 5 and first[5] == first[0]
    assert bank.fetch(wanted) == first[:5] and bank.launches == 1
    parts = [[stand(y=0.4 * k - 0.8, cloud=bank.name(slot)) for k, slot in enumerate(first[:5])]]
    got = batch.render(CAMERA, VIEW, "flat", parts=parts[0])
    moved = [move_instance(posed(0.1 * k), stand(y=0.4 * k - 0.8)) for k in range(5)]
    want = RendererCpu(SCENE, FLOAT).render(CAMERA, VIEW, extra=join_clouds(moved))
    assert psnr(got.rgb[0], want.rgb[0]) >= 75


def test_who_is_asked_for_least_makes_room_and_recordings_hold(batch: RendererBatch) -> None:
    size = PosedBankDevice(batch)
    size.fetch([("one", Posture())])
    bank = PosedBankDevice(batch, budget=3 * size.bytes)
    pictures = []
    for k in (0, 1, 2, 0, 3, 0, 2):
        (slot,) = bank.fetch([(k, Posture(0.3 * k))])
        one = stand(cloud=bank.name(slot))
        pictures.append(batch.render(CAMERA, VIEW, "flat", parts=[one]).rgb.tobytes())
        assert bank.bytes <= bank.budget and len(bank) <= 3
    assert pictures[0] == pictures[3] == pictures[5] and pictures[2] == pictures[6]
    assert len(set(pictures)) == 4
    assert (bank.hits, bank.misses, bank.evicted) == (2, 5, 2), "2 went for 3, 3 for 2"
    assert 1 not in PosedBankDevice(batch) and 0 in bank and 1 in bank and 2 in bank
    with pytest.warns(RuntimeWarning, match="more than"):
        bank.fetch([(k, Posture(0.1 * k)) for k in range(10, 14)])
    assert sorted(k for k in range(20) if k in bank) == [10, 11, 12, 13], "all of the call"
    assert bank.bytes == 4 * size.bytes > bank.budget
    bank.fetch([(k, Posture(0.1 * k)) for k in range(14, 18)])  # nothing is said again
    bank.fetch([(18, Posture(1.8))])
    assert 18 in bank and len(bank) == 3 and bank.bytes == bank.budget
    with pytest.raises(ConfigError, match="0 bytes"):
        PosedBankDevice(batch, 0)


def test_a_kernel_asks_by_codes(batch: RendererBatch) -> None:
    """Codes that are there are found there; those that lack are posed, each once."""
    device, bank = batch.device, PosedBankDevice(batch)
    asked: list[int] = []

    def pose(code: int) -> Posture:
        asked.append(code)
        return Posture(1e-3 * (code % 1000))

    codes = np.array([17, 0, 2**62 + 5, 17, 900, 0], np.uint64)
    chosen = device.empty(6, np.int32)
    assert bank.find(device.upload(codes), chosen, PosesOneByOne(pose)) == 3
    slots = chosen.numpy()
    assert asked == [17, 900, 2**62 + 5] and bank.launches == 1
    assert (slots == -1).tolist() == [False, True, False, False, False, True]
    assert slots[0] == slots[3] and len(set(slots.tolist())) == 4
    assert bank.find(device.upload(codes), chosen, PosesOneByOne(pose)) == 0 and len(asked) == 3
    assert (chosen.numpy() == slots).all()
    poses = np.stack([stand(y=0.5 * k - 1).pose for k in range(6)])
    there = PartsDevice(
        None, device.upload(poses), chosen, 3, device.upload(np.tile(GAIN, (6, 1, 1)))
    )
    views = device.upload(np.stack([VIEW, VIEW]))
    got = batch.render(CAMERA, views, "flat", parts=there)
    host = [
        [
            replace(stand(y=0.5 * k - 1), cloud=bank.name(int(slots[k])))
            for k in row
            if slots[k] >= 0
        ]
        for row in ((0, 1, 2), (3, 4, 5))
    ]
    want = batch.render(CAMERA, np.stack([VIEW, VIEW]), "flat", parts=host)
    assert got.rgb.tobytes() == want.rgb.tobytes() and got.depth.tobytes() == want.depth.tobytes()


def test_many_are_posed_as_each_alone() -> None:
    """To the bit: a cloud does not show with whom it was made."""
    device, people = DeviceHost(), [small_person(k, 0.1) for k in (0, 1)]
    rests = [bring_rest(device, rest_of(one)) for one in people]
    wanted = [
        (people[k % 2], rests[k % 2], *Posture(0.1 * k).turn())
        for k in range(5)
    ]  # fmt: skip
    together = pose_clouds(device, posings_of(wanted))
    for one, cloud in zip(wanted, together, strict=True):
        (alone,) = pose_clouds(device, [posing_of(*one)])
        assert cloud.step == alone.step and np.array_equal(cloud.bounds, alone.bounds)
        for name in ("splats", "boxes"):
            assert np.array_equal(getattr(cloud, name).numpy(), getattr(alone, name).numpy())


def test_codes_lie_where_a_kernel_looks_for_them() -> None:
    """Also those that go on from the table's start."""
    slots = {code: code % 97 for code in range(1, 4000, 7)}
    places = 1024
    codes, which = (np.array([*some]) for some in (slots.keys(), slots.values()))
    keys, found = place_codes(codes.astype(np.uint64), which.astype(np.int32), places)
    assert (keys > 0).sum() == len(slots)
    around = 0
    for code, slot in slots.items():
        at = code * 0x9E3779B97F4A7C15 >> 32 & places - 1
        around += at + 8 > places
        while keys[at] != code:
            assert keys[at], "a free place on the way"
            at = (at + 1) % places
        assert found[at] == slot
    assert around


def test_who_was_found_by_a_kernel_counts_as_used(batch: RendererBatch) -> None:
    device, one = batch.device, PosedBankDevice(batch)
    one.fetch([(1, Posture())])
    bank = PosedBankDevice(batch, budget=2 * one.bytes)
    chosen = device.empty(1, np.int32)
    poses = PosesOneByOne(lambda code: Posture(0.1 * code))
    for code in (1, 2, 1, 3):
        bank.find(device.upload(np.array([code], np.uint64)), chosen, poses)
    assert 1 in bank and 3 in bank and 2 not in bank


def test_who_is_expected_is_there_when_asked_for(batch: RendererBatch) -> None:
    """And nobody is posed twice, nor makes room for others before."""
    device, one = batch.device, PosedBankDevice(batch)
    one.fetch([(1, Posture())])
    bank = PosedBankDevice(batch, budget=3 * one.bytes)
    chosen = device.empty(2, np.int32)
    poses = PosesOneByOne(lambda code: Posture(0.1 * code))

    def send(*codes: int) -> DeviceArray:
        return device.upload(np.array(codes, np.uint64))

    bank.find(send(1, 0), chosen, poses)
    bank.ask(send(2, 1), chosen)
    bank.expect(send(2, 3))
    assert bank.answer(poses) == 1 and bank.pose_expected(poses) == 1, "2 is there by then"
    assert bank.pose_expected(poses) == 0 and (bank.ahead, bank.misses) == (1, 2)
    assert bank.find(send(3, 2), chosen, poses) == 0 and len(bank) == 3
    bank.expect(send(2, 4))
    assert bank.pose_expected(poses) == 1 and len(bank) == 3 and 2 in bank
    assert bank.find(send(2, 4), chosen, poses) == 0 and chosen.numpy().min() >= 0
    bank.ask(send(5, 4), chosen)
    bank.expect(send(5, 6))
    assert bank.answer(poses) == 1 and bank.bytes > bank.budget, "nobody who waits makes room"
    assert bank.pose_expected(poses) == 1 and bank.bytes == bank.budget and 5 in bank and 6 in bank
    bank.ask(send(5, 7), chosen)
    bank.expect(send(5, 0))
    assert bank.answer(poses) == 1 and bank.bytes > bank.budget
    assert bank.pose_expected(poses) == 0 and bank.bytes == bank.budget and 5 in bank


def test_who_is_shown_may_be_kept_until_he_was(batch: RendererBatch) -> None:
    """Others make room meanwhile; where they are too few, nobody is posed before all may."""
    device, one = batch.device, PosedBankDevice(batch)
    one.fetch([(1, Posture())])
    bank = PosedBankDevice(batch, budget=4 * one.bytes)
    chosen = device.empty(3, np.int32)
    poses = PosesOneByOne(lambda code: Posture(0.1 * code))

    def send(*codes: int) -> DeviceArray:
        return device.upload(np.array(codes, np.uint64))

    bank.find(send(1, 0, 0), chosen, poses)
    bank.ask(send(2, 3, 4), chosen)
    bank.expect(send(2, 3, 5))
    bank.answer(poses)
    assert bank.pose_expected(poses, shown=True) == 1 and 1 not in bank
    assert all(code in bank for code in (2, 3, 4, 5)) and bank.bytes == bank.budget
    bank.ask(send(2, 3, 5), chosen)
    bank.expect(send(6, 7, 5))
    assert bank.answer(poses) == 0
    assert bank.pose_expected(poses, shown=True) == 0, "4 alone could make room"
    assert all(code in bank for code in (2, 3, 4, 5)) and bank.evicted == 1
    assert bank.pose_expected(poses) == 2 and 6 in bank and 7 in bank and 5 in bank
    assert bank.bytes == bank.budget and bank.pose_expected(poses) == 0
    bank.ask(send(5, 0, 0), chosen)
    bank.expect(send(9, 0, 0))
    assert bank.answer(poses) == 0 and bank.pose_expected(poses) == 1
    first, second, third = [code for code in range(1, 8) if code in bank]
    bank.ask(send(second, third, 8), chosen)
    assert bank.answer(poses) == 1 and first not in bank, "it is learnt who was found"
    assert all(code in bank for code in (second, third, 8, 9)) and bank.bytes == bank.budget


def test_an_eighth_of_the_budget_makes_room_at_once(batch: RendererBatch) -> None:
    device, one = batch.device, PosedBankDevice(batch)
    one.fetch([(1, Posture())])
    bank = PosedBankDevice(batch, budget=16 * one.bytes)
    chosen, poses = device.empty(1, np.int32), PosesOneByOne(lambda code: Posture(0.05 * code))
    gone = []
    for code in range(1, 21):
        bank.find(device.upload(np.array([code], np.uint64)), chosen, poses)
        gone.append(bank.evicted)
    assert gone[14:] == [0, 0, 3, 3, 3, 6], "one must, and two more do"


def test_a_table_learns_what_comes_and_goes(batch: RendererBatch) -> None:
    """Thousands of codes, of which a part goes each time: slots are those of a table laid anew."""
    device, finder = batch.device, SlotFinder(batch.device, least=32)
    drawn = np.random.default_rng(0)
    held: dict[int, int] = {}
    free, next_code, laid = list(range(600)), 1, 0
    for _ in range(60):
        gone = [*held][: len(held) // 3]
        free += [held.pop(code) for code in gone]
        codes = [next_code + 97 * k for k in range(int(drawn.integers(1, 120)))]
        next_code = codes[-1] + 1
        new = dict(zip(codes, free, strict=False))
        free = free[len(new) :]
        held |= new
        told = np.array([*gone, *new], np.uint64), np.array([-1] * len(gone) + [*new.values()])
        if not finder.hold(told[0], told[1].astype(np.int32)):
            laid += 1
            finder.set(np.array([*held], np.uint64), np.array([*held.values()], np.int32), 600)
        wanted = np.array([*held, *gone, 0], np.uint64)
        chosen = device.empty(len(wanted), np.int32)
        lacking = finder.find(device.upload(wanted), chosen, 1).numpy()
        assert chosen.numpy().tolist() == [*held.values()] + [-1] * (len(gone) + 1)
        assert lacking.tolist() == sorted(gone)
    assert 1 < laid < 20
    assert not finder.hold(np.array([5], np.uint64), np.array([600], np.int32)), "no such slot"


@pytest.mark.parametrize("by_kernel", [False, True])
def test_a_cycle_that_does_not_fit_keeps_a_part_of_itself(
    batch: RendererBatch, by_kernel: bool
) -> None:
    """And whoever is asked for in every call stays, however many others come once."""
    device, one = batch.device, PosedBankDevice(batch)
    one.fetch([(1, Posture())])
    bank = PosedBankDevice(batch, budget=4 * one.bytes)
    chosen = device.empty(2, np.int32)

    def ask(*codes: int) -> int:
        before = bank.misses
        if by_kernel:
            bank.find(
                device.upload(np.array(codes, np.uint64)),
                chosen,
                PosesOneByOne(lambda c: Posture(0.01 * c)),
            )
        else:
            bank.fetch([(code, Posture(0.01 * code)) for code in codes])
        return bank.misses - before

    assert sum(ask(1 + k % 6) for k in range(60)) < 40, "the least recent out would keep none"
    assert sum(ask(50, 100 + k) for k in range(20)) == 21
    assert bank.bytes <= bank.budget


def test_askings_of_one_call_count_once_and_fade(batch: RendererBatch) -> None:
    device, one = batch.device, PosedBankDevice(batch)
    one.fetch([(1, Posture())])
    bank = PosedBankDevice(batch, budget=2 * one.bytes)
    chosen = device.empty(8, np.int32)

    def ask(*codes: int) -> None:
        many = np.resize(np.array(codes, np.uint64), 8)
        bank.find(device.upload(many), chosen, PosesOneByOne(lambda c: Posture(0.01 * c)))

    ask(1)  # by eight agents, once
    for _ in range(3):
        ask(2)
    ask(3)
    assert 2 in bank and 1 not in bank
    for _ in range(600):  # 2 was asked for three times, long ago
        ask(3)
    ask(4)
    assert 3 in bank and 4 in bank and 2 not in bank


def test_who_made_room_comes_back_the_same(batch: RendererBatch) -> None:
    """Nobody poses it again; its bytes are those of before, in whatever memory."""
    device, one = batch.device, PosedBankDevice(batch)
    one.fetch([("one", Posture())])
    bank = PosedBankDevice(batch, budget=2 * one.bytes)
    asked: list[int] = []
    chosen = device.empty(2, np.int32)

    def look(*codes: int) -> list[bytes]:
        def pose(code: int) -> Posture:
            asked.append(code)
            return Posture(0.1 * (code >> 1), f"small {code & 1}")

        found = device.upload(np.array(codes, np.uint64))
        bank.find(found, chosen, PosesOneByOne(pose, lambda code: code >> 1))
        clouds = [batch._named.table.clouds[slot] for slot in chosen.numpy().tolist()]
        return [b"".join(a.numpy().tobytes() for a in (c.splats, c.boxes)) for c in clouds]

    first = look(2, 4)
    others = look(6, 7)  # levels of one posture
    assert others[0] == others[1] and bank.evicted == 2 and asked == [2, 4, 6, 7]
    # those at rest went with their clouds: somebody must say who they are
    assert look(4, 2) == first[::-1] and bank.evicted == 4 and set(asked[4:]) <= {2, 4}


def test_memory_of_clouds_is_free_again_when_it_is_given_back() -> None:
    device = DeviceHost()
    places, before = PosedPlaces(device), device.used
    sizes = np.array([5000, 5100, 3 * SLAB, 5000])
    held = places.take(sizes)
    spans = sorted(zip(held.pointers.tolist(), (held.pointers + sizes).tolist(), strict=True))
    assert all(int(a[1]) <= int(b[0]) for a, b in pairwise(spans)), "none in another's"
    assert len(set(held.handles.tolist())) < len(sizes) == len(set(held.pointers.tolist()))
    assert before + 5 * SLAB >= device.used > before + 3 * SLAB
    second = Places(held.pointers[1:2], held.handles[1:2])
    places.give(second)
    assert places.take(np.array([5100])).pointers == second.pointers
    places.give(held)
    kept = device.used
    assert before + 5 * SLAB >= kept > before, "kept for who comes next"
    again = places.take(sizes[[0, 2]])
    assert device.used == kept
    places.give(again)
    places.let_go()
    assert device.used == before


def test_many_places_take_few_allocations_and_empty_slabs_go() -> None:
    """Places never overlap, whatever is given back and taken again; spare memory is bounded."""
    device, drawn = DeviceHost(limit=2**30), np.random.default_rng(0)
    places, before = PosedPlaces(device, spare=4 * SLAB), device.used
    held: dict[int, tuple[int, int]] = {}  # size and handle by pointer
    for _ in range(60):
        sizes = drawn.choice([3000, 9000, 200_000, 3 * SLAB], int(drawn.integers(1, 40)))
        taken = places.take(sizes)
        for pointer, handle, size in zip(*(a.tolist() for a in (*taken, sizes)), strict=True):
            assert pointer not in held
            held[pointer] = int(size), handle
        spans = sorted((pointer, pointer + size) for pointer, (size, _) in held.items())
        assert all(a[1] <= b[0] for a, b in pairwise(spans))
        gone = drawn.permutation(list(held))[: len(held) * 2 // 3]
        handles = np.array([held.pop(int(pointer))[1] for pointer in gone], np.int64)
        places.give(Places(gone.astype(np.uint64), handles))
    everybody = np.array(list(held), np.uint64)
    places.give(Places(everybody, np.array([handle for _, handle in held.values()], np.int64)))
    assert device.used - before <= 4 * SLAB, "spare memory"
    short = PosedPlaces(DeviceHost(limit=8 * SLAB))
    with pytest.raises(DeviceMemoryError):
        short.take(np.full(10, SLAB))
    assert len(short.take(np.full(7, SLAB)).handles) == 7, "nothing was lost by the refusal"


def test_the_table_s_own_memory_is_given_back_where_the_device_is_full() -> None:
    """A launch that finds no room takes no place for good."""
    device = DeviceHost()
    batch = RendererBatch(device, FLOAT, memory=2**20)
    rest = batch.bring_rest(rest_of(small_person(0, 0.1)))
    one = posing_of(small_person(0, 0.1), rest, stride_pose())
    ready, none = ready_poses([one]), np.zeros(1, np.int64)
    slots = batch.pose_parts([rest], none, ready)
    used, device.limit = batch._named.used, device.used + 64
    with pytest.raises(DeviceMemoryError):
        batch.pose_parts([rest], none, ready)
    device.limit = 2**33
    again = batch.pose_parts([rest], none, ready)
    assert again != slots and batch._named.used == 2 * used
    a, b = (batch._named.table.clouds[slot] for slot in (*slots, *again))
    assert a is not None and b is not None and b.splats.pointer != a.splats.pointer
    assert np.array_equal(a.splats.numpy(), b.splats.numpy())
    assert batch.slot_of(batch.name_part(again[0])) == again[0]
    batch.drop_parts(again)
    with pytest.raises(RenderError, match="no cloud is named"):
        batch.slot_of(batch.name_part(again[0]))


def test_who_reaches_too_far_is_named_instead() -> None:
    device, avatar = DeviceHost(), small_person(0, 0.1)
    rest = bring_rest(device, rest_of(avatar))
    far = posing_of(avatar, rest, stride_pose(), np.array([0.0, 0.0, 40.0]))
    with pytest.raises(RenderError, match=r"pose 0.*16 bytes hold.*name_cloud"):
        pose_clouds(device, [far])


def test_three_thousand_clouds_of_ten_thousand_fit() -> None:
    """What the default budget promises; the sizes are those that the bank counts by."""
    from gn0.avatars.posed_device import _size_of

    avatar = small_person(0, 0.1)

    class Large(Avatar):
        def __len__(self) -> int:
            return 10_000 - SHADOWS

    large = Large(**{name: getattr(avatar, name) for name in avatar.__dataclass_fields__})
    assert 512 * 2**20 // _size_of(large) >= 3000


def board(x: float, low: float, high: float) -> GaussianCloud:
    """An opaque board across the view at distance x, from height `low` to `high`."""
    y, z = np.meshgrid(np.arange(-3.0, 3.0, 0.05), np.arange(low, high, 0.05))
    n = y.size
    return GaussianCloud(
        means=np.column_stack([np.full(n, x), y.ravel(), z.ravel()]).astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        scales=np.tile(np.array([0.002, 0.05, 0.05], np.float32), (n, 1)),
        opacities=np.full(n, 0.99, np.float32),
        sh=np.full((n, 1, 3), -0.7, np.float32),
    )


def test_who_is_behind_a_wall_or_a_table() -> None:
    """A wall leaves no pixel of a person, a table what stands out above it; as on the CPU."""
    batch, look = RendererBatch(DeviceHost()), view_from_pose(0.0, 0.0, 1.2, 0.0)
    bank = PosedBankDevice(batch)
    (slot,) = bank.fetch([("stride", Posture())])
    pose = np.diag((-1.0, -1.0, 1.0, 1.0))  # faces the eye
    pose[0, 3] = 3.0
    shares = []
    for name, scene in (("wall", board(2.0, -1.0, 3.5)), ("table", board(2.0, 0.0, 0.8))):
        batch.keep(name, scene)
        cpu = RendererCpu(scene)
        cpu.name_cloud("him", posed())
        found = batch.render_who(CAMERA, look, name, parts=[Instance(bank.name(slot), pose)])
        want = cpu.render_who(CAMERA, look, parts=[Instance("him", pose)])
        assert (found.numbers == want.numbers).all() and found.seen == want.seen
        shares.append(found.seen[0][0].share)
        assert found.seen[0][0].whole > 30
    assert shares[0] == 0 and 0.3 < shares[1] < 0.8
    (seen,) = found.seen[0]
    assert seen.box is not None and seen.box[3] < 26, "nothing of him below the table's top"


def test_several_scenes_sets_and_views_on_the_device(batch: RendererBatch) -> None:
    """All ways give the same bytes; who is out of sight is listed nowhere, and changes none."""
    device, bank = batch.device, PosedBankDevice(batch)
    batch.keep("other", build_flat(1500, seed=1))
    for key in ("flat", "other"):
        batch.limit_to_visible(key, key, flat_floor(), EYE, COARSE, cache=False)
    slots = bank.fetch([(k, Posture(0.2 * k)) for k in range(2)])
    views, keys = np.stack([VIEW, flat_views(10)[9], VIEW]), ["flat", "other", "other"]
    rows = [[(0, 1.4, 0.2), (1, 1.6, -0.3)], [], [(1, 1.3, 0.0)]]
    host = [[stand(a, y, cloud=bank.name(slots[k])) for k, a, y in row] for row in rows]
    poses, chosen = np.zeros((3, 4, 4, 4)), np.full((3, 4), -1, np.int32)
    poses[:, 3], chosen[:, 3] = stand().pose, slots[0]
    poses[:, 3, 2, 3] = 50.0  # high above: in nobody's sight
    for v, row in enumerate(rows):
        for n, (k, a, y) in enumerate(row):
            poses[v, n], chosen[v, n] = stand(a, y).pose, slots[k]
    there = PartsDevice(
        None, device.upload(poses.reshape(12, 4, 4)), device.upload(chosen.ravel()), 4,
        device.upload(np.tile(GAIN, (12, 1, 1))),
    )  # fmt: skip
    which = device.upload(np.array([0, 1, 1], np.int32))
    for visible in (False, True):
        drawn = [batch.render(CAMERA, views, keys, parts=host, visible=visible)]
        entries = batch.drawer.entries
        drawn += [batch.render(CAMERA, views, keys, parts=host, visible=visible) for _ in range(2)]
        drawn.append(
            batch.draw(
                *(CAMERA, device.upload(views), ["flat", "other"]),
                chosen=which,
                parts=there,
                visible=visible,
            ).numpy()
        )
        assert batch.drawer.entries == entries
        assert len({(one.rgb.tobytes(), one.depth.tobytes()) for one in drawn}) == 1
        bare = batch.render(CAMERA, views, keys, visible=visible)
        assert psnr(drawn[0].rgb[0], bare.rgb[0]) < 40 and (drawn[0].rgb[1] == bare.rgb[1]).all()


@pytest.mark.slow
def test_no_thread_meets_another() -> None:
    """Skinning, looking up and drawing under the emulation's checker of races."""
    batch = RendererBatch(DeviceHost(seed=3, checked=True))
    batch.keep("flat", SCENE)
    device, bank = batch.device, PosedBankDevice(batch)
    chosen = device.empty(2, np.int32)
    codes = device.upload(np.array([5, 9], np.uint64))
    assert bank.find(codes, chosen, PosesOneByOne(lambda code: Posture(0.01 * code))) == 2
    poses = device.upload(np.stack([stand(y=0.3).pose, stand(y=-0.3).pose]))
    there = PartsDevice(None, poses, chosen, 2, device.upload(np.stack([GAIN, GAIN])))
    seen = batch.draw(CAMERA, device.upload(VIEW[None]), "flat", parts=there).numpy()
    plain = RendererBatch(DeviceHost())
    plain.keep("flat", SCENE)
    other = PosedBankDevice(plain)
    slots = other.fetch([(code, Posture(0.01 * code)) for code in (5, 9)])
    parts = [stand(y=y, cloud=other.name(s)) for s, y in zip(slots, (0.3, -0.3), strict=True)]
    want = plain.render(CAMERA, VIEW, "flat", parts=parts)
    assert seen.rgb.tobytes() == want.rgb.tobytes()
    who = batch.render_who(CAMERA, VIEW, "flat", parts=[stand(cloud=bank.name(slots[0]))])
    assert who.numbers.any()
