"""The live view of recorded runs: all agents at once in the scene, and what each of them saw."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from gn0.bench.episode_clip import clip_camera
from gn0.errors import BenchError
from gn0.geometry import U8, view_from_pose
from gn0.missions.episode import Episode
from gn0.render.open import build_renderer
from gn0.render.renderer import Renderer
from gn0.scenes.scene import Scene
from gn0.sim.presets import find_preset
from gn0.suites.suite import load_suite_scene
from gn0.viewer.floor_plan import font
from gn0.viewer.live import PANEL, ceiling_cut, hear
from gn0.viewer.live_eyes import LiveEyes
from gn0.viewer.live_loop import LiveLoop
from gn0.viewer.live_map import AGENT, LiveMap, MapAgent, plan_map
from gn0.viewer.live_server import LiveServer
from gn0.viewer.live_splats import build_live_splats
from gn0.viewer.live_stage import OVERVIEW_FOV, LiveBody, LiveStage, overview
from gn0.viewer.live_text import name_line, plain
from gn0.viewer.recorded_runs import Replay

SPEEDS = ("1x", "2x", "4x", "8x", "16x")
EYES_PANEL = 330  # width of the panel with the agents' pictures [px]
VIEW_HEIGHT = 208  # px
_BAR = 24  # px: name and action over each picture
KEYS = "**space** play · **J L** one step · **N B** next, previous episode · **W A S D Q E** fly"


class ReplayView:
    """Recorded runs on one page.

    Args:
        live: the server.
        loop: the thread that does the work.
        replay: what was recorded.
        splats: how many splats the browser gets.
        first: id of the episode to begin with; "" for the first of the list.
    """

    def __init__(
        self, live: LiveServer, loop: LiveLoop, *, replay: Replay, splats: int, first: str = ""
    ) -> None:
        self.server, self.loop, self.replay, self.count = live.viser, loop, replay, splats
        live.asks.append(lambda name: loop.post(partial(self._open_link, name), key="link"))
        self.stage = LiveStage(live.viser)
        about = replay.suite.about
        self.preset = find_preset(about.camera)
        self.agent = about.agent
        self.eyes = LiveEyes(live.viser, self.stage, self.preset, about.agent.camera_height)
        self.scene: Scene | None = None
        self.episode: Episode = replay.find(first) if first else replay.episodes[0]
        self.step, self.playing, self.speed = 0, False, 4.0
        self.camera = "free"
        self._began = (0.0, 0)  # when playing began [s], and at which step
        self._renderer: Renderer | None = None
        self._drawn = False
        self._plan: LiveMap | None = None
        self._bodies = [
            LiveBody(live.viser, f"/run_{i}", about.agent, run.colour)
            for i, run in enumerate(replay.runs)
        ]

    def open(self) -> None:
        """Splats and panels, then the first episode."""
        self._titles = {self.replay.title(e): e for e in self.replay.episodes}
        self._enter(self.episode.scene_id)
        self._build_panels()
        self._turn_to(self.episode)
        self.server.on_client_connect(lambda client: self.loop.post(partial(self._greet, client)))

    def _refit(self, client: Any) -> None:
        assert self.scene is not None
        if self.eyes.is_stale(client):
            self.loop.post(self._look, key="eyes")
        else:
            self.stage.refit(client, self.scene)

    def _greet(self, client: Any) -> None:
        """A visitor came: his window decides how far away the overview is."""
        fit, key = partial(self._refit, client), f"fit {client.client_id}"
        client.camera.on_update(lambda _: self.loop.post(fit, key=key))
        assert self.scene is not None
        if self.camera == "free":
            self.stage.look_over(self.scene)
        else:
            self._look()

    def finish(self) -> None:
        """Draw the first pictures."""
        self._draw()

    @property
    def ready(self) -> bool:
        """Whether the agents' pictures are on the page."""
        return self._drawn

    def _enter(self, scene_id: str) -> None:
        """Put a scene on the stage."""
        suite = self.replay.suite
        scene = load_suite_scene(suite.scene_folder(scene_id), scene_id, suite.scene_hash(scene_id))
        self.stage.clear()
        self.scene, self._renderer = scene, None
        self.stage.start_at(*overview(scene), OVERVIEW_FOV)
        live = build_live_splats(scene.gaussians, self.count)
        self.stage.show_splats(live, ceiling_cut(scene))
        self.stage.add_labels(scene, rooms=False, objects=False)
        self._plan = plan_map(scene, PANEL, 300)
        self._share = f"{len(live):,} of {len(scene.gaussians):,} splats"

    def _build_panels(self) -> None:
        gui: Any = self.server.gui
        gui.configure_theme(
            show_logo=False, show_share_button=False, dark_mode=True, brand_color=AGENT
        )
        gui.main_panel.dock_right()
        gui.main_panel.set_width(PANEL)
        runs = self.replay.runs
        gui.add_markdown(f"### {plain(self.replay.suite.name, 60)}")
        self._list = gui.add_dropdown("Episode", list(self._titles))
        hear(self.loop, self._list.on_update, self._choose)
        self._task = gui.add_markdown("")
        self._button = gui.add_button("Play")
        hear(self.loop, self._button.on_click, lambda _: self._toggle())
        self._slider = gui.add_slider("Step", 0, 1, 1, 0)
        hear(self.loop, self._slider.on_update, self._seek)
        speed = gui.add_dropdown("Speed", SPEEDS, initial_value="4x")
        hear(self.loop, speed.on_update, self._set_speed)
        self._eyes = {name_line(f"eyes of {run.name}"): i for i, run in enumerate(runs)}
        camera = gui.add_dropdown("Camera", ["free", *self._eyes], initial_value="free")
        hear(self.loop, camera.on_update, self._follow)
        self._scores = gui.add_markdown("")
        assert self._plan is not None
        self._map = gui.add_image(self._plan.rgb, format="png")
        with gui.add_folder("Protocol", expand_by_default=False):
            gui.add_markdown(self.replay.differences())
        with gui.add_folder("Layers", expand_by_default=False):
            for label, start, work in (
                ("Splats", True, lambda on: self.stage.show(splats=on)),
                ("Ceiling", False, lambda on: self.stage.show(ceiling=on)),
                ("Room names", False, lambda on: self.stage.show_labels(rooms=on)),
                ("Object names", False, lambda on: self.stage.show_labels(objects=on)),
            ):
                hear(self.loop, gui.add_checkbox(label, start).on_update, work)
        gui.add_markdown(
            f"This page shows {self._share}; the agents' pictures are drawn again from all of "
            f"them, at the poses that were recorded.\n\n{KEYS}"
        )
        side = gui.add_panel()
        with side.add_tab("What they saw"):
            blank = np.full((VIEW_HEIGHT, EYES_PANEL, 3), 40, np.uint8)
            self._views = gui.add_image(blank, format="jpeg", jpeg_quality=88)
        side.dock_left()
        side.set_width(EYES_PANEL)
        for label, key, deed in (
            ("Play or pause", "space", self._toggle),
            ("Step back", "J", partial(self._nudge, -1)),
            ("Step on", "L", partial(self._nudge, 1)),
            ("Next episode", "N", partial(self._turn_page, 1)),
            ("Previous episode", "B", partial(self._turn_page, -1)),
        ):
            command = gui.add_command(label, hotkey=key)
            command.on_trigger(lambda event, deed=deed: self.loop.post(deed))

    # choosing and playing

    def _choose(self, title: str) -> None:
        episode = self._titles[title]
        assert self.scene is not None
        if episode.scene_id != self.scene.id:
            self._enter(episode.scene_id)
            self.stage.look_over(self.scene)
        self.episode = episode
        self._slider.value = 0
        self._slider.max = max(1, self.replay.length(episode))
        self._task.content = f"“{plain(episode.instruction, 300)}”"
        self._scores.content = self.replay.metrics_table(episode)
        radius = self.replay.suite.about.success_radius
        if not episode.in_area:
            radius = episode.success_within(radius)
        self.stage.show_task(episode.path, episode.goal, radius)
        self._pause()
        self._show(0)

    def _turn_page(self, by: int) -> None:
        episodes = self.replay.episodes
        self._turn_to(episodes[(episodes.index(self.episode) + by) % len(episodes)])

    def _turn_to(self, episode: Episode) -> None:
        self._list.value = self.replay.title(episode)
        self._choose(self._list.value)

    def _open_link(self, name: str) -> None:
        """A visitor's address asks for an episode."""
        try:
            self._turn_to(self.replay.find(name))
        except BenchError as error:
            self._task.content = plain(error.what)

    def _toggle(self) -> None:
        if self.playing:
            self._pause()
            return
        if self.step >= self.replay.length(self.episode):
            self._show(0)
        self.playing, self._began = True, (0.0, self.step)
        self._button.label = "Pause"

    def _pause(self) -> None:
        self.playing = False
        self._button.label = "Play"

    def _set_speed(self, speed: str) -> None:
        self.speed = float(speed.rstrip("x"))
        self._began = (0.0, self.step)

    def _seek(self, step: int) -> None:
        self._began = (0.0, int(step))
        self._show(int(step))

    def _nudge(self, by: int) -> None:
        self._pause()
        self._slider.value = min(max(self.step + by, 0), self._slider.max)
        self._show(int(self._slider.value))

    def tick(self, now: float) -> float | None:
        """Go on to the step that is due: at speed 1x, each takes as long as the body's actions."""
        if not self._drawn:
            self._draw()
        if not self.playing:
            return None
        if not self._began[0]:
            self._began = (now, self._began[1])
        pace = self.speed / self.agent.step_seconds
        due = self._began[1] + int((now - self._began[0]) * pace)
        last = self.replay.length(self.episode)
        if due > self.step:
            step = min(due, last)
            self._slider.value = step
            self._show(step)
            if step >= last:
                self._pause()
                return None
        return 0.5 / pace

    # what is shown

    def _show(self, step: int) -> None:
        self.step = step
        for run, body in zip(self.replay.runs, self._bodies, strict=True):
            pose = self.replay.pose(run, self.episode, step)
            if pose is not None:
                trail = self.replay.trail(run, self.episode, step)
                body.move(pose, trail, self.replay.bumped(run, self.episode, step))
        self.loop.post(self._draw, key="draw")

    def _draw(self) -> None:
        """Pictures of each agent, one under the other, and the plan."""
        assert self.scene is not None and self._plan is not None
        if self._renderer is None:
            self._renderer = build_renderer(self.scene.gaussians)
        found = [self.replay.pose(run, self.episode, self.step) for run in self.replay.runs]
        there = [(i, pose) for i, pose in enumerate(found) if pose is not None]
        camera = clip_camera(self.preset.rgb, VIEW_HEIGHT)
        pitch = math.radians(self.preset.pitch_degrees)
        height = self.agent.camera_height
        pictures: dict[int, U8] = {}
        if there:
            views = np.stack([view_from_pose(p.x, p.y, height, p.yaw, pitch) for _, p in there])
            drawn = self._renderer.render(
                camera, views, outputs=("rgb",), background=self.preset.background
            ).rgb
            assert drawn is not None
            pictures = {i: np.asarray(d, np.uint8) for (i, _), d in zip(there, drawn, strict=True)}
        self._views.image = self._column(pictures, camera.width)
        agents = [
            MapAgent(
                pose,
                self.replay.runs[i].colour,
                self.replay.trail(self.replay.runs[i], self.episode, self.step),
            )
            for i, pose in there
        ]
        self._map.image = self._plan.draw(
            agents, reference=self.episode.path, goal=self.episode.goal
        )
        self._drawn = True
        self._look()

    def _column(self, pictures: dict[int, U8], width: int) -> U8:
        """Each run's picture under a bar with its colour, name and last action."""
        runs = self.replay.runs
        tall = VIEW_HEIGHT + _BAR
        sheet = Image.new("RGB", (width, tall * len(runs)), (24, 26, 30))
        pen = ImageDraw.Draw(sheet)
        for i, run in enumerate(runs):
            top = i * tall
            pen.rectangle((0, top, width, top + _BAR), fill=run.colour)
            word = self.replay.word(run, self.episode, self.step)
            text = f"{name_line(run.name, 22)} · {word}"
            pen.text((8, top + _BAR / 2), text, (255, 255, 255), font(14), anchor="lm")
            if i in pictures:
                sheet.paste(Image.fromarray(pictures[i]), (0, top + _BAR))
        return np.asarray(sheet, np.uint8)

    def _follow(self, camera: str) -> None:
        assert self.scene is not None
        self.camera = camera
        chosen = self._eyes.get(camera)
        for body in self._bodies:
            body.show(chosen is None, trail=chosen is None)
        if chosen is None:
            self.eyes.hide()
            self.stage.look_over(self.scene)
        else:
            self._look()

    def _look(self) -> None:
        """Draw the canvas anew while it shows what an agent sees."""
        chosen = self._eyes.get(self.camera)
        if chosen is not None and self._renderer is not None:
            pose = self.replay.pose(self.replay.runs[chosen], self.episode, self.step)
            if pose is not None:
                self.eyes.show(self._renderer, pose)
