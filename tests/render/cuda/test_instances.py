"""Instances in the drawing kernels, in the host emulation: as if their splats had been moved."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

from gn0.device.host import DeviceHost
from gn0.errors import RenderError
from gn0.gaussians.cloud import GaussianCloud, join_clouds
from gn0.geometry import F32, F64, view_from_above
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.cuda.cloud import CloudDevice
from gn0.render.cuda.draw import Drawer
from gn0.render.cuda.instances import NO_PART, Instances, pack_normals
from gn0.render.cuda.pack import prepare_cloud, upload_cloud
from gn0.render.cuda.tune import Tuning
from gn0.render.instance import PARTS_MAX, Instance, find_normals, move_instance
from gn0.render.renderer import RenderOptions
from gn0.testing.renderer_check import psnr, random_cloud
from gn0_figures.flat import build_flat, flat_camera, flat_views
from gn0_figures.moving import GAIN, build_ball, pose_ahead

pytestmark = pytest.mark.skipif(not shutil.which("g++"), reason="the host emulation needs g++")

EXACT = RenderOptions(rgb_float=True)
BLACK = np.zeros(3, np.float32)
OUTPUTS = ("rgb", "depth", "alpha")
CAMERA, VIEWS = flat_camera(48, 36), flat_views(4)


def stand(count: int, views: F64, clouds: int, *, stream: int = 0) -> tuple[F64, F32, F32]:
    """Poses, gains and cloud numbers of instances before some views, `count` of each."""
    rng = np.random.default_rng(stream)
    poses = np.stack(
        [
            pose_ahead(v, rng.uniform(0.8, 2.5), rng.uniform(-0.7, 0.7), rng.uniform(0, 6))
            for v in views
            for _ in range(count)
        ]
    )
    gains = (GAIN * rng.uniform(0.5, 1.5, (len(poses), 4, 1))).astype(np.float32)
    return poses, gains, rng.integers(0, clouds, len(poses)).astype(np.int32)


def bring(device: DeviceHost, clouds: list[GaussianCloud]) -> list[CloudDevice]:
    return [upload_cloud(device, prepare_cloud(cloud, part=True)) for cloud in clouds]


def draw(
    drawer: Drawer,
    scene: GaussianCloud,
    instances: Instances | None,
    *,
    views: F64 = VIEWS,
    camera: Camera = CAMERA,
    there: bool = False,
    tails: list[GaussianCloud] | None = None,
    antialiased: bool = False,
) -> tuple[F32, F32, F32]:
    """Colours, depth and alpha; with poses `there` on the device, or on the host."""
    device = drawer.device
    count = len(views)
    pictures = drawer.pictures(camera, count, OUTPUTS, rgb_float=True)
    shown = np.zeros(count, np.int32)
    more = {}
    if tails:
        packed = [upload_cloud(device, tail, sort=False) for tail in tails]
        more = {"tails": packed, "tail_of": np.arange(count, dtype=np.int32) % len(tails)}
    drawer.draw(
        camera, device.upload(views) if there else views, [upload_cloud(device, scene)],
        device.upload(shown) if there else shown, instances=instances, pictures=pictures,
        background=BLACK, antialiased=antialiased, **more,
    )  # fmt: skip
    got = pictures.numpy()
    return got.rgb, got.depth, got.alpha


def as_bytes(got: tuple[F32, F32, F32]) -> list[bytes]:
    return [array.tobytes() for array in got if array is not None]


def moved(clouds: list[GaussianCloud], instances: Instances, v: int) -> GaussianCloud | None:
    """The splats of a view's instances, where they stand."""
    first, last = instances.firsts[v], instances.firsts[v + 1]
    parts = [
        move_instance(
            clouds[instances.chosen[i]],
            Instance(
                "", instances.poses[i], None if instances.gains is None else instances.gains[i]
            ),
        )
        for i in range(first, last)
        if instances.chosen[i] != NO_PART
    ]
    return join_clouds(parts) if parts else None


