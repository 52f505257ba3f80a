"""The live view of a bare splat file: look round, without a body, as no floor is known."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from gn0.gaussians.cloud_file import CloudFile
from gn0.geometry import F64
from gn0.viewer.live_loop import LiveLoop
from gn0.viewer.live_map import AGENT
from gn0.viewer.live_server import LiveServer
from gn0.viewer.live_splats import build_live_splats
from gn0.viewer.live_stage import OVERVIEW_FOV, LiveStage
from gn0.viewer.live_text import plain

UPS = ("+z", "-z", "+y", "-y", "+x", "-x")
PANEL = 320  # width of the panel [px]


class FileView:
    """One splat file on one page.

    Args:
        live: the server.
        path: the file, for its name.
        file: its content.
        loop: the thread that does the work.
        splats: how many splats the browser gets.
        up: which axis of the file points up.
    """

    def __init__(
        self,
        live: LiveServer,
        path: Path,
        file: CloudFile,
        loop: LiveLoop,
        *,
        splats: int,
        up: str = "+z",
    ) -> None:
        self.path, self.file, self.loop = path, file, loop
        self.count, self.up = splats, up
        self.server = live.viser
        self.stage = LiveStage(live.viser)

    def open(self) -> None:
        """Splats and panel."""
        self.server.scene.set_up_direction(self.up)  # type: ignore[arg-type]
        self.stage.start_at(*self._place(), OVERVIEW_FOV)
        live = build_live_splats(self.file.cloud, self.count)
        self.stage.show_splats(live, None)
        gui = self.server.gui
        gui.configure_theme(
            show_logo=False, show_share_button=False, dark_mode=True, brand_color=AGENT
        )
        gui.main_panel.dock_right()
        gui.main_panel.set_width(PANEL)
        total = len(self.file.cloud)
        gui.add_markdown(f"### {plain(self.path.name, 60)}")
        merged = f", merged from {total:,}" if len(live) < total else ""
        gui.add_markdown(
            f"{plain(self.file.format)}: this page shows **{len(live):,}** splats{merged}.\n\n"
            "**W A S D Q E** and arrows fly, the mouse turns."
        )
        ups = gui.add_dropdown(
            "Up", UPS, initial_value=self.up, hint="A file does not say which of its axes is up."
        )
        ups.on_update(lambda event: self.loop.post(partial(self._turn, event.target.value)))
        again = gui.add_button("Whole file")
        again.on_click(lambda event: self.loop.post(self._return))
        gui.add_markdown(
            "To walk in it, make a scene of it: `gn0 scene import FILE --out DIR`, "
            "then `gn0 view DIR`."
        )

    def finish(self) -> None:
        """Nothing is left for later."""

    def tick(self, now: float) -> float | None:
        """Nothing happens by itself."""
        return None

    @property
    def ready(self) -> bool:
        """Always: there is no agent to wait for."""
        return True

    def _axis(self) -> F64:
        axis = np.zeros(3)
        axis["xyz".index(self.up[1])] = -1.0 if self.up[0] == "-" else 1.0
        return axis

    def _place(self) -> tuple[F64, F64]:
        """Where one sees most of the file from, by the middle 96 % of its splats."""
        low, high = np.quantile(self.file.cloud.means.astype(np.float64), [0.02, 0.98], axis=0)
        middle, reach = (low + high) / 2, max(float(np.linalg.norm(high - low)), 1e-3)
        up = self._axis()
        side = np.roll(up, 1) + 0.6 * np.roll(up, 2)
        return middle + reach * (1.05 * side / np.linalg.norm(side) + 0.45 * up), middle

    def _turn(self, up: str) -> None:
        self.up = up
        self.server.scene.set_up_direction(up)  # type: ignore[arg-type]
        self._return()

    def _return(self) -> None:
        position, target = self._place()
        for client in self.server.get_clients().values():
            camera: Any = client.camera
            camera.up_direction = tuple(self._axis())
            camera.position = tuple(position)
            camera.look_at = tuple(target)
