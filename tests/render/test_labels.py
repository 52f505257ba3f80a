"""Labels of pictures: the object of the greatest summed weight, by judges that share no code."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from gn0.errors import RenderError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import view_from_pose
from gn0.render import cpu_labels
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.cuda.request import check_picture
from gn0.render.host import RendererHost
from gn0.render.instance import Instance
from gn0.render.labels import OBJECTS_MAX, colour_labels, encode_labels, refuse_labels
from gn0.render.open import build_renderer, open_renderer
from gn0.render.renderer import VISIBLE_BACKENDS, RenderOptions
from gn0.scenes.procedural.finish import cover_outlined, floor_area, light_draft
from gn0.scenes.procedural.kinds import KINDS
from gn0.scenes.rays import RayCaster
from gn0.scenes.scene import Scene
from gn0.sim.presets import find_preset
from gn0.testing.reference import find_labels
from gn0.testing.renderer_check import random_cloud
from gn0.testing.scenes import build_labelled_scene

CAMERA = Camera.from_hfov(40, 30, 80.0)
VIEW = view_from_pose(1.0, 1.0, 1.3, 0.6)
BOTH = ("semantic", "instance")


def labelled(count: int = 400, objects: int = 60, seed: int = 3) -> GaussianCloud:
    """Splats in sight of many objects, some of none; categories of seven."""
    rng = np.random.default_rng(seed)
    cloud = random_cloud(count, seed=seed)
    label = rng.integers(-1, objects, count).astype(np.int32)
    return replace(cloud, label=label, categories=(np.arange(objects) % 7 + 1).astype(np.int32))


def views_of(cloud: GaussianCloud) -> np.ndarray:
    """Where most splats are in sight."""
    away = np.eye(4)
    away[:3, 3] = -cloud.means.mean(axis=0) + (0, 0, 3)
    return away[None]


def test_a_pixel_shows_the_object_of_the_greatest_summed_weight() -> None:
    cloud = labelled()
    (view,) = views_of(cloud)
    got = RendererCpu(cloud).render(CAMERA, view, outputs=BOTH)
    want, lead = find_labels(cloud, CAMERA, view)
    clear = lead > 1e-4  # else rounding decides
    assert clear.mean() > 0.95 and len(np.unique(want)) > 20
    assert (got.instance[0][clear] == np.maximum(want[clear] + 1, 0)).all()
    assert cloud.categories is not None
    of = np.where(want < 0, 0, cloud.categories[np.maximum(want, 0)])
    assert (got.semantic[0][clear] == of[clear]).all()
    assert got.rgb is None and got.depth is None


def test_colours_and_depth_are_the_same_with_labels_and_without() -> None:
    cloud = labelled()
    view = views_of(cloud)
    renderer = RendererCpu(cloud)
    plain = renderer.render(CAMERA, view)
    both = renderer.render(CAMERA, view, outputs=("rgb", "depth", "alpha", *BOTH))
    alone = renderer.render(CAMERA, view, outputs=("instance",))
    for name in ("rgb", "depth", "alpha"):
        assert getattr(both, name).tobytes() == getattr(plain, name).tobytes()
    assert both.instance.tobytes() == alone.instance.tobytes()
    assert plain.instance is None and alone.semantic is None


@pytest.mark.parametrize("slots", [2, 8, 1024])
def test_neither_threads_nor_room_for_labels_can_show(slots: int) -> None:
    cloud = labelled(2000, 60 if slots == 2 else 700)  # as many turns as numbers need
    view = views_of(cloud)
    want = RendererCpu(cloud, RenderOptions(threads=1)).render(CAMERA, view, outputs=BOTH)
    renderer = RendererCpu(cloud, RenderOptions(threads=2))
    renderer.label_slots = slots
    got = renderer.render(CAMERA, view, outputs=BOTH)
    assert got.instance.tobytes() == want.instance.tobytes()
    assert got.semantic.tobytes() == want.semantic.tobytes()


def test_what_moves_carries_labels_of_its_own() -> None:
    cloud = labelled()
    view = views_of(cloud)
    part = replace(random_cloud(80, seed=9), label=np.full(80, 900, np.int32))
    part = replace(part, categories=np.full(901, 5, np.int32))
    pose = np.linalg.inv(view[0]) @ np.array(
        [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1.5], [0, 0, 0, 1.0]]
    )
    pose[:3, 3] -= pose[:3, :3] @ part.means.mean(axis=0)
    renderer = RendererCpu(cloud)
    renderer.name_cloud("body", part)
    seen = renderer.render(CAMERA, view, parts=[Instance("body", pose)], outputs=BOTH)
    shows = seen.instance == 901
    assert shows.any() and (seen.semantic[shows] == 5).all()
    unlabelled = replace(part, label=None, categories=None)
    renderer.name_cloud("plain", unlabelled)
    seen = renderer.render(CAMERA, view, parts=[Instance("plain", pose)], outputs=BOTH)
    assert (seen.instance[shows] == 0).mean() > 0.9


def test_each_single_splat_that_moves_shows_its_own_label() -> None:
    """Numbers run on from the scene's splats: the first that moves is not the scene's last."""
    cloud = labelled()
    view = views_of(cloud)
    pose = np.linalg.inv(view[0])
    pose[:3, 3] += pose[:3, :3] @ (0.0, 0.0, 1.0)
    one = replace(
        cloud.select(np.arange(1)),
        means=np.zeros((1, 3), np.float32),
        scales=np.full((1, 3), 0.3, np.float32),
        opacities=np.full(1, 0.99, np.float32),
        label=np.array([900], np.int32),
        categories=np.full(901, 5, np.int32),
    )
    renderer = RendererCpu(cloud)
    renderer.name_cloud("dot", one)
    seen = renderer.render(CAMERA, view, parts=[Instance("dot", pose)], outputs=BOTH)
    assert seen.instance is not None and seen.semantic is not None
    assert (seen.instance[0, 13:17, 18:22] == 901).all()
    assert (seen.semantic[0, 13:17, 18:22] == 5).all()


@pytest.mark.parametrize(("first", "shown"), [((5, 2), 9), ((2, 5), 7)])
def test_of_labels_that_weigh_the_same_the_nearer_shows(
    monkeypatch: pytest.MonkeyPatch, first: tuple[int, int], shown: int
) -> None:
    """Weights alike to the last bit: whose first splat came first, in whatever order they stand."""

    def weigh(*given: object) -> int:
        sums, firsts, known, _ = given[-4:]
        assert isinstance(sums, np.ndarray) and isinstance(firsts, np.ndarray)
        assert isinstance(known, np.ndarray)
        sums[:], firsts[:], known[:] = 0.0, 2**31 - 1, (7, 9)
        side = len(sums) // 2
        sums[[0, side]], firsts[[0, side]] = 0.25, first
        return 2

    monkeypatch.setattr(cpu_labels, "_sum_tile", weigh)
    none, tile = np.zeros(0, np.int64), cpu_labels.TILE
    out = np.zeros((tile, tile), np.uint32)
    cpu_labels.label_tiles.py_func(
        none, none, none, np.zeros(2, np.int64), none, none, none, none, np.zeros(1, np.int64),
        1, tile, tile, True, none, none, 0, 2, out,
    )  # fmt: skip
    assert out[0, 0] == shown and not out[1:].any()


def test_pieces_of_a_scene_show_the_labels_of_the_whole() -> None:
    scene = build_labelled_scene()
    camera = Camera.from_hfov(64, 48, 90.0)
    views = np.stack([view_from_pose(1.5, 1.5, 1.3, yaw) for yaw in (0.0, 2.0, 4.0)])
    whole = build_renderer(scene.gaussians, "cpu").render(camera, views, outputs=BOTH)
    numbers = set(np.unique(whole.instance).tolist()) - {0}
    assert numbers and max(numbers) <= len(scene.objects)
    for number in numbers:
        kind = np.unique(whole.semantic[whole.instance == number])
        assert [scene.categories[int(k)] for k in kind] == [scene.objects[number - 1].category]


def test_a_renderer_or_a_scene_without_labels_says_so() -> None:
    plain = random_cloud(50, seed=1)
    with pytest.raises(RenderError, match="carry no labels"):
        RendererCpu(plain).render(CAMERA, VIEW, outputs=("instance",))
    numbered = replace(plain, label=np.zeros(50, np.int32))
    RendererCpu(numbered).render(CAMERA, VIEW, outputs=("instance",))
    with pytest.raises(RenderError, match="categories of the scene"):
        RendererCpu(numbered).render(CAMERA, VIEW, outputs=("semantic",))
    with pytest.raises(RenderError, match="unknown output 'normals'"):
        RendererCpu(numbered).render(CAMERA, VIEW, outputs=("normals",))  # type: ignore[arg-type]
    host = RendererHost("mine", lambda cloud, options: RendererCpu(cloud, options))
    host.add("scene", labelled())
    assert not host.traits.labels and open_renderer("cpu").traits.labels
    with pytest.raises(RenderError, match="'mine' does not draw 'semantic'"):
        host.draw(["scene"], CAMERA, VIEW[None], outputs=("semantic",))


def test_who_is_refused_labels_is_sent_to_backends_that_draw_them() -> None:
    with pytest.raises(RenderError, match="'mine' does not draw 'instance'") as caught:
        refuse_labels(("rgb", "instance"), "mine")
    named = re.findall("'([^']+)'", caught.value.remedy)
    assert set(named) == {"cpu", "cuda"} == set(VISIBLE_BACKENDS.values())
    check_picture(("rgb", "instance"), (0, 0, 0))  # of a device


def test_numbers_that_no_picture_can_hold_are_refused() -> None:
    with pytest.raises(RenderError, match="belongs to object"):
        encode_labels(np.array([OBJECTS_MAX + 1], np.int32), None)
    for wrong in (-1, 5000):
        with pytest.raises(RenderError, match="out of range"):
            encode_labels(np.zeros(1, np.int32), np.array([wrong], np.int32))


def test_false_colours_tell_neighbours_apart_and_nothing_is_black() -> None:
    colours = colour_labels(np.arange(200))
    assert (colours[0] == 0).all() and len(np.unique(colours[1:], axis=0)) > 180
    apart = np.abs(np.diff(colours[1:].astype(int), axis=0)).sum(axis=1)
    assert apart.min() > 60


@pytest.mark.slow
def test_a_generated_flat_shows_what_a_ray_meets() -> None:
    """A ray through each pixel's centre, against the mesh that the splats cover.

    97 % are not reached: splats are wider than edges are sharp, and what hangs flat on a wall
    (pictures, mirrors) sinks into it where it is seen from the side, in colour as well.
    """
    draft = KINDS["apartment"].draft(4, size="small", style=None)
    shader = light_draft(draft, quality="draft", seed=4)
    count = int(KINDS["apartment"].density * floor_area(draft))
    cloud, _ = cover_outlined(draft, shader, count, seed=4)
    caster = RayCaster(draft.mesh)
    camera = find_preset("gn_bench").rgb
    renderer = RendererCpu(cloud)
    flat = {n for n, o in enumerate(draft.objects, 1) if o.category in ("picture", "mirror")}
    column, row = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    across, down = (column - camera.cx) / camera.fx, (row - camera.cy) / camera.fy
    equal, others = [], []
    for room in draft.rooms:
        x, y = np.array(room.polygon).mean(axis=0)
        for yaw in (0.3, 2.4, 4.5):
            view = view_from_pose(float(x), float(y), 1.3, yaw)
            got = renderer.render(camera, view, outputs=("instance",)).instance
            assert got is not None
            ray = np.stack([across, down, np.ones_like(down)], -1).reshape(-1, 3) @ view[:3, :3]
            eye = np.broadcast_to(-view[:3, :3].T @ view[:3, 3], ray.shape)
            face, _, _ = caster.cast(eye, ray)
            met = np.where(face >= 0, draft.mesh.instance[np.maximum(face, 0)] + 1, 0)
            same = got.ravel() == met
            equal.append(same.mean())
            others.append(same[~np.isin(met, list(flat))].mean())
    assert np.mean(equal) >= 0.95, np.mean(equal)
    assert np.mean(others) >= 0.965, np.mean(others)


def test_a_scene_numbers_its_categories_by_name() -> None:
    scene: Scene = build_labelled_scene()
    assert scene.categories[0] == "unlabelled"
    assert list(scene.categories[1:]) == sorted({o.category for o in scene.objects})
    assert scene.gaussians.categories is not None
    for thing, number in zip(scene.objects, scene.gaussians.categories.tolist(), strict=True):
        assert scene.categories[number] == thing.category