@pytest.mark.parametrize("degree", [0, 3])
@pytest.mark.parametrize("lit", [False, True])
def test_an_instance_looks_as_if_its_splats_had_been_moved(degree: int, lit: bool) -> None:
    scene = build_flat(4000, sh_degree=degree)
    clouds = [build_ball(400, 1, sh_degree=degree), random_cloud(300, seed=2, sh_degree=degree)]
    poses, gains, _ = stand(2, VIEWS, 2)
    chosen = np.array([0, 1, 1, 0, 0, 0, 1, NO_PART], np.int32)
    firsts = np.array([0, 2, 5, 5, 8], np.int32)
    device = DeviceHost()
    instances = Instances(bring(device, clouds), poses, chosen, firsts, gains if lit else None)
    rgb, depth, alpha = draw(Drawer(device), scene, instances)
    cpu = RendererCpu(scene, EXACT)
    for v in range(len(VIEWS)):
        want = cpu.render(CAMERA, VIEWS[v], extra=moved(clouds, instances, v))
        assert psnr(rgb[v], want.rgb[0]) >= 75
        assert psnr(alpha[v], want.alpha[0]) >= 75
        both = np.isfinite(depth[v]) & np.isfinite(want.depth[0])
        assert np.quantile(abs(depth[v] - want.depth[0])[both], 0.99) <= 1e-4
    bare = cpu.render(CAMERA, VIEWS[:1])
    assert psnr(rgb[0], bare.rgb[0]) < 40, "they are seen at all"


CLOUDS = [build_ball(300, 1), random_cloud(200, seed=2, sh_degree=1)]
SCENE = build_flat(2500)
POSES, GAINS, CHOSEN = stand(2, VIEWS, 2, stream=3)
SOME = Instances((), POSES, CHOSEN, np.array([0, 1, 1, 5, 8], np.int32), GAINS)


def placed(device: DeviceHost, instances: Instances = SOME) -> Instances:
    return replace(instances, clouds=bring(device, CLOUDS))


@pytest.fixture(scope="module")
def want() -> list[bytes]:
    device = DeviceHost()
    return as_bytes(draw(Drawer(device), SCENE, placed(device)))


@pytest.mark.parametrize("seed", [1, 2])
def test_views_and_instances_on_the_device_give_the_same_bytes(
    want: list[bytes], seed: int
) -> None:
    device = DeviceHost(seed)
    assert as_bytes(draw(Drawer(device), SCENE, placed(device), there=True)) == want
    assert as_bytes(draw(Drawer(device), SCENE, placed(device))) == want


TUNINGS = [
    Tuning(capacity=128, buckets=128, stage=32, views=2, large=2, spread=4, split=7),
    Tuning(threads=256, buckets=256, capacity=256, stage=64, large=0, chunks=1, split=500),
]


@pytest.mark.parametrize("tuning", TUNINGS, ids=range(2))
def test_sizes_of_kernels_and_quarters_of_tiles_cannot_show(
    want: list[bytes], tuning: Tuning
) -> None:
    device = DeviceHost(seed=3)
    drawer = Drawer(device, tuning)
    for _ in range(2):  # the second knows how long lists are
        assert as_bytes(draw(drawer, SCENE, placed(device), there=True)) == want
    assert "aside" in drawer._held


def test_batches_and_lists_that_overflow_cannot_show(want: list[bytes]) -> None:
    device = DeviceHost()
    for there in (False, True):
        small = Drawer(device, memory=40_000)
        assert as_bytes(draw(small, SCENE, placed(device), there=there)) == want
        assert small.batches > 2
        short = Drawer(device)
        short._first_density = 0.0
        short._held["entries"] = device.empty(16, np.uint64)
        assert as_bytes(draw(short, SCENE, placed(device), there=there)) == want
        assert short.repeats >= 1


