"""People at 2 m in generated rooms, beside the same pose traced from their textured meshes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from PIL import Image
from scipy.ndimage import binary_erosion, gaussian_filter

from gn0.avatars.detail import build_levels, choose_level
from gn0.avatars.identity import draw_people
from gn0.avatars.light import find_probes
from gn0.avatars.motion.legs import measure_build
from gn0.avatars.motion.library import ClipLibrary
from gn0.avatars.posed_bank import NEARER
from gn0.geometry import F64, view_from_pose
from gn0.render.camera import Camera
from gn0.render.cpu import RendererCpu
from gn0.render.instance import Instance
from gn0.render.renderer import RenderOptions
from gn0.scenes.procedural.kinds import KINDS, KindName
from gn0.seeds import random_stream
from gn0.testing.renderer_check import psnr
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least
from gn0_figures.people_light import LitScene, draw_places, light_scene
from gn0_figures.people_traced import MeshPerson, TracedPicture

SCENES: tuple[tuple[KindName, int], ...] = (
    ("apartment", 21), ("apartment", 34), ("corridor", 12), ("office", 5),
)  # fmt: skip
PEOPLE = 5  # a scene
SEED = 7
AWAY, EYE = 2.0, 1.25  # m
CAMERAS = {
    "480 x 360": Camera.from_vfov(480, 360, 70.0),
    "224 x 224": Camera.from_hfov(224, 224, 90.0),
}
POSES: tuple[tuple[str, float], ...] = (
    ("idle_1", 1.0), ("walk", 0.1), ("wave", 1.4), ("walk", 0.45), ("talk", 1.7),
)  # fmt: skip
_PIXEL = 0.5477  # standard deviation of a renderer's pixel, √0.3 px (Zwicker et al. 2001)
_CLEAR = 2.7  # m of free sight behind
_TRIES, _WAYS = 60, 8  # places, and ways to look at each


@dataclass(frozen=True, eq=False)
class _Pair:
    """A person traced, and ours, before the same room."""

    traced: F64
    ours: F64
    truth: TracedPicture
    opaque: F64


def measure_mesh(ctx: FigureContext) -> list[FigureRow]:
    """PSNR inside outlines, and a page of pairs in the work folder."""
    identities = draw_people(SEED, PEOPLE * len(SCENES))
    found: dict[str, list[_Pair]] = {name: [] for name in CAMERAS}
    for number, (kind, seed) in enumerate(SCENES):
        scene = light_scene(kind, seed, KINDS[kind].density)  # as dense as rooms are generated
        probes = find_probes(scene.cloud, scene.grid, cache=False)
        renderer = RendererCpu(scene.cloud, RenderOptions(rgb_float=True))
        spots = _find_spots(scene, renderer, seed)
        for k, (x, y, yaw, turn) in enumerate(spots):
            ctx.progress("people", PEOPLE * number + k, PEOPLE * len(SCENES))
            identity = identities[PEOPLE * number + k]
            mesh = MeshPerson.of(identity)
            person = mesh.avatar()
            library = ClipLibrary(measure_build(person.joints, person.points, person.weights), k)
            pose, shift = library.pose_at(*POSES[k], 0.9)
            levels = build_levels(person)
            place = np.eye(4)
            place[:2, :2] = (np.cos(turn), -np.sin(turn)), (np.sin(turn), np.cos(turn))
            place[:2, 3] = x + AWAY * np.cos(yaw), y + AWAY * np.sin(yaw)
            gain = probes.gain_at(float(place[0, 3]), float(place[1, 3]))
            for name, camera in CAMERAS.items():
                level = levels[choose_level(AWAY, camera.fx)]
                renderer.name_cloud("person", level.pose(pose, shift, shadow=False))
                view = view_from_pose(x, y, EYE, yaw)[None]
                room = renderer.render(camera, view)
                instance = Instance("person", place, gain, NEARER)
                drawn = renderer.render(camera, view, parts=[instance])
                alone = RendererCpu(level.pose(pose, shift, shadow=False)).render(
                    camera, view @ place
                )
                assert room.rgb is not None and drawn.rgb is not None and alone.alpha is not None
                truth = mesh.trace(
                    camera, view[0], place, pose, shift, gain.astype(np.float64),
                    samples=4 if name == "480 x 360" else 6,
                )  # fmt: skip
                behind = np.clip(room.rgb[0].astype(np.float64), 0.0, 1.0)
                found[name].append(
                    _Pair(
                        truth.rgb + (1.0 - truth.alpha[..., None]) * behind,
                        np.clip(drawn.rgb[0].astype(np.float64), 0.0, 1.0),
                        truth,
                        alone.alpha[0].astype(np.float64),
                    )
                )
    _write_page(ctx, found["480 x 360"])
    return [row for name, pairs in found.items() for row in _rows(name, pairs)]


def _rows(name: str, pairs: list[_Pair]) -> list[FigureRow]:
    whole, inner, alike, area = [], [], [], []
    for pair in pairs:
        inside = pair.truth.alpha > 0.5
        deep = binary_erosion(pair.truth.alpha > 0.999)
        soft = gaussian_filter(pair.traced, (_PIXEL, _PIXEL, 0.0))
        whole.append(psnr(pair.ours[inside], pair.traced[inside]))
        inner.append(psnr(pair.ours[deep], pair.traced[deep]))
        alike.append(psnr(pair.ours[inside], soft[inside]))
        area.append(float((pair.opaque > 0.5).sum() / inside.sum()))
    detail = f"{len(pairs)} people at {AWAY} m in four generated rooms, light of the probes in "
    detail += "both; 16 rays a pixel and more; at the level of detail chosen there. "
    more = detail + f"Each: {', '.join(f'{value:.1f}' for value in sorted(whole))} dB; "
    more += f"area {np.median(area):.2f} of the traced; a pixel inside of the edges "
    more += f"{np.median(inner):.1f} dB (median)"
    middle = float(np.median(whole))
    return [
        row_at_least(f"person against traced mesh, {name}, median", middle, 28, "dB", more)
        if name == "480 x 360"
        else _plain(f"person against traced mesh, {name}, median", middle, more),
        _plain(f"the same, worst, {name}", min(whole), detail),
        _plain(
            f"the same, median, {name}, seen through the renderer's pixel", float(np.median(alike)),
            detail + "the traced picture blurred by √0.3 px, as a renderer of splats does",
        ),
    ]  # fmt: skip


def _find_spots(
    scene: LitScene, renderer: RendererCpu, seed: int
) -> list[tuple[float, float, float, float]]:
    """Places and yaws of eyes with free sight, and how the person before each is turned."""
    stream = random_stream(seed, "people beside their meshes")
    camera = Camera.from_vfov(120, 90, 70.0)
    spots: list[tuple[float, float, float, float]] = []
    # in a corridor few ways are free: other ways are tried where somebody may stand
    for x, y in np.tile(draw_places(scene.grid, _TRIES, seed), (_WAYS, 1)):
        yaw = float(stream.uniform(-np.pi, np.pi))
        turn = yaw + np.pi + float(stream.uniform(-1.0, 1.0)) * (2.5 if len(spots) % 3 == 2 else 1)
        seen = renderer.render(camera, view_from_pose(x, y, EYE, yaw)[None], outputs=("depth",))
        assert seen.depth is not None
        # down to the shoes: the traced person is laid over the room, furniture before it too
        before = seen.depth[0, 15:86, 40:80]
        if np.nanmin(np.where(np.isfinite(before), before, np.inf)) > _CLEAR - 0.9 and (
            np.nanmedian(before[:40]) > _CLEAR
        ):
            spots.append((float(x), float(y), yaw, turn))
        if len(spots) == PEOPLE:
            break
    return spots


def _write_page(ctx: FigureContext, pairs: list[_Pair]) -> None:
    """All pairs side by side, traced on the left: `people_traced.png` in the work folder."""
    cells = []
    for pair in pairs:
        rows, columns = np.nonzero(pair.truth.alpha > 0.0)
        top, middle = max(int(rows.min()) - 6, 0), int(columns.mean())
        left = min(max(middle - 60, 0), pair.ours.shape[1] - 120)
        cut = [p[top : top + 250, left : left + 120] for p in (pair.traced, pair.ours)]
        cell = np.ones((254, 248, 3))
        cell[: len(cut[0]), :120], cell[: len(cut[1]), 122:242] = cut
        cells.append(cell)
    lines = [np.concatenate(cells[k : k + PEOPLE], axis=1) for k in range(0, len(cells), PEOPLE)]
    page = (255.0 * np.concatenate(lines) + 0.5).astype(np.uint8)
    ctx.work.mkdir(parents=True, exist_ok=True)
    Image.fromarray(page).save(ctx.work / "people_traced.png")


def _plain(name: str, value: float, detail: str) -> FigureRow:
    return FigureRow(name=name, value=value, unit="dB", detail=detail)


FIGURES = [Figure("avatars.mesh", "People beside their traced meshes", measure_mesh, 15.0)]
