"""Figures of label variant `field`: where it leads on every kind of scene, and its speed."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from gn0.data.expert_labels import LabelSettings, label_states, plan_from, walk_actions
from gn0.data.field_labels import label_poses, list_cycle
from gn0.device.device import DeviceArray
from gn0.geometry import F64
from gn0.maps.distance import GeodesicField
from gn0.maps.field_expert import ROUNDING, STOP_DISTANCE, FieldLabels, label_field
from gn0.maps.grid import OccupancyGrid
from gn0.maps.navigation import NavigationMap
from gn0.maps.ros import load_ros_map
from gn0.missions.episode import AgentSpec, Episode
from gn0.scenes.occupancy import build_occupancy
from gn0.scenes.procedural.kinds import KINDS, KindName
from gn0.scenes.scene import Scene
from gn0.seeds import random_stream
from gn0.sim.device_env import VectorEnvDevice
from gn0.sim.ground import list_headings
from gn0.testing.scenes import build_floor_plan, build_map_scene, build_point_episodes
from gn0_figures.board import (
    Figure,
    FigureContext,
    FigureRow,
    row_at_least,
    row_at_most,
)
from gn0_figures.device import interleave, is_emulation, median
from gn0_figures.maps import HOUSE

BODY = AgentSpec()
NEAR = STOP_DISTANCE - ROUNDING  # m
STATES, GOALS = 10_000, 40  # of a scene
COMPARED = 2_000  # of them, beside `exact`
LONGEST = 2_000  # actions
ROUNDS = 3
ARRIVING, LONGER, ALIKE, BUSIER = 99.5, 1.0, 93.0, 12.0  # %
ON_CARD = 1e6  # states/s
AGENTS = (4_096, 65_536)


def _grids(ctx: FigureContext) -> Iterator[tuple[str, OccupancyGrid]]:
    try:
        yield "small house, SLAM map", load_ros_map(ctx.need_data(HOUSE))
    except FileNotFoundError:
        ctx.progress("no small house here", 0, 1)
    for kind in KINDS:
        draft = KINDS[kind].draft(7, size="medium", style=None)
        yield f"generated {kind}, seed 7", build_occupancy(draft.mesh)


def _places(navigation: NavigationMap, count: int, *names: str | int) -> F64:
    """Places [count, 2] m of the largest region, anywhere in their cells."""
    rng = random_stream(0, "figures", "field labels", *names)
    free = np.argwhere(navigation.regions == 0)
    centres = navigation.grid.centres_of(free[rng.integers(len(free), size=count)])
    half = 0.49 * navigation.grid.resolution
    places: F64 = centres + rng.uniform(-half, half, centres.shape)
    return places


def carry_out(
    navigation: NavigationMap, field: GeodesicField, states: F64
) -> tuple[NDArray[np.int8], F64, NDArray[np.bool_]]:
    """Walk from states [N, 3] by the first action of a new label at every decision, to the STOP.

    Returns:
        actions [N, T], STOP from the end on; the last places [N, 2] m; whether a step of each was
        cut short [N].
    """
    headings = np.array([list_cycle(yaw, BODY.turn_degrees) for yaw in states[:, 2].tolist()])
    circle = headings.shape[1]
    places, turns = states[:, :2].copy(), np.zeros(len(states), np.int64)
    cut, active = np.zeros(len(states), np.bool_), np.arange(len(states))
    taken: list[NDArray[np.int8]] = []
    while len(active) and len(taken) < LONGEST:
        said = label_field(
            field, places[active], headings, turns[active], active,
            near=NEAR, step=BODY.forward_step,
        ).actions[:, 0]  # fmt: skip
        row = np.zeros(len(states), np.int8)
        row[active] = said
        taken.append(row)
        turns[active] = (turns[active] + (said == 2) - (said == 3).astype(np.int64)) % circle
        for i in active[said == 1].tolist():
            x, y = places[i].tolist()
            _, cosine, sine = headings[i, turns[i]].tolist()
            step = BODY.forward_step
            *places[i], hit = navigation.move(x, y, x + step * cosine, y + step * sine)
            cut[i] |= hit
        active = active[said != 0]
    return np.array(taken).T, places, cut


class _Sums:
    """What is counted over all goals of a scene."""

    def __init__(self) -> None:
        self.tried = self.arrived = self.cut = self.cut_alone = self.dithered = 0
        self.compared = self.alike = 0
        self.steps, self.actions = np.zeros(2), np.zeros(2)  # of field and of exact

    def add(self, navigation: NavigationMap, field: GeodesicField, states: F64, many: int) -> None:
        actions, ends, cut = carry_out(navigation, field, states)
        self.tried += len(states)
        self.arrived += int((field.distance(ends) <= STOP_DISTANCE).sum())
        self.cut += int(cut.sum())
        before, after = actions[:, :-1], actions[:, 1:]
        self.dithered += int((before * after == 6).sum())  # LEFT 2 beside RIGHT 3
        for i in np.unique(np.r_[np.arange(many), np.flatnonzero(cut)]).tolist():
            plan = plan_from(field, states[i])
            if cut[i]:
                whole = not walk_actions(navigation, BODY, states[i], plan)[1].any()
                self.cut_alone += whole
            if i < many:
                self.compared += 1
                self.alike += actions[i, 0] == (plan[0] if len(plan) else 0)
                self.steps += ((actions[i] == 1).sum(), (plan == 1).sum())
                self.actions += ((actions[i] != 0).sum(), len(plan))

    def rows(self, detail: str) -> list[FigureRow]:
        walks = f"{detail}; {self.tried:,} random states carried out, one action of each label"
        beside = f"{detail}; {self.compared:,} of the states"
        steps, actions = (100.0 * (of[0] / of[1] - 1.0) for of in (self.steps, self.actions))
        share = 100.0 * self.arrived / self.tried
        return [
            row_at_least("arrivals within 0.25 m", share, ARRIVING, "%", walks),
            row_at_most(
                "walks with a step cut short where exact cuts none", self.cut_alone, 0, "",
                f"{walks}; {self.cut} with one in all",
            ),
            row_at_most("turns back and forth", self.dithered, 0, "", walks),
            row_at_most("metres more than exact", steps, LONGER, "%", beside),
            row_at_most("actions more than exact", actions, BUSIER, "%", beside),
            row_at_least(
                "first action that of exact", 100.0 * self.alike / self.compared, ALIKE, "%", beside
            ),
        ]  # fmt: skip


def _rate(fields: list[GeodesicField], states: list[F64]) -> float:
    begin = time.process_time()  # one thread: a core's time, whoever else uses the machine
    for field, poses in zip(fields, states, strict=True):
        label_poses(field, poses, BODY, NEAR)
    return sum(map(len, states)) / (time.process_time() - begin)


def measure_field(
    ctx: FigureContext, states: int = STATES, goals: int = GOALS, compared: int = COMPARED
) -> list[FigureRow]:
    """Arrivals, lengths and agreement with `exact` on every kind of scene, and states/s a core."""
    rows: list[FigureRow] = []
    for name, grid in _grids(ctx):
        navigation, sums = NavigationMap(grid, BODY.radius), _Sums()
        fields, poses = [], []
        for number in range(goals):
            ctx.progress(f"field labels, {name}", number, goals)
            x, y = _places(navigation, 1, name, "goal", number)[0].tolist()
            places = _places(navigation, states // goals, name, "states", number)
            rng = random_stream(0, "figures", "field labels", "yaws", name, number)
            yaws = rng.uniform(-np.pi, np.pi, len(places))
            fields.append(navigation.geodesic((x, y)))
            poses.append(np.column_stack([places, yaws]))
            sums.add(navigation, fields[-1], poses[-1], compared // goals)
        detail = f"{name}, {grid.shape[1]}×{grid.shape[0]} cells; {goals} goals"
        label_states(navigation, fields[0].goal, poses[0][:1], LabelSettings())  # compiles
        exact = time.process_time()
        for field, own in zip(fields, poses, strict=True):
            label_states(navigation, field.goal, own[:10])
        exact = 10 * len(fields) / (time.process_time() - exact)
        rate = float(np.median([_rate(fields, poses) for _ in range(ROUNDS)]))
        fresh = [
            *sums.rows(detail),
            FigureRow(
                name="labels of arbitrary states", value=rate, unit="states/s",
                detail=f"{detail}; CPU time of one thread, median of {ROUNDS}, fields and their "
                f"bends known; exact, the same way: {exact:.0f} states/s",
            ),
        ]  # fmt: skip
        for row in fresh:
            ctx.report(row)
        rows += fresh
    return rows


# ---------------------------------------------------------------------------- on a card


def _worlds(tiny: bool) -> tuple[list[Scene], list[Episode]]:
    """Maps of buildings and episodes in them."""
    if tiny:
        grids = [("plan", build_floor_plan(0, width=6.0, depth=6.0))]
    else:
        kinds: tuple[KindName, ...] = (
            "apartment",
            "residence",
            "office",
            "supermarket",
            "warehouse",
        )
        grids = [(k, build_occupancy(KINDS[k].draft(7, size="medium").mesh)) for k in kinds]
    scenes = [build_map_scene(grid, name) for name, grid in grids]
    episodes = [
        episode
        for scene in scenes
        for episode in build_point_episodes(
            scene, NavigationMap(scene.grid, BODY.radius), 4 if tiny else 50, minimum=3.0
        )
    ]
    return scenes, episodes


def _differences(env: VectorEnvDevice, agents: int) -> int:
    """Of so many agents, those whose label is not to the bit what the CPU says of their state."""
    mine = FieldLabels(*(array.numpy() for array in env.labels()))
    simulator = env.simulator
    places, turns = (simulator.state[name].numpy() for name in ("position", "turns"))
    ground: dict[str, NavigationMap] = {}
    differing = 0
    for i, number in enumerate(simulator.outputs["episode"].numpy()[:agents].tolist()):
        episode = env.episodes[number]
        if episode.scene_id not in ground:
            scene = env.tasks.scenes[episode.scene_id]()
            ground[episode.scene_id] = NavigationMap(scene.grid, BODY.radius)
        theirs = label_field(
            ground[episode.scene_id].geodesic(episode.destination), places[i : i + 1],
            list_headings(episode, BODY)[None], turns[i : i + 1], np.zeros(1, np.int64),
            near=NEAR, step=BODY.forward_step,
        )  # fmt: skip
        differing += any(
            getattr(mine, name)[i].tobytes() != getattr(theirs, name)[0].tobytes()
            for name in theirs._fields
        )
    return differing


def measure_card(ctx: FigureContext) -> list[FigureRow]:
    """States labelled a second on the card, alone and with the steps between, and their bits."""
    tiny = is_emulation(ctx.device)
    scenes, episodes = _worlds(tiny)
    rows: list[FigureRow] = []
    for count in (4,) if tiny else AGENTS:
        env = VectorEnvDevice(
            count, scenes, episodes=episodes, device=ctx.device, sensors=(), max_steps=200
        )
        env.reset(seed=0)
        drawn = random_stream(0, "figure actions").choice(4, (16, count), p=[0.01, 0.59, 0.2, 0.2])
        actions = env.device.upload(drawn.astype(np.int64))
        for turn in range(2 if tiny else 64):
            env.step(actions[turn % 16])
        env.labels()

        def label(turn: int, env: VectorEnvDevice = env) -> None:
            env.labels()

        def walk(turn: int, env: VectorEnvDevice = env, actions: DeviceArray = actions) -> None:
            env.labels()
            env.step(actions[turn % 16])

        times = interleave(env.device, {"labels": label, "both": walk}, 3 if tiny else 24)
        detail = f"{count:,} agents in {len(scenes)} generated buildings, {len(episodes)} goals"
        for name, what in (
            ("labels", f"states labelled a second on the card, {count:,} agents"),
            ("both", f"the same with a step between, autoresets included, {count:,} agents"),
        ):
            rate = count / median(times[name]) * 1e3
            if tiny or name == "both":
                rows.append(FigureRow(name=what, value=rate, unit="1/s", detail=detail))
            else:
                rows.append(row_at_least(what, rate, ON_CARD, "1/s", detail))
            ctx.report(rows[-1])
        env.synchronize()
        looked = min(count, 4 if tiny else 2_000)
        rows.append(
            row_at_most(
                f"labels that differ from the CPU's, {count:,} agents",
                _differences(env, looked), 0, "",
                f"{looked:,} of {detail}; to the bit: actions, waypoints, distance",
            )
        )  # fmt: skip
        ctx.report(rows[-1])
        del env
    return rows


FIGURES = [
    Figure("train.labels", "Labels by the distance field", measure_field, 12.0),
    Figure(
        "train.labels.card", "Labels by the distance field, on the card", measure_card, 2.0, "cuda"
    ),
]
