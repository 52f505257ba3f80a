"""People posed as the CPU renderer draws them: the bits of clouds, in 40 bytes a splat."""

from __future__ import annotations

import gc
import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from gn0.avatars.avatar import SHADOWS, TO_WORLD, Avatar
from gn0.avatars.detail import SHARES
from gn0.avatars.posed_bank import PosedBank
from gn0.avatars.poses import standing_pose, stride_pose
from gn0.avatars.skinning import pose_joints
from gn0.errors import DataError, RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import quaternion_from_rotation, rotation_from_quaternion, view_from_pose
from gn0.people.cast import Actor
from gn0.people.poser import name_posed, open_posed
from gn0.people.shown import PoseShown, Shown
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.cpu_pack import CHUNK, POSED_FIELDS
from gn0.render.cpu_posed import PosedPacked, posed_bytes
from gn0.render.instance import Instance, Parts
from gn0.render.open import build_renderer
from gn0.render.renderer import RenderOptions, RenderResult
from gn0_trials.people_small import small_person

CAMERA, VIEW = Camera.from_hfov(120, 90, 80.0), view_from_pose(-2.0, 0.0, 1.2, 0.0)
TINT = np.array([[0.8, 0.7, 0.9], [0.3, 0.1, 0.0], [-0.2, 0.1, 0.1], [0.1, 0.2, 0.3]], np.float32)


def floor_cloud(count: int = 400) -> GaussianCloud:
    stream = np.random.default_rng(1)
    places = stream.uniform((-1, -2, 0), (3, 2, 0.01), (count, 3)).astype(np.float32)
    return GaussianCloud(
        means=places,
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (count, 1)),
        scales=np.full((count, 3), 0.08, np.float32),
        opacities=np.full(count, 0.9, np.float32),
        sh=stream.uniform(-1, 1, (count, 1, 3)).astype(np.float32),
        label=np.zeros(count, np.int32),
        categories=np.ones(1, np.int32),
    )


def somebody(levels: tuple[Avatar, ...] | None = None) -> Actor:
    person = small_person()
    return Actor("small", "0123456789abcdef", levels or (person,) * len(SHARES))


def walking(frame: int, level: int = 0, actor: Actor | None = None) -> PoseShown:
    shown = Shown("walk", frame, "", 0, 4, 2, 2, 0.45)
    return PoseShown(actor or somebody(), shown, level)


def unpacked(person: Avatar, posed: PosedPacked) -> tuple[np.ndarray, np.ndarray]:
    """Rows of a posed cloud by the index of its splats [N, 10], and which have one."""
    lanes = posed.cloud.pack.reshape(-1, POSED_FIELDS, CHUNK).transpose(0, 2, 1)
    lanes = lanes.reshape(-1, POSED_FIELDS)[: posed.rest.alive]
    index = posed.rest.order[: posed.rest.alive]
    rows, there = np.zeros((len(posed), POSED_FIELDS), np.float32), np.zeros(len(posed), bool)
    rows[index], there[index] = lanes, True
    assert len(np.unique(index)) == len(index) and len(posed) == len(person) + SHADOWS
    return rows, there


def draw(renderer: RendererCpu, parts: Parts) -> list[bytes]:
    found: RenderResult = renderer.render(CAMERA, VIEW, parts=parts)
    labels = renderer.render(CAMERA, VIEW, parts=parts, outputs=("semantic", "instance"))
    who = renderer.render_who(CAMERA, VIEW, parts=parts)
    arrays = (found.rgb, found.depth, found.alpha, labels.semantic, labels.instance, who.numbers)
    return [np.ascontiguousarray(array).tobytes() for array in arrays]