def test_a_view_alone_is_drawn_as_among_others(want: list[bytes]) -> None:
    device = DeviceHost()
    whole = [np.frombuffer(one, np.float32).reshape(4, 36, 48, -1) for one in want]
    firsts = SOME.firsts
    for v in range(4):
        mine = slice(firsts[v], firsts[v + 1])
        one = Instances(
            bring(device, CLOUDS), POSES[mine], CHOSEN[mine],
            np.array([0, firsts[v + 1] - firsts[v]], np.int32), GAINS[mine],
        )  # fmt: skip
        got = draw(Drawer(device), SCENE, one, views=VIEWS[v : v + 1])
        assert as_bytes(got) == [array[v].tobytes() for array in whole]


def test_as_many_of_each_view_need_no_offsets(want: list[bytes]) -> None:
    """Those that a view has not are nobody."""
    device, each = DeviceHost(), 4
    poses, chosen = np.full((16, 4, 4), np.nan), np.full(16, NO_PART, np.int32)
    gains = np.full((16, 4, 3), np.inf, np.float32)
    for v in range(4):
        for k, i in enumerate(range(SOME.firsts[v], SOME.firsts[v + 1])):
            poses[v * each + k], chosen[v * each + k], gains[v * each + k] = (
                *(POSES[i], CHOSEN[i], GAINS[i]),
            )
    instances = placed(device, Instances((), poses, chosen, each, gains))
    assert as_bytes(draw(Drawer(device), SCENE, instances, there=True)) == want
    known = replace(instances, poses=np.nan_to_num(poses), gains=np.nan_to_num(gains))
    assert as_bytes(draw(Drawer(device), SCENE, known)) == want


def record(drawer: Drawer, scene: CloudDevice, instances: Instances):
    """A recorded call of all `VIEWS`."""
    return drawer.record(CAMERA, len(VIEWS), [scene], None, instances=instances)


@pytest.mark.parametrize("lit", [True, False])
def test_a_recorded_call_takes_other_poses(want: list[bytes], lit: bool) -> None:
    device = DeviceHost()
    drawer, scene = Drawer(device), upload_cloud(device, SCENE)
    instances = placed(device)
    if not lit:
        instances = replace(instances, gains=None)
        want = as_bytes(draw(drawer, SCENE, instances))
    draw(drawer, SCENE, instances)  # makes room
    replay = record(drawer, scene, instances)
    assert replay is not None
    pictures = drawer.pictures(CAMERA, 4, OUTPUTS, rgb_float=True)
    gains = GAINS if lit else None
    assert replay.draw(VIEWS, pictures, BLACK, POSES, gains) is not None
    assert as_bytes(vars(pictures.numpy()).values()) == want
    others = POSES[::-1].copy()
    assert replay.draw(VIEWS, pictures, BLACK, others, gains) is not None
    again = draw(Drawer(device), SCENE, replace(instances, poses=others))
    assert as_bytes(vars(pictures.numpy()).values()) == as_bytes(again)
    broken = POSES.copy()
    broken[3, 0, 0] = np.nan
    with pytest.raises(RenderError, match=r"instance 3: .*not finite"):
        replay.draw(VIEWS, pictures, BLACK, broken, gains)


def test_no_instances_are_no_instances() -> None:
    """The same kernels, the same bytes."""
    device = DeviceHost()
    nobody = Instances((), np.zeros((0, 4, 4)), np.zeros(0, np.int32), 0)
    for there in (False, True):
        drawer = Drawer(device)
        plain = draw(drawer, SCENE, None, there=there)
        assert as_bytes(draw(drawer, SCENE, nobody, there=there)) == as_bytes(plain)
        assert not any(parts for _, parts in drawer._loaded)


@pytest.mark.parametrize("there", [False, True])
def test_an_instance_that_no_view_sees_changes_nothing(there: bool) -> None:
    device = DeviceHost()
    far = np.tile(np.eye(4), (8, 1, 1))
    far[:, :3, 3] = (0, 0, 500)
    unseen = placed(device, Instances((), far, CHOSEN, 2, GAINS))
    got = draw(Drawer(device), SCENE, unseen, there=there)
    assert as_bytes(got) == as_bytes(draw(Drawer(device), SCENE, None))


