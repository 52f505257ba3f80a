"""Instructions: skeletons, texts against their routes, landmarks against a judge, bad servers."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gn0.errors import EpisodeError
from gn0.gaussians.cloud import GaussianCloud
from gn0.geometry import view_from_pose
from gn0.maps.navigation import NavigationMap
from gn0.missions.goal import sample_goal_episodes
from gn0.missions.language.describe import describe_route
from gn0.missions.language.grammar import count_phrases, held_out_phrases
from gn0.missions.language.providers import open_provider
from gn0.missions.language.route import STYLES, Landmark, RouteDescription
from gn0.missions.language.sight import EYE, HALF_WIDTH, sight_of
from gn0.missions.language.template import ProviderTemplate
from gn0.missions.language.text_check import check_text
from gn0.missions.language.write import write_texts
from gn0.render.camera import Camera
from gn0.render.open import build_renderer
from gn0.scenes.mesh import SceneMesh
from gn0.scenes.occupancy import build_occupancy
from gn0.scenes.procedural.generate import floor_area
from gn0.scenes.procedural.kinds import KINDS, KindName
from gn0.scenes.rays import RayCaster
from gn0.scenes.scene import Scene, SceneSourceInfo
from gn0.scenes.scene_sources import import_scene
from gn0.scenes.shading import SurfaceSample
from gn0.scenes.surfels import build_surfels
from gn0_figures.board import Figure, FigureContext, FigureRow, row_at_least, row_at_most
from gn0_trials.rogue_language import PASSING, ROGUES, serve_language
from gn0_trials.routes import build_simple_route

GENERATED: tuple[tuple[KindName, int], ...] = (("apartment", 7), ("office", 3), ("supermarket", 1))
ROUTES = 100  # a scene
SEEDS = 3  # texts of each style a route
DENSITY = 4000.0  # splats a m² of floor: what hides what does not depend on more
SHOWS = 0.002  # of the judge's picture: some ninety pixels of 240 × 180
JUDGE = (240, 180)  # px


@dataclass(frozen=True, eq=False)
class _Place:
    """A scene with its routes and a judge of what is seen."""

    name: str
    scene: Scene
    routes: list[RouteDescription]
    seconds: float  # a route, the first one left out
    seen: Callable[[Landmark], float]


class _PlainShader:
    """Grey everywhere: nobody looks at colours here."""

    def shade(self, face: NDArray[np.integer], bary: NDArray[np.floating]) -> SurfaceSample:
        grey = np.full((len(face), 3), 0.5, np.float32)
        return SurfaceSample(grey, grey, grey, np.zeros_like(grey))


def _generate(kind: KindName, seed: int) -> tuple[Scene, SceneMesh]:
    """A generated scene without light, and the triangles it is made of."""
    draft = KINDS[kind].draft(seed, size="small", style=None)
    cloud: GaussianCloud = build_surfels(
        draft.mesh,
        _PlainShader(),
        count=int(DENSITY * floor_area(draft)),
        seed=seed,
        oriented=True,
        label_of_instance=np.arange(len(draft.objects)),
    )
    corners = draft.mesh.vertices[np.unique(draft.mesh.faces)]
    scene = Scene(
        id=f"{kind}-{seed}",
        source=SceneSourceInfo(kind="procedural", seed=seed),
        grid=build_occupancy(draft.mesh),
        objects=draft.objects,
        rooms=draft.rooms,
        walls=draft.walls,
        openings=draft.openings,
        bounds=np.stack([corners.min(axis=0), corners.max(axis=0)]),
        load_cloud=lambda: cloud,
        cloud_hash="plain",
    )
    return scene, draft.mesh


def _judge_triangles(scene: Scene, mesh: SceneMesh) -> Callable[[Landmark], float]:
    """Share of a picture's rays that end on a landmark's own triangles."""
    caster = RayCaster(mesh)
    index = {thing.id: i for i, thing in enumerate(scene.objects)}
    camera = Camera.from_hfov(*JUDGE, 2 * HALF_WIDTH)
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    rays = np.stack([*np.meshgrid(x, y), np.ones((camera.height, camera.width))], -1).reshape(-1, 3)

    def seen(landmark: Landmark) -> float:
        px, py, yaw = landmark.seen_from
        view = view_from_pose(px, py, EYE, yaw)
        directions = rays @ view[:3, :3]
        origins = np.broadcast_to((px, py, EYE), directions.shape)
        face, _, _ = caster.cast(origins, directions)
        hit = mesh.instance[face[face >= 0]]
        return float((hit == index[landmark.object_id]).sum()) / len(rays)

    return seen


def _judge_pictures(scene: Scene) -> Callable[[Landmark], float]:
    """Share of a rendered depth picture's pixels that lie in a landmark's box."""
    renderer = build_renderer(scene.gaussians)
    camera = Camera.from_hfov(*JUDGE, 2 * HALF_WIDTH)
    boxes = {thing.id: thing.box for thing in scene.objects}
    x = (np.arange(camera.width) + 0.5 - camera.cx) / camera.fx
    y = (np.arange(camera.height) + 0.5 - camera.cy) / camera.fy
    rays = np.stack([*np.meshgrid(x, y), np.ones((camera.height, camera.width))], -1)

    def seen(landmark: Landmark) -> float:
        px, py, yaw = landmark.seen_from
        view = view_from_pose(px, py, EYE, yaw)
        depth = renderer.render(camera, view, outputs=("depth",)).depth
        assert depth is not None
        known = np.isfinite(depth[0])
        points = (rays * np.where(known, depth[0], 0.0)[..., None])[known] @ view[:3, :3]
        points += (px, py, EYE)
        box = boxes[landmark.object_id]
        c, s = np.cos(box.yaw), np.sin(box.yaw)
        d = points - np.array(box.centre)
        local = np.column_stack([d[:, :2] @ (c, s), d[:, :2] @ (-s, c), d[:, 2]])
        inside = (np.abs(local) <= np.array(box.size) / 2 + 0.05).all(axis=1)
        return float((inside & (points[:, 2] > 0.06)).sum()) / depth[0].size

    return seen


def _visit(
    name: str, scene: Scene, seen: Callable[[Landmark], float], ctx: FigureContext
) -> _Place:
    navigation = NavigationMap(scene.grid, 0.2)
    by_id = {thing.id: thing for thing in scene.objects}
    count = ROUTES
    while True:
        try:
            episodes = sample_goal_episodes(scene, navigation, count, 0)
            break
        except EpisodeError:
            count = count * 3 // 4
            if count < 10:
                raise
    sight_of(scene)
    routes = []
    begin = 0.0
    for number, episode in enumerate(episodes):
        ctx.progress(f"routes in {name}", number, len(episodes))
        if number == 1:
            begin = time.process_time()  # kernels are loaded, the scene's own facts gathered
        path = np.array(episode.path)
        ahead = path[min(4, len(path) - 1)] - path[0]
        # one in four starts with its back or side to the route
        yaw = float(np.arctan2(ahead[1], ahead[0])) if number % 4 else episode.start[2]
        target = by_id[getattr(episode.mission, "object_id", "")]
        routes.append(describe_route(scene, navigation, path, yaw, target))
    seconds = (time.process_time() - begin) / max(1, len(routes) - 1)
    return _Place(name, scene, routes, seconds, seen)


def _visit_all(ctx: FigureContext) -> list[_Place]:
    source = ctx.need_data("worlds/small_house")
    places = []
    for kind, seed in GENERATED:
        ctx.progress(f"a small {kind}", 0, 1)
        scene, mesh = _generate(kind, seed)
        places.append(_visit(scene.id, scene, _judge_triangles(scene, mesh), ctx))
    house = import_scene(
        source, ctx.work / "small_house", density=DENSITY, light="flat", progress=ctx.progress
    )
    places.append(_visit("small_house", house, _judge_pictures(house), ctx))
    return places


def measure_language(ctx: FigureContext) -> list[FigureRow]:
    """The grammar, its texts over real routes, landmarks by a judge, and misbehaving servers."""
    places = _visit_all(ctx)
    return [
        *_skeleton_rows(),
        *_text_rows(places, ctx),
        *_landmark_rows(places, ctx),
        *_server_rows(ctx),
    ]


def _skeleton_rows() -> list[FigureRow]:
    count, apart = count_phrases(), len(held_out_phrases())
    share = 100 * apart / count
    return [
        row_at_least(
            "distinct sentence skeletons",
            count,
            200,
            "skeletons",
            "clauses and sentences with their slots for landmark, room, target, side and number; "
            "how they are joined is not counted",
        ),
        FigureRow(
            name="skeletons held out for unseen splits",
            value=share,
            unit="%",
            target="20 ± 3 %",
            passed=abs(share - 20) <= 3,
            detail=f"{apart} of {count}, a fixed part of every kind",
        ),
    ]


def _text_rows(places: list[_Place], ctx: FigureContext) -> list[FigureRow]:
    writer = ProviderTemplate()
    told = passed = turned = 0
    words: set[str] = set()
    routes = [route for place in places for route in place.routes]
    begin = time.process_time()
    texts = []
    for number, route in enumerate(routes):
        ctx.progress("texts", number, len(routes))
        for seed in range(SEEDS):
            for style in STYLES:
                text = writer.write(route, style, seed=seed, held_out=seed % 2 == 1)
                texts.append((route, style, text))
    written = time.process_time() - begin
    begin = time.process_time()
    for route, style, text in texts:
        told += 1
        passed += not check_text(text, route, style)
        words.add(text)
        turned += bool(route.turns)
    checked = time.process_time() - begin
    detail = (
        f"{len(routes)} routes of goal episodes in {', '.join(p.name for p in places)}; three "
        f"styles, {SEEDS} seeds, one of them with held-out skeletons"
    )
    slowest = max(place.seconds for place in places)
    mean = float(np.mean([place.seconds for place in places]))
    return [
        row_at_least("template texts that pass their check", 100 * passed / told, 100, "%", detail),
        FigureRow(
            name="different texts among them",
            value=100 * len(words) / told,
            unit="%",
            detail=f"{len(words):,} of {told:,}",
        ),
        FigureRow(
            name="texts written", value=told / written, unit="/s", detail="one core, " + detail
        ),
        FigureRow(name="texts checked", value=told / checked, unit="/s", detail="one core"),
        FigureRow(
            name="routes described",
            value=1 / mean,
            unit="/s",
            detail=f"one core, views cast every metre; the slowest scene {1 / slowest:.0f}/s",
        ),
    ]


def _landmark_rows(places: list[_Place], ctx: FigureContext) -> list[FigureRow]:
    rows = []
    for where, chosen in (("generated scenes", places[:-1]), ("small_house", places[-1:])):
        seen = total = straights = turns = told = 0
        for place in chosen:
            for number, route in enumerate(place.routes):
                ctx.progress(f"judging {place.name}", number, len(place.routes))
                for segment in route.segments:
                    straights += segment.turn is None
                    turns += segment.turn is not None
                    told += bool(segment.landmarks)
                for landmark in route.landmarks:
                    total += 1
                    seen += place.seen(landmark) >= SHOWS
        judge = (
            "rays at the triangles the splats were made from"
            if where == "generated scenes"
            else "the object's box in a rendered depth picture"
        )
        rows.append(
            row_at_least(
                f"landmarks visible to a judge, {where}",
                100 * seen / max(total, 1),
                95,
                "%",
                f"{total} landmarks of {straights} straights and {turns} turns, {told} with one; "
                f"judge: {judge}, ≥ {SHOWS:.1%} of a {JUDGE[0]} × {JUDGE[1]} picture",
            )
        )
    return rows


def _server_rows(ctx: FigureContext) -> list[FigureRow]:
    route = build_simple_route("left", "right")
    survived, slowest = 0, 0.0
    kinds = {**PASSING, **ROGUES}
    for number, (name, reply) in enumerate(kinds.items()):
        ctx.progress("misbehaving servers", number, len(kinds))
        begin = time.monotonic()
        with serve_language(reply) as (url, _):
            provider = open_provider(
                "openai", model="m", base_url=url, timeout=0.25, retries=2, backoff=0.01,
                longest_wait=0.2, cache="none",
            )  # fmt: skip
            texts = write_texts(route, provider)
        slowest = max(slowest, time.monotonic() - begin)
        good = all(not check_text(t.text, route, style) for style, t in texts.items())
        # what passes is the model's own text; what never passes is the grammar's, and said so
        own = all(t.provider == "openai" and not t.fallback for t in texts.values())
        fell = all(t.provider == "template" and t.fallback for t in texts.values())
        survived += good and (own if name in PASSING else fell)
    return [
        row_at_least(
            "ways of a server to misbehave, survived",
            survived,
            len(kinds),
            "kinds",
            f"{len(PASSING)} that pass when tried again, {len(ROGUES)} that never become a text; "
            "three texts each, none lost, each fallback with its reason",
        ),
        row_at_most(
            "longest that one of them held three texts",
            slowest,
            10,
            "s",
            "timeout 0.25 s, two retries",
        ),
    ]


FIGURES = [Figure("data.language", "Instructions", measure_language, 5.0)]
