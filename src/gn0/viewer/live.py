"""The live view of a scene: walk an agent through it in a browser, and see what it sees."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from gn0.errors import EpisodeError
from gn0.missions.episode import AgentSpec, Episode
from gn0.render.camera import Camera
from gn0.scenes.scene import Scene
from gn0.sim.presets import CameraPreset, find_preset
from gn0.sim.state import Action
from gn0.viewer.live_eyes import LiveEyes
from gn0.viewer.live_loop import LiveLoop
from gn0.viewer.live_map import AGENT, PICTURES, LiveMap, MapAgent, PictureKind, bev_map, plan_map
from gn0.viewer.live_people import LivePeople
from gn0.viewer.live_server import LiveServer
from gn0.viewer.live_splats import build_live_splats
from gn0.viewer.live_stage import (
    OVERVIEW_FOV,
    LiveBody,
    LiveStage,
    behind,
    from_above,
    overview,
)
from gn0.viewer.live_text import plain

if TYPE_CHECKING:
    from gn0.render.renderer import Renderer
    from gn0.viewer.live_walk import AgentWalk

CEILING_CUT = 2.3  # what lies higher hides rooms from above [m]
CAMERAS = ("free", "the agent's eyes", "behind the agent")
DETAILS = (30_000, 100_000, 300_000, 1_000_000)
KEY_ACTIONS = {"forward": Action.FORWARD, "left": Action.LEFT, "right": Action.RIGHT}
WAIT = "wait"  # what the agent does while only people move
BEV_PIXELS = 2048
FLOOR = 0.15  # what is hit by a click lower than this is floor [m]
HEAD_START, ALONE = 0.6, 5.0  # how long the agent waits for a visitor's page, for a visitor [s]
PANEL = 400  # width of the panel [px]
KEYS = (
    "**I** forward · **J** left · **L** right · **V** next picture · **C** next camera · "
    "**W A S D Q E** and arrows fly · click the floor to put the agent there"
)
PEOPLE_KEYS = (
    "\n\nPeople move while the agent acts: **K** waits for one action, **P** lets time run."
)


def ceiling_cut(scene: Scene) -> float:
    """Height [m] above which splats are the ceiling's."""
    ceiling = scene.source.settings.get("ceiling")
    known = isinstance(ceiling, int | float) and not isinstance(ceiling, bool)
    return min(max(float(ceiling) - 0.35, 1.6), CEILING_CUT) if known else CEILING_CUT  # type: ignore[arg-type]