def plane(count: int, seed: int) -> GaussianCloud:
    """Splats whose centres lie in one plane, each of another colour."""
    stream = np.random.default_rng(seed)
    means = np.column_stack([stream.uniform(-2, 2, (count, 2)), np.zeros(count)])
    scales = np.column_stack([stream.uniform(0.05, 0.3, (count, 2)), np.full(count, 1e-3)])
    quats = np.tile([1.0, 0, 0, 0], (count, 1))
    arrays = (means, quats, scales, stream.uniform(0.1, 0.5, count),
              stream.uniform(-1.7, 1.7, (count, 1, 3)))  # fmt: skip
    return GaussianCloud(*(a.astype(np.float32) for a in arrays))


@pytest.mark.parametrize("with_tail", [False, True])
def test_at_equal_depth_instances_come_last_in_their_order(with_tail: bool) -> None:
    """Scene, moving splats, instances as they are given: all in one plane, seen from above."""
    floor, tail, first, second = (plane(n, k) for k, n in enumerate((60, 60, 150, 90)))
    camera, view = Camera.orthographic(48, 48, 4.2 / 48, near=0.0), view_from_above(0, 0, 2.3)
    device = DeviceHost(seed=4)
    poses = np.tile(np.eye(4), (2, 1, 1))
    instances = Instances(
        bring(device, [first, second]), poses, np.array([1, 0], np.int32), 2, None
    )
    tails = [tail] if with_tail else None
    got = draw(Drawer(device), floor, instances, views=view[None], camera=camera, tails=tails)
    behind = [*(tails or []), second, first]
    want = RendererCpu(join_clouds([floor, *behind]), EXACT).render(camera, view)
    assert psnr(got[0], want.rgb) >= 80
    wrong = RendererCpu(join_clouds([floor, *behind[::-1]]), EXACT).render(camera, view)
    assert psnr(wrong.rgb, want.rgb) < 40


def test_the_last_number_of_an_instance_counts() -> None:
    """As many as keys can number in one view, two of them at one place: the later one is behind."""
    device = DeviceHost()
    cloud = plane(40, 1)
    camera, view = Camera.orthographic(32, 32, 4.2 / 32, near=0.0), view_from_above(0, 0, 2.3)
    poses = np.tile(np.eye(4), (PARTS_MAX, 1, 1))
    poses[:, 2, 3] = np.linspace(-1, 1, PARTS_MAX)
    poses[[5, PARTS_MAX - 1], 2, 3] = 1.5
    gains = np.zeros((PARTS_MAX, 4, 3), np.float32)
    gains[:, 0] = np.random.default_rng(0).uniform(0.2, 1, (PARTS_MAX, 3))
    instances = Instances(
        bring(device, [cloud]), poses, np.zeros(PARTS_MAX, np.int32),
        np.array([0, PARTS_MAX], np.int32), gains,
    )  # fmt: skip
    got = draw(Drawer(device), SCENE, instances, views=view[None], camera=camera)
    want = RendererCpu(SCENE, EXACT).render(camera, view, extra=moved([cloud], instances, 0))
    assert psnr(got[0], want.rgb) >= 75


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (lambda p, g, c, f: p.__setitem__((4, 1, 3), np.nan), "instance 4: .*not finite"),
        (lambda p, g, c, f: p.__setitem__((2, 0), 2 * p[2, 0]), "instance 2: .*not a rigid"),
        (lambda p, g, c, f: p.__setitem__((6, 0), -p[6, 0]), "instance 6: .*not a rigid"),
        (lambda p, g, c, f: g.__setitem__((5, 3, 2), np.inf), "instance 5: .*gain"),
        (lambda p, g, c, f: c.__setitem__(1, 2), "instance 1: .*of no cloud"),
        (lambda p, g, c, f: c.__setitem__(1, -2), "instance 1: .*of no cloud"),
        (lambda p, g, c, f: f.__setitem__(1, 7), "view 1: .*too many"),
        (lambda p, g, c, f: f.__setitem__(4, 9), "view 3: .*too many"),
        (lambda p, g, c, f: f.__setitem__(0, -3), "view 0: .*too many"),
        (lambda p, g, c, f: f.__setitem__(3, 2**31 - 1), "view 2: .*too many"),
    ],
)
def test_an_instance_that_is_none_is_told(change, match: str, want: list[bytes]) -> None:
    arrays = [a.copy() for a in (POSES, GAINS, CHOSEN, SOME.firsts)]
    change(*arrays)
    device = DeviceHost()
    poses, gains, chosen, firsts = map(device.upload, arrays)
    drawer = Drawer(device)
    broken = placed(device, Instances((), poses, chosen, firsts, gains))
    with pytest.raises(RenderError, match=match):
        draw(drawer, SCENE, broken, there=True)
    assert as_bytes(draw(drawer, SCENE, placed(device), there=True)) == want