@pytest.mark.parametrize("pose", [None, standing_pose(), stride_pose()])
def test_rows_are_those_of_the_cloud_to_the_bit(pose: np.ndarray | None) -> None:
    person = small_person()
    faint = person.opacities.copy()
    faint[::7] = 0.001  # never shows, and takes no place
    for one in (person, replace(person, opacities=faint)):
        cloud = one.pose(pose, np.array([0.1, 0.0, 0.2]))
        posed = one.pose_packed(one.place_joints(pose, np.array([0.1, 0.0, 0.2])))
        rows, there = unpacked(one, posed)
        assert (there[: len(one)] == (one.opacities >= 1 / 255)).all() and there[len(one) :].all()
        want = np.column_stack([cloud.means, cloud.quats, cloud.normal])  # type: ignore[list-item]
        assert (rows[there] == want[there]).all()
        low, high = posed.cloud.boxes[:, :3].min(axis=0), posed.cloud.boxes[:, 3:6].max(axis=0)
        assert (low == want[there, :3].min(axis=0)).all()
        assert (high == want[there, :3].max(axis=0)).all()


@pytest.mark.parametrize("antialiased", [False, True])
@pytest.mark.parametrize("gain", [None, [1.0, 0.5, 2.0], TINT])
def test_pictures_are_those_of_the_cloud_to_the_bit(gain: object, antialiased: bool) -> None:
    """Colours, depth, labels and who is who, with shadows under one foot or both, from anywhere."""
    actor, options = somebody(), RenderOptions(antialiased=antialiased)
    plain, packed = (RendererCpu(floor_cloud(), options) for _ in range(2))
    for frame in (0, 9, 31):
        pose = walking(frame, actor=actor)
        plain.name_cloud("one", pose())
        held = pose.pack()
        packed.name_packed("one", held)
        parts = []
        for k, at in enumerate(((0.0, 0.0), (0.6, 0.4), (-1.9, 0.1))):
            where = np.eye(4)
            where[:2, :2] = [[np.cos(k), -np.sin(k)], [np.sin(k), np.cos(k)]]
            where[:2, 3] = at
            parts.append(Instance("one", where, gain, 0.06))  # type: ignore[arg-type]
        assert draw(plain, parts) == draw(packed, parts), frame


def test_a_bank_draws_the_same_whether_a_pose_was_there_or_made_room_or_is_new() -> None:
    """Renderers of one cloud, and of many scenes."""
    actor = somebody()
    frames = [0, 5, 9, 5, 0, 22, 9, 0]
    size = len(actor.levels[0].pose())
    whole = []
    for budget in (8 << 20, 60 * size):
        renderer = build_renderer(floor_cloud(), "cpu")
        posed = open_posed(renderer, budget=budget)
        assert isinstance(posed, PosedBank) and posed.packed
        shown = []
        for frame in frames:
            (name,) = name_posed(posed, renderer, [(frame, walking(frame, actor=actor))])
            picture = renderer.render(CAMERA, VIEW[None], parts=[Instance(name, np.eye(4), TINT)])
            shown.append([picture.rgb.tobytes(), picture.depth.tobytes()])  # type: ignore[union-attr]
        assert (posed.hits, posed.misses) == ((4, 4) if budget == 8 << 20 else (0, 8))
        whole.append(shown)
    assert whole[0] == whole[1] and whole[0][0] == whole[0][4] != whole[0][1]
    renderer = build_renderer(floor_cloud(), "cpu")
    for frame, want in zip(frames, whole[0], strict=True):
        renderer.name_cloud("it", walking(frame, actor=actor)())
        picture = renderer.render(CAMERA, VIEW[None], parts=[Instance("it", np.eye(4), TINT)])
        assert [picture.rgb.tobytes(), picture.depth.tobytes()] == want  # type: ignore[union-attr]