class SceneView:
    """One scene, one agent, one page. Splats go out at once; the agent follows when it is ready.

    Args:
        live: the server.
        scene: what to show.
        loop: the thread that does the work.
        splats: how many splats the browser gets.
        preset: eyes and body by name, or a preset.
        episode: whose people are there and where the agent begins; nobody, and some free place,
            when None.
        body: the agent's, instead of the preset's.
        bank: of people who have names in one.
    """

    def __init__(
        self,
        live: LiveServer,
        scene: Scene,
        loop: LiveLoop,
        *,
        splats: int,
        preset: str | CameraPreset = "gn_bench",
        episode: Episode | None = None,
        body: AgentSpec | None = None,
        bank: Path | str | None = None,
    ) -> None:
        self.scene, self.loop, self.count = scene, loop, splats
        self.preset = find_preset(preset) if isinstance(preset, str) else preset
        self.agent = body or self.preset.agent
        self.episode, self._bank = episode, bank
        people = () if episode is None else episode.people
        self.people = people
        followed = None if episode is None else episode.followed
        self.followed = 0 if followed is None else followed.number
        self._figures = LivePeople(live.viser, "/people")
        self._runs, self._due = False, 0.0  # whether time runs, and when the next action is due
        self.server = live.viser
        self.stage = LiveStage(live.viser)
        self.eyes = LiveEyes(live.viser, self.stage, self.preset, self.agent.camera_height)
        self.cut = ceiling_cut(scene)
        self.walk: AgentWalk | None = None
        self.kind: PictureKind = "RGB"
        self.camera = CAMERAS[0]
        self.body: LiveBody | None = None
        self.plan: LiveMap
        self._renderer: Renderer | None = None
        self._plan_on_floor = False
        self._woken, self._seen, self._since = False, False, 0.0

    def show_splats(self) -> None:
        """Send the splats, thinned to the wanted number."""
        live = build_live_splats(self.scene.gaussians, self.count)
        self.stage.show_splats(live, self.cut)
        self.shown = len(live)

    def open(self) -> None:
        """Splats, labels and panel; then the agent, where it has room to stand."""
        self.stage.start_at(*overview(self.scene), OVERVIEW_FOV)
        self.show_splats()
        self.server.flush()
        self.plan = plan_map(self.scene, PANEL, 300)
        self.stage.add_labels(self.scene, rooms=True, objects=False)
        self._build_panel()
        self.server.on_client_connect(lambda client: self.loop.post(partial(self._greet, client)))

    def _greet(self, client: Any) -> None:
        """A visitor came: his window decides how far away the overview is."""
        fit, key = partial(self._refit, client), f"fit {client.client_id}"
        client.camera.on_update(lambda _: self.loop.post(fit, key=key))
        if self.camera == CAMERAS[0]:
            self.stage.look_over(self.scene)
        else:
            self._look()

    def _refit(self, client: Any) -> None:
        """A window changed its shape, or its visitor moved the camera."""
        if self.eyes.is_stale(client):
            self.loop.post(self._look_out, key="eyes")
        else:
            self.stage.refit(client, self.scene)

    def finish(self) -> None:
        """Do now what `tick` would leave for later: wake the agent."""
        if not self._woken:
            self._woken = True
            self._wake_agent()

    def tick(self, now: float) -> float | None:
        """Wake the agent once the first visitor has had time to fetch the splats; let time run.

        Compiling kernels for the first time takes long and would keep the page waiting.
        """
        if self._woken:
            return self._go_on(now)
        seen = bool(self.server.get_clients())
        self._since = self._since if self._since and seen == self._seen else now
        self._seen = seen
        rest = self._since + (HEAD_START if seen else ALONE) - now
        if rest <= 0:
            self.finish()
            return None
        return min(rest, 0.1)

    def _go_on(self, now: float) -> float | None:
        """Wait for one action when one is due and time runs: no faster than people would."""
        if not self._runs or not self.ready:
            return None
        if now >= self._due:
            self._due = now + self.agent.step_seconds
            self._move(WAIT)
        return max(self._due - now, 0.0)

    def _build_panel(self) -> None:
        gui: Any = self.server.gui
        gui.configure_theme(
            show_logo=False, show_share_button=False, dark_mode=True, brand_color=AGENT
        )
        gui.main_panel.dock_right()
        gui.main_panel.set_width(PANEL)
        wait = np.full((270, 360, 3), 40, np.uint8)
        self._title = gui.add_markdown(f"### {plain(self.scene.id, 60)}")
        self._picture = gui.add_image(wait, format="jpeg", jpeg_quality=88)
        kinds = gui.add_button_group("Picture", PICTURES)
        hear(self.loop, kinds.on_click, self._show_kind)
        words = ("left", "forward", "right")
        moves = gui.add_button_group("Move", (*words, WAIT) if self.people else words)
        hear(self.loop, moves.on_click, self._move)
        if self.people:
            self._clock = self._layer("Time runs", False, self._let_run)
        self._status = gui.add_markdown("*The agent is being prepared…*")
        self._plan_image = gui.add_image(self.plan.rgb, format="png")
        self._cameras = gui.add_dropdown("Camera", CAMERAS, initial_value=self.camera)
        hear(self.loop, self._cameras.on_update, self._follow)
        views = gui.add_button_group("Look from", ("overview", "above"))
        hear(self.loop, views.on_click, self._jump)
        with gui.add_folder("Layers", expand_by_default=False):
            self._layer("Splats", True, lambda on: self.stage.show(splats=on))
            self._layer("Ceiling", False, lambda on: self.stage.show(ceiling=on))
            self._layer("Plan on the floor", False, self._lay_plan)
            self._layer("Room names", True, lambda on: self.stage.show_labels(rooms=on))
            self._layer("Object names", False, lambda on: self.stage.show_labels(objects=on))
            total = len(self.scene.gaussians)
            choices = sorted({self.count, *(n for n in DETAILS if n < total), min(total, 10**6)})
            detail = gui.add_dropdown(
                "Splats here",
                [f"{n:,}" for n in choices],
                initial_value=f"{self.count:,}",
                hint="More splats look sharper and need a GPU.",
            )
            hear(self.loop, detail.on_update, self._refine)
        self._facts = gui.add_markdown(self._about())
        for label, key, work in (
            ("Agent: forward", "I", partial(self._move, "forward")),
            ("Agent: left", "J", partial(self._move, "left")),
            ("Agent: right", "L", partial(self._move, "right")),
            *(
                (("Agent: wait", "K", partial(self._move, WAIT)), ("Time runs", "P", self._toggle))
                if self.people
                else ()
            ),
            ("Next picture", "V", self._next_kind),
            ("Next camera", "C", self._next_camera),
        ):
            command = gui.add_command(label, hotkey=key)
            command.on_trigger(lambda event, work=work: self.loop.post(work))
        self.server.scene.on_click()(
            lambda event: self.loop.post(
                partial(self._click, np.array(event.ray_origin), np.array(event.ray_direction)),
                key="click",
            )
        )

    def _layer(self, label: str, start: bool, work: Callable[[bool], None]) -> Any:
        box = self.server.gui.add_checkbox(label, start)
        hear(self.loop, box.on_update, work)
        return box

    def _about(self) -> str:
        total = len(self.scene.gaussians)
        if self.shown < total:
            share = (
                f"This page shows **{self.shown:,}** splats, merged from {total:,}. The agent's "
                "pictures are drawn from all of them."
            )
        else:
            share = f"This page shows all {total:,} splats."
        return f"{share}\n\n{KEYS}{PEOPLE_KEYS if self.people else ''}"

    def _let_run(self, on: bool) -> None:
        self._runs, self._due = on, 0.0

    def _toggle(self) -> None:
        self._clock.value = not self._runs
        self._let_run(not self._runs)

    # what the agent does

    def _wake_agent(self) -> None:
        """Map, renderer and BEV; the slow part, done when the splats are already on their way."""
        # not needed for the first picture, and slow to import
        from gn0.maps.navigation import NavigationMap
        from gn0.render.bev import render_bev
        from gn0.render.open import build_renderer
        from gn0.render.renderer import DrawnScene
        from gn0.sim.sensors import SensorConfig
        from gn0.sim.simulator import Simulator
        from gn0.viewer.live_walk import AgentWalk
        from gn0.viewer.viewpoints import choose_viewpoints

        scene, preset = self.scene, self.preset
        navigation = NavigationMap(scene.grid, self.agent.radius)
        if not navigation.inflated.free_area:
            self._status.content = (
                f"Nothing is walkable here for an agent of radius {self.agent.radius:g} m: "
                "look round, or run `gn0 scene check`."
            )
            return
        self._renderer = build_renderer(scene.gaussians)
        bounds = np.array(scene.grid.bounds).reshape(2, 2)
        bev = render_bev(
            scene.cloud_hash or scene.gaussians.content_hash,
            self._renderer,
            bounds,
            max(scene.grid.resolution, float(np.ptp(bounds, axis=0).max()) / BEV_PIXELS),
            CEILING_CUT,
            background=preset.background,
        )
        self.walk = AgentWalk(
            Simulator(
                scene,
                navigation=navigation,
                sensors=SensorConfig(
                    active=frozenset({"rgb", "depth", "bev", "occupancy"}), preset=preset
                ),
                renderer=DrawnScene(self._renderer),
                bev=bev,
                agent=self.agent,
                max_steps=1_000_000,
                bank=self._bank,
            ),
            self.people,
            self.followed,
        )
        self._bev_map = bev_map(bev)
        self.body = LiveBody(self.server, "/agent", self.agent, AGENT)
        if self.people:
            self._status.content = "*People are being dressed: seconds each, the first time…*"
            self.server.flush()
        try:
            poses = [] if self.episode is None else [self.episode.start_pose]
            poses = [pose for pose in poses if self.walk.place(*pose)]
            if not poses:
                poses = choose_viewpoints(scene, 1, max(0.25, self.agent.radius + 0.05))
                poses = [pose for pose in poses if self.walk.place(*pose)]
        except EpisodeError as error:
            self._status.content = (
                f"**{plain(error.what)}** {plain(error.where)}. {plain(error.remedy)}"
            )
            return
        if not poses:
            room = np.where(navigation.regions == 0, navigation.clearance, 0.0)
            x, y = scene.grid.centres_of(np.argwhere(room == room.max())[:1])[0]
            self.walk.place(float(x), float(y), 0.0)
        row = next((k for k, p in enumerate(self.people) if p.number == self.followed), -1)
        self._figures.cast(self.people, row)
        self._refresh()

    @property
    def ready(self) -> bool:
        """Whether the agent's first picture is on the page, or it is known that none will be."""
        return self.walk is not None and self.walk.standing

    def _move(self, word: str) -> None:
        if self.walk is not None and self.walk.standing:
            self.walk.act(Action.STOP if word == WAIT else KEY_ACTIONS[word])
            self._refresh()

    def _click(self, origin: Any, direction: Any) -> None:
        if self.walk is None or not self.walk.standing or self.eyes.open:
            return
        spot = self._floor_at(origin, direction)
        if spot is None:
            self._tell("That is not the floor.")
        else:
            self.walk.place(*spot, self.walk.pose.yaw)
            self._refresh()

    def _floor_at(self, origin: Any, direction: Any) -> tuple[float, float] | None:
        """The floor point [m] that a ray meets first, going by the full cloud; None: no floor."""
        if direction[2] >= -1e-6 or origin[2] <= 0:
            return None
        floor = origin + direction * (-origin[2] / direction[2])
        spot = (float(floor[0]), float(floor[1]))
        if self._plan_on_floor or self._renderer is None:
            return spot
        near = 0.02
        if not self.stage.ceiling and origin[2] > self.cut:  # what is hidden does not stop a click
            near = float((self.cut - origin[2]) / direction[2] * np.linalg.norm(direction))
        length = float(np.linalg.norm(floor - origin))
        camera = Camera.from_hfov(8, 8, 0.5, near=near, far=length + 1.0)
        unit = direction / np.linalg.norm(direction)
        view = _view_along(origin, unit)
        depth = self._renderer.render(camera, view, outputs=("depth",)).depth
        assert depth is not None
        hit = float(np.median(depth[0, 3:5, 3:5]))
        if math.isfinite(hit) and (origin + unit * hit)[2] > FLOOR:
            return None
        return spot

    # what is shown

    def _refresh(self) -> None:
        """Body, text, camera at once; pictures when no further action waits."""
        assert self.walk is not None and self.body is not None
        walk = self.walk
        self.body.move(walk.pose, walk.trail, walk.last.bumped)
        marks = walk.marks
        if marks:
            self._figures.move(marks)
        text = plain_lines(walk.text)
        if walk.last.bumped:
            who = f"Person {walk.last.person}" if walk.last.person else "An obstacle"
            text += f"\n\n**Bump.** {who} cut this short."
        self._status.content = text + f"\n\nbumps so far: {walk.bumps}"
        if not self.eyes.open:  # else drawn with the other pictures
            self._look()
        self.loop.post(self._draw, key="draw")

    def _draw(self) -> None:
        assert self.walk is not None
        agent = MapAgent(self.walk.pose, AGENT, self.walk.trail)
        if self.kind == "BEV":
            self._picture.image = self._bev_map.draw([agent], people=self.walk.marks)
        else:
            self._picture.image = self.walk.picture(self.kind)
        self._plan_image.image = self.plan.draw([agent], people=self.walk.marks)
        self._look_out()

    def _look_out(self) -> None:
        """Draw the canvas anew while it shows what the agent sees."""
        if self.camera == CAMERAS[1] and self._renderer is not None:
            assert self.walk is not None
            pose = self.walk.pose
            show = partial(self.walk.simulator.show_people, pose)
            kind: Literal["RGB", "depth"] = "depth" if self.kind == "depth" else "RGB"
            self.eyes.show(self._renderer, pose, kind, show)

    def _tell(self, text: str) -> None:
        self._status.content = f"**{text}**"

    def _look(self) -> None:
        assert self.walk is not None
        if self.camera == CAMERAS[1]:
            self.loop.post(self._look_out, key="eyes")
        elif self.camera == CAMERAS[2]:
            self.stage.look(*behind(self.walk.pose), math.radians(60))

    def _follow(self, camera: str) -> None:
        self.camera = camera
        inside = camera == CAMERAS[1]
        if not inside:
            self.eyes.hide()
        if self.body is not None and self.walk is not None and self.walk.standing:
            self.body.show(not inside, trail=not inside)
            self._figures.show(not inside, tracks=not inside)
            self._look()
        if camera == CAMERAS[0]:
            self._jump("overview")

    def _next_camera(self) -> None:
        self._cameras.value = CAMERAS[(CAMERAS.index(self.camera) + 1) % len(CAMERAS)]
        self._follow(self._cameras.value)

    def _jump(self, where: str) -> None:
        if self.camera != CAMERAS[0]:
            self.camera = CAMERAS[0]
            self._cameras.value = CAMERAS[0]
            self.eyes.hide()
            if self.body is not None:
                self.body.show(True)
            self._figures.show(True)
        if where == "overview":
            self.stage.look_over(self.scene)
        else:
            self.stage.look(*from_above(self.scene), OVERVIEW_FOV)

    def _show_kind(self, kind: PictureKind) -> None:
        self.kind = kind
        if self.walk is not None and self.walk.standing:
            self.loop.post(self._draw, key="draw")

    def _next_kind(self) -> None:
        self._show_kind(PICTURES[(PICTURES.index(self.kind) + 1) % len(PICTURES)])

    def _lay_plan(self, on: bool) -> None:
        self._plan_on_floor = on
        height, width = self.plan.rgb.shape[:2]
        x0, y1, scale = self.plan.left, self.plan.top, self.plan.scale
        bounds = (x0, y1 - height / scale, x0 + width / scale, y1)
        self.stage.show_plan(self.plan.rgb if on else None, bounds)

    def _refine(self, count: str) -> None:
        self.count = int(count.replace(",", ""))
        self.show_splats()
        self._facts.content = self._about()


def hear(loop: LiveLoop, listen: Callable[..., Any], work: Callable[[Any], None]) -> None:
    """Do `work` with the value that a visitor gives an element; not when we set it ourselves."""

    def noted(event: Any) -> None:
        if event.client is not None:
            loop.post(partial(work, event.target.value))

    listen(noted)


def plain_lines(text: str) -> str:
    """Lines as Markdown paragraphs that show exactly them."""
    return "\n\n".join(plain(line) for line in text.splitlines())


def _view_along(origin: Any, unit: Any) -> Any:
    """World-to-camera matrix [4, 4] of an eye at `origin` [m] that looks along `unit`."""
    side = np.cross(unit, (0.0, 0.0, 1.0))
    if np.linalg.norm(side) < 1e-6:
        side = np.array([1.0, 0.0, 0.0])
    side = side / np.linalg.norm(side)
    view = np.eye(4)
    view[:3, :3] = (side, np.cross(unit, side), unit)
    view[:3, 3] = -view[:3, :3] @ np.asarray(origin, np.float64)
    return view