def test_a_view_that_is_none_is_told_before_its_instances() -> None:
    views, device = VIEWS.copy(), DeviceHost()
    views[2, 0, 0] = np.nan
    with pytest.raises(RenderError, match=r"view 2: .*not finite"):
        draw(Drawer(device), SCENE, placed(device), views=views, there=True)


def test_more_than_keys_can_number_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    device = DeviceHost()
    many = PARTS_MAX + 1
    crowd = Instances(
        (), np.tile(np.eye(4), (many, 1, 1)), np.zeros(many, np.int32),
        np.array([0, 0, many, many, many], np.int32),
    )  # fmt: skip
    for there in (False, True):
        with pytest.raises(RenderError, match="view 1"):
            draw(Drawer(device), SCENE, placed(device, crowd), there=there)
    too_few = replace(crowd, firsts=3)
    with pytest.raises(RenderError, match="do not belong"):
        draw(Drawer(device), SCENE, placed(device, too_few))
    plain = replace(SOME, clouds=[upload_cloud(device, cloud) for cloud in CLOUDS])
    with pytest.raises(RenderError, match="without normals"):
        draw(Drawer(device), SCENE, plain)
    monkeypatch.setattr("gn0.render.cuda.pack.PART_SPLATS_MAX", 100)
    with pytest.raises(RenderError, match="a part of 300 splats"):
        bring(device, CLOUDS)
    monkeypatch.setattr("gn0.render.cuda.instances.PART_SPLATS_MAX", 250)
    with pytest.raises(RenderError, match="an instance of 300 splats"):
        draw(Drawer(device), SCENE, replace(plain, gains=None))
    monkeypatch.setattr("gn0.render.cuda.instances.PART_SPLATS_MAX", 300)
    monkeypatch.setattr("gn0.render.cuda.work.BEFORE_TAILS", 2000)
    with pytest.raises(RenderError, match="at most 2,000"):
        draw(Drawer(device), SCENE, replace(plain, gains=None), tails=[plane(9, 1)])


NEARER = np.random.default_rng(5).uniform(0.0, 0.8, len(POSES)).astype(np.float32)


@pytest.mark.parametrize("there", [False, True])
def test_what_is_sorted_as_if_nearer_is_as_on_the_cpu(want: list[bytes], there: bool) -> None:
    device = DeviceHost(seed=2)
    nearer = placed(device, replace(SOME, nearer=NEARER))
    got = draw(Drawer(device), SCENE, nearer, there=there)
    plain = np.frombuffer(want[0], np.float32).reshape(got[0].shape)
    assert psnr(got[0], plain) < 45, "it shows"
    cpu = RendererCpu(SCENE, EXACT)
    names = [f"cloud {k}" for k in range(2)]
    for name, cloud in zip(names, CLOUDS, strict=True):
        cpu.name_cloud(name, cloud)
    for v in range(4):
        mine = range(SOME.firsts[v], SOME.firsts[v + 1])
        parts = [
            Instance(names[CHOSEN[i]], POSES[i], GAINS[i], float(NEARER[i]))
            for i in mine
            if CHOSEN[i] != NO_PART
        ]
        drawn = cpu.render(CAMERA, VIEWS[v], parts=parts)
        assert psnr(got[0][v], drawn.rgb[0]) >= 75
        both = np.isfinite(got[1][v]) & np.isfinite(drawn.depth[0])
        assert np.quantile(abs(got[1][v] - drawn.depth[0])[both], 0.99) <= 1e-4