def test_memory_of_a_full_bank_is_what_it_says(monkeypatch: pytest.MonkeyPatch) -> None:
    """Poses come and go through a small budget: all that grows is counted, in 60 bytes a splat."""
    actor = somebody()
    renderer = RendererCpu(floor_cloud())
    bank = open_posed(renderer, budget=4 << 20)
    assert isinstance(bank, PosedBank)
    one = walking(0, actor=actor).pack()
    splats = len(one)
    assert one.nbytes == posed_bytes(one.rest.chunks, SHADOWS) <= 60 * splats
    name_posed(bank, renderer, [(-1, walking(0, actor=actor))])
    for frame in range(64):
        actor.posture(walking(frame).shown, walking(frame, actor=actor).turn)
    gc.collect()
    tracemalloc.start()
    try:
        for turn in range(3 * (4 << 20) // one.nbytes):
            name_posed(bank, renderer, [(turn, walking(turn % 64, actor=actor))])
        gc.collect()
        now, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert bank.bytes <= bank.budget < bank.bytes + 2 * one.nbytes
    assert len(bank) * one.nbytes == bank.bytes
    assert now < 1.05 * bank.budget + 2e5 and most < 1.05 * bank.budget + 2e5 + 4 * one.nbytes


def test_a_name_goes_with_its_cloud() -> None:
    """A renderer keeps no pose that nobody holds, and a name that was given on shows another."""
    renderer, actor = RendererCpu(floor_cloud()), somebody()
    held = walking(3, actor=actor).pack()
    renderer.name_packed("it", held)
    parts = [Instance("it", np.eye(4))]
    packed = draw(renderer, parts)
    renderer.name_cloud("it", walking(20, actor=actor)())
    assert draw(renderer, parts) != packed
    renderer.name_packed("it", held)
    assert draw(renderer, parts) == packed
    del held
    gc.collect()
    with pytest.raises(RenderError, match="no cloud is named"):
        renderer.render(CAMERA, VIEW, parts=parts)
    with pytest.raises(RenderError, match="not the name"):
        renderer.name_packed("", walking(3, actor=actor).pack())


def test_joints_are_placed_as_their_matrices_say() -> None:
    """The compiled way against the plain one, for poses from none to half turns."""
    person, stream = small_person(), np.random.default_rng(3)
    for size in (0.0, 1e-9, 1e-3, 0.4, 1.5, np.pi):
        pose = stream.normal(size=(55, 3))
        pose *= size / np.linalg.norm(pose, axis=1, keepdims=True)
        shift = stream.normal(size=3)
        transforms, joints = pose_joints(person.joints, pose, shift)
        found = person.place_joints(pose, shift)
        world = np.einsum("ab,jbc->jac", TO_WORLD, transforms)
        np.testing.assert_allclose(found.transforms, world, atol=1e-13)
        np.testing.assert_allclose(found.joints, joints, atol=1e-13)
        turns = quaternion_from_rotation(world[:, :, :3])
        np.testing.assert_allclose(np.abs((found.turns * turns).sum(axis=1)), 1.0, atol=1e-13)
        assert (found.turns[:, 0] >= 0).all()
        np.testing.assert_allclose(
            rotation_from_quaternion(found.turns), world[:, :, :3], atol=1e-12
        )
    with pytest.raises(DataError, match="not finite"):
        person.place_joints(None, np.array([0.0, np.inf, 0.0]))
    with pytest.raises(DataError, match="expected"):
        person.place_joints(np.zeros((3, 3)))


def test_joints_are_placed_once_for_all_levels(monkeypatch: pytest.MonkeyPatch) -> None:
    actor, turns = somebody(), []
    turn = PoseShown.turn
    monkeypatch.setattr(PoseShown, "turn", lambda self: turns.append(self) or turn(self))
    first = [walking(8, level, actor).pack() for level in range(len(SHARES))]
    assert len(turns) == 1
    walking(8, 2, actor)()
    assert len(turns) == 1
    for frame in range(9, 9 + 64):
        walking(frame, 0, actor).pack()
    again = walking(8, 0, actor).pack()
    assert len(turns) == 66, "those asked for long ago are forgotten"
    assert (again.cloud.pack == first[0].cloud.pack).all()


def test_a_person_that_cannot_be_packed_is_refused() -> None:
    person = small_person()
    broken = person.scales.copy()
    broken[5, 1] = np.nan
    bad = replace(person, scales=broken)
    with pytest.raises(RenderError, match="not finite"):
        bad.pose_packed(bad.place_joints())
