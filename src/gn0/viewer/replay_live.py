"""The live view of recorded runs: all agents at once in the scene, and what each of them saw.

People are where they were at each step: an episode's actions are played again for that.
"""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
from PIL import Image, ImageDraw

from gn0.bench.episode_clip import clip_camera
from gn0.bench.people_replay import PeopleReplay, PeopleStill
from gn0.errors import BenchError, Gn0Error
from gn0.geometry import F64, U8, Pose2D, view_from_pose
from gn0.missions.episode import Episode
from gn0.render.camera import Camera
from gn0.render.instance import Instance
from gn0.render.open import build_renderer
from gn0.render.renderer import DrawnScene, Renderer
from gn0.scenes.scene import Scene
from gn0.sim.presets import find_preset
from gn0.suites.suite import load_suite_scene
from gn0.viewer.floor_plan import font
from gn0.viewer.live import PANEL, ceiling_cut, hear
from gn0.viewer.live_eyes import LiveEyes
from gn0.viewer.live_loop import LiveLoop
from gn0.viewer.live_map import AGENT, LiveMap, MapAgent, MapPerson, plan_map
from gn0.viewer.live_people import LivePeople, frame_person, mark_people
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
        self._people = LivePeople(live.viser, "/people")
        self._past: PeopleReplay | None = None  # of the scene on the stage
        self._stills: dict[int, tuple[PeopleStill, ...]] = {}  # by run, of the episode shown
        self._met = ""  # the episode that they are of
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
        self.scene, self._renderer, self._past = scene, None, None
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
        self._crowd = gui.add_markdown("")
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
        goal = None if episode.followed is not None else episode.goal
        self.stage.show_task(episode.path, goal, radius)
        self._stills, self._met = {}, ""
        self._people.clear()
        self._crowd.content = ""
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
        if self._stills:
            self._people.move(self._mark_people())
        self.loop.post(self._draw, key="draw")

    # people

    def _meet(self) -> None:
        """Find out where people were in each run of the episode, once."""
        episode = self.episode
        if not episode.people or self._met == episode.id:
            return
        assert self.scene is not None and self._renderer is not None
        self._met = episode.id
        if self._past is None:
            drawn, profile = DrawnScene(self._renderer), self.replay.suite.about.profile
            self._past = PeopleReplay(self.scene, drawn, profile=profile)
        try:
            self._past.eyes.cast.check(episode.people)
            for i, run in enumerate(self.replay.runs):
                trace = run.trace(episode.id)
                if trace.poses:
                    self._stills[i] = self._past.stills(episode, trace)
        except Gn0Error as error:
            self._stills = {}
            self._crowd.content = f"**People cannot be shown:** {plain(error)}"
            return
        self._people.cast(episode.people, self._followed)
        self._people.move(self._mark_people())
        self._crowd.content = self._tell_people()

    def _tell_people(self) -> str:
        """Who is there, in words, and whether they are where the runs had them."""
        episode = self.episode
        count = len(episode.people)
        text = "One person is there" if count == 1 else f"{count} people are there"
        if episode.followed is not None:
            text += "; whom to follow is green, and framed in the pictures"
        if len(self.replay.runs) > 1:
            text += f". Scene and plan show those of {plain(self.replay.runs[self._side].name, 24)}"
        parted = [
            self.replay.runs[i].name
            for i, stills in self._stills.items()
            if not self.replay.people_agree(self.replay.runs[i], episode, stills)
        ]
        if parted:
            text += (
                f".\n\n**Not as recorded** in {plain(', '.join(parted))}: other code made the run "
                "(`gn0 bench replay` says where it parts)"
            )
        return text + "."

    @property
    def _followed(self) -> int:
        """Row of whom the agent is to follow; −1 nobody."""
        followed = self.episode.followed
        return -1 if followed is None else self.episode.people.index(followed)

    @property
    def _side(self) -> int:
        """The run whose people the scene and the plan show: whose eyes are open, else the first."""
        chosen = self._eyes.get(self.camera)
        return chosen if chosen in self._stills else min(self._stills, default=0)

    def _still(self, run: int) -> PeopleStill | None:
        """People of a run at the step shown; as they were at its end when it has ended."""
        stills = self._stills.get(run)
        return stills[min(max(self.step, 0), len(stills) - 1)] if stills else None

    def _mark_people(self) -> tuple[MapPerson, ...]:
        stills = self._stills.get(self._side)
        if not stills:
            return ()
        past = stills[: min(max(self.step, 0), len(stills) - 1) + 1]
        return mark_people([still.places for still in past], past[-1].faces, self._followed)

    def _show_people(self, run: int, pose: Pose2D, focal: float) -> tuple[Instance, ...]:
        """People of a run as an eye at a pose sees them."""
        still = self._still(run)
        if still is None or self._past is None:
            return ()
        return self._past.eyes.show(still, pose, focal)[0]

    def _draw(self) -> None:
        """Pictures of each agent, one under the other, and the plan."""
        assert self.scene is not None and self._plan is not None
        if self._renderer is None:
            self._renderer = build_renderer(self.scene.gaussians)
        self._meet()
        found = [self.replay.pose(run, self.episode, self.step) for run in self.replay.runs]
        there = [(i, pose) for i, pose in enumerate(found) if pose is not None]
        camera = clip_camera(self.preset.rgb, VIEW_HEIGHT)
        pitch = math.radians(self.preset.pitch_degrees)
        height = self.agent.camera_height
        pictures: dict[int, U8] = {}
        for i, pose in there:
            view = view_from_pose(pose.x, pose.y, height, pose.yaw, pitch)
            pictures[i] = self._draw_eyes(i, pose, camera, view)
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
            agents,
            reference=self.episode.path,
            goal=None if self.episode.followed is not None else self.episode.goal,
            people=self._mark_people(),
        )
        self._drawn = True
        self._look()

    def _draw_eyes(self, run: int, pose: Pose2D, camera: Camera, view: F64) -> U8:
        """What a run's agent saw, whom it is to follow in a frame."""
        assert self._renderer is not None
        parts = self._show_people(run, pose, camera.fx)
        more: dict[str, Any] = {"parts": parts} if parts else {}
        drawn = self._renderer.render(
            camera, view[None], outputs=("rgb",), background=self.preset.background, **more
        ).rgb
        assert drawn is not None
        picture = np.array(drawn[0], np.uint8)
        still = self._still(run)
        if parts and still is not None and self._followed >= 0:
            assert self._past is not None
            number = self._past.eyes.want(still, pose, camera.fx).numbers
            wanted = self.episode.people[self._followed].number
            if wanted in number:
                who = self._past.eyes.renderer.render_who(camera, view[None], [parts])
                frame_person(picture, who.seen[0][number.index(wanted)].box)
        return picture

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
        self._people.show(chosen is None, tracks=chosen is None)
        if self._stills:
            self._crowd.content = self._tell_people()
            self._show(self.step)  # it may be others who are shown
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
                show = partial(self._show_people, chosen, pose)
                self.eyes.show(self._renderer, pose, show=show)