def test_nearer_by_nothing_is_the_same_bytes(want: list[bytes]) -> None:
    device = DeviceHost()
    nothing = placed(device, replace(SOME, nearer=np.zeros(len(POSES), np.float32)))
    for there in (False, True):
        assert as_bytes(draw(Drawer(device), SCENE, nothing, there=there)) == want


def test_a_recorded_call_keeps_what_is_nearer() -> None:
    device = DeviceHost()
    drawer, scene = Drawer(device), upload_cloud(device, SCENE)
    instances = placed(device, replace(SOME, nearer=NEARER))
    nearer = as_bytes(draw(drawer, SCENE, instances))
    replay = record(drawer, scene, instances)
    assert replay is not None
    pictures = drawer.pictures(CAMERA, 4, OUTPUTS, rgb_float=True)
    assert replay.draw(VIEWS, pictures, BLACK, POSES, GAINS) is not None
    assert as_bytes(vars(pictures.numpy()).values()) == nearer
    assert replace(instances, nearer=None).kind != instances.kind


@pytest.mark.parametrize("metres", [-0.1, np.nan, 1.5])
def test_nearer_by_no_distance_is_told(metres: float) -> None:
    device = DeviceHost()
    nearer = NEARER.copy()
    nearer[3] = metres
    arrays = (POSES, CHOSEN, SOME.firsts, GAINS, nearer)
    broken = placed(device, Instances((), *map(device.upload, arrays)))
    with pytest.raises(RenderError, match=r"instance 3: .*nearer by no distance"):
        draw(Drawer(device), SCENE, broken, there=True)
    with pytest.raises(RenderError, match=r"instance 3: .*nearer by no distance"):
        broken.fetch(4)


def test_normals_keep_their_direction() -> None:
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(500, 3))
    normals = np.concatenate([normals, np.eye(3), -np.eye(3), [[0, 1e-9, -1]]])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    word = pack_normals(normals.astype(np.float32))
    x, y = ((word >> s & 0xFFFF).astype(np.uint16).view(np.int16) / 32767 for s in (0, 16))
    z = 1 - abs(x) - abs(y)
    fold = np.maximum(-z, 0)
    found = np.stack([x - np.where(x < 0, -fold, fold), y - np.where(y < 0, -fold, fold), z], 1)
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    assert abs(found - normals).max() < 1e-4


def test_normals_lie_where_their_splats_do() -> None:
    """Morton order, splats that cannot show left out, and several clouds in one piece of memory."""
    device = DeviceHost()
    clouds = [random_cloud(n, seed=n) for n in (300, 40)]
    faint = clouds[0].opacities.copy()
    faint[::7] = 0.0
    clouds[0] = replace(clouds[0], opacities=faint)
    for cloud, packed in zip(clouds, bring(device, clouds), strict=True):
        assert packed.normals is not None
        order = packed.order.numpy()[: packed.alive]
        want = pack_normals(find_normals(cloud))[order]
        assert (packed.normals.numpy()[: packed.alive] == want).all()


@pytest.mark.parametrize("there", [False, True])
def test_no_thread_reads_what_another_may_be_writing(there: bool) -> None:
    device = DeviceHost(seed=2, checked=True)
    tuning = Tuning(capacity=128, buckets=128, stage=32, views=2, large=2)
    views = VIEWS[:2]
    instances = placed(
        device, Instances((), POSES[:3], CHOSEN[:3], np.array([0, 2, 3], np.int32), GAINS[:3])
    )
    scene = SCENE.select(slice(0, 700))
    got = draw(
        Drawer(device, tuning), scene, instances, views=views, camera=flat_camera(37, 20),
        there=there, antialiased=there, tails=None if there else [plane(50, 2)],
    )  # fmt: skip
    assert np.isfinite(got[2]).all()
