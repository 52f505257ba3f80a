"""A bare capture as a scene: splats in any format we read, and nothing else."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from gn0.errors import SceneError
from gn0.gaussians.cloud_file import CloudFile
from gn0.gaussians.splat_files import load_cloud
from gn0.geometry import quaternion_from_rotation
from gn0.progress import Progress, no_progress
from gn0.scenes.capture.closed_doors import ClosedDoor, find_closed_doors, open_doors
from gn0.scenes.capture.objects import CaptureLabels, find_things
from gn0.scenes.capture.pose import CapturePose, propose_pose
from gn0.scenes.capture.settings import CaptureSettings, check_capture_settings
from gn0.scenes.capture.splat_occupancy import (
    CaptureOccupancy,
    build_capture_occupancy,
    main_extent,
)
from gn0.scenes.scene import Scene, SceneSourceInfo
from gn0.scenes.scene_sources import ImportSettings, scene_id_from

SUFFIXES = (".ply", ".splat", ".ksplat", ".spz", ".sog", ".glb", ".gltf")
TOPICS = (  # of evidence, in reading order
    "up", "floor", "levels", "scale", "votes", "yaw", "doors", "map", "ground", "labels",
)  # fmt: skip
INDEXES = ("meta.json", "lod-meta.json")  # of unbundled and of streamed SOG folders


class SceneSourceCapture:
    """A splat file, or a folder of SOG pictures."""

    name = "capture"
    looked_for = "a .ply, .splat, .ksplat, .spz, .sog or .glb file of splats, or a SOG folder"

    def recognises(self, path: Path) -> bool:
        """Whether it is named like a splat file, or is a SOG folder."""
        try:
            if path.is_dir():
                return any((path / name).is_file() for name in INDEXES)
            return path.is_file() and (path.suffix.lower() in SUFFIXES or path.name in INDEXES)
        except OSError:
            return False

    def build(
        self, path: Path, settings: ImportSettings, progress: Progress = no_progress
    ) -> Scene:
        """Read, turn upright, put on the floor, map, label.

        Raises:
            FormatError, StorageError: the file is damaged or unreadable.
            SceneError: no floor, or no open floor; says what to give instead.
            ConfigError: a setting does not make sense.
        """
        told = check_capture_settings(settings.capture)
        progress("reading splats", 0, 6)
        file = load_cloud(path, level=told.level)
        progress("finding up, floor and scale", 1, 6)
        found = ""
        try:
            pose = propose_pose(file.cloud, told)
            found = _found_words(pose)
            progress("turning upright", 2, 6)
            cloud = pose.apply(file.cloud)
            progress("looking for closed doors", 3, 6)
            doors = find_closed_doors(cloud, pose.ceiling, ground=pose.ground)
            taken = 0
            if told.open_doors and any(door.leads for door in doors):
                stays = open_doors(cloud, tuple(door for door in doors if door.leads))
                taken = int((~stays).sum())
                cloud = cloud.select(np.flatnonzero(stays))
            progress("mapping", 4, 6)
            occupancy = build_capture_occupancy(
                cloud,
                resolution=settings.resolution,
                band=settings.height_band,
                noise=pose.noise,
                seed=told.seed_point,
                ground=pose.ground,
                progress=progress,
            )
            refuse_tiny(occupancy, told)
        except SceneError as error:
            what = f"{error.what}; no scene was written; {found}" if found else error.what
            raise SceneError(what, where=error.where or path, remedy=error.remedy) from None
        progress("finding things", 5, 6)
        labels = find_things(occupancy, settings.height_band, pose.walls)
        progress("finding things", 6, 6)
        low, high = main_extent(cloud)
        return Scene(
            id=settings.scene_id or scene_id_from(path.resolve().stem),
            source=SceneSourceInfo(
                kind=self.name,
                detail=_detail(file),
                settings={
                    **describe_capture(settings, pose, occupancy, labels),
                    **describe_doors(doors, occupancy, told.open_doors, taken),
                },
                label_source="heuristic" if labels.objects else "none",
            ),
            grid=occupancy.grid,
            objects=labels.objects,
            rooms=labels.rooms.rooms,
            bounds=np.stack([low, high]).astype(np.float64),
            load_cloud=lambda: cloud,
        )


def _found_words(pose: CapturePose) -> str:
    """What a frame rests on, for a message that asks for something better."""
    topics = [t for t in ("up", "floor", "scale", "votes") if t in pose.evidence]
    words = "; ".join(
        f"{topic}: {pose.evidence[topic].split('; runner-up')[0]}" for topic in topics
    )
    return f"found were {words}" + "".join(f"; doubtful: {d}" for d in pose.doubts.values())


def refuse_tiny(occupancy: CaptureOccupancy, settings: CaptureSettings) -> None:
    """Ask where hardly any ground is walkable: something that was proposed must be wrong.

    Raises:
        SceneError: how little it is, and what can be said instead.
    """
    area = occupancy.grid.free_area
    if area >= settings.least_area:
        return
    x0, y0, x1, y1 = occupancy.grid.bounds
    ways = [
        f"--scale or --scale-from (the map is now {x1 - x0:.3g} x {y1 - y0:.3g} m)",
        "--up or --floor HEIGHT if it lies wrong",
        "--height-band LOW HIGH for a lower body",
    ]
    if occupancy.left_out >= 0.5:
        ways.insert(
            0, f"--seed-point X Y ({occupancy.left_out:.1f} m² of other open floor was left out)"
        )
    raise SceneError(
        f"only {area:.2f} m² of ground can be walked on",
        remedy=f"give {', '.join(ways)}; or --least-area {max(area - 0.005, 0):.2f} to take it "
        "as it is",
    )


def describe_capture(
    settings: ImportSettings, pose: CapturePose, occupancy: CaptureOccupancy, labels: CaptureLabels
) -> dict[str, str | int | float | bool | None]:
    """What `scene.json` records: the frame, the evidence for it, and what is doubtful."""
    quat = quaternion_from_rotation(pose.rotation)[0]
    low, high = settings.height_band
    grid = occupancy.grid
    layers = f"{low:g} to {high:g} m"
    out: dict[str, str | int | float | bool | None] = {
        "height_band_low": low,
        "height_band_high": high,
        "resolution": grid.resolution,
        "ceiling": None if pose.ceiling is None else round(pose.ceiling, 3),
        "frame_rotation": " ".join(f"{v:.9g}" for v in quat),
        "frame_scale": float(pose.scale),
        "frame_lift": round(float(pose.lift), 6),
        "seed_x": round(occupancy.seed[0], 3),
        "seed_y": round(occupancy.seed[1], 3),
    }
    if pose.found.tally is not None:
        for vote in pose.found.tally.votes:
            out[f"vote_{vote.kind.replace(' ', '_')}"] = float(f"{vote.scale:.6g}")
    for topic, words in pose.evidence.items():
        out[f"evidence_{topic}"] = words
    out["evidence_map"] = (
        f"extinction over one half between {layers}; clumps under 30 voxels left out "
        f"({occupancy.floating:,} voxels); points stray {1000 * pose.noise:.1f} mm from their "
        f"surface; flooded from ({occupancy.seed[0]:.2f}, "
        f"{occupancy.seed[1]:.2f}): {grid.free_area:.1f} m² free"
        + (f", {occupancy.left_out:.1f} m² of other open floor left out"
           if occupancy.left_out >= 0.5 else "")
    )  # fmt: skip
    if labels.objects:
        out["evidence_labels"] = (
            f"{len(labels.objects)} clumps of voxels named by shape alone; edit labels.json"
        )
    for topic, words in pose.doubts.items():
        out[f"doubt_{topic}"] = words
    if occupancy.outside > 0.5 * occupancy.open_floor:
        out["doubt_ground"] = (
            f"most of the ground lies outside the walls ({occupancy.outside:.0f} of "
            f"{occupancy.open_floor:.0f} m²): the map starts "
            + ("there as told" if occupancy.seed_outside else "within them")
            + "; what lies outside is walkable only where a way out was scanned"
        )
    rooms = occupancy.left_out - (0.0 if occupancy.seed_outside else occupancy.outside)
    if rooms > max(1.0, 0.1 * grid.free_area) and math.isfinite(rooms):
        out["doubt_map"] = (
            f"{rooms:.1f} m² of open floor cannot be reached from the seed: to walk "
            "there instead, give --seed-point X Y"
        )
    return out


def describe_doors(
    doors: tuple[ClosedDoor, ...], occupancy: CaptureOccupancy, opened: bool, taken: int
) -> dict[str, str | int | float | bool | None]:
    """What `scene.json` records of doors found closed: where, and what was done about them."""
    leading = [door for door in doors if door.leads]
    out: dict[str, str | int | float | bool | None] = {"doors_closed": len(doors)}
    if not doors:
        if opened:
            out["evidence_doors"] = "no closed door was found, so none was opened"
        return out
    named = "; ".join(door.words for door in doors)
    out["evidence_doors"] = f"{len(doors)} found closed, at {named}"
    if not opened:
        if leading:
            out["doubt_doors"] = (
                f"{len(leading)} closed doors block the way between places whose floor was seen: "
                "to take their leaves out of the splats and the map, give --open-doors"
            )
        return out
    out["doors_opened"] = len(leading)
    out["evidence_doors"] = (
        f"{out['evidence_doors']}; {len(leading)} opened: the {taken:,} splats of their leaves and "
        "handles were taken out, and the map was made without them"
    )
    shut = [door.words for door in leading if not occupancy.grid.is_free(*door.centre)]
    if shut:
        out["doubt_doors"] = f"opened, but still no way through: {'; '.join(shut)}"
    return out


def evidence_lines(source: SceneSourceInfo) -> list[str]:
    """The evidence of a capture's frame and then the doubts, a line each, as a user reads them."""
    known = source.settings
    lines = [
        f"  {topic:<7}{known[f'evidence_{topic}']}"
        for topic in TOPICS
        if f"evidence_{topic}" in known
    ]
    return lines + [f"  doubtful: {known[f'doubt_{t}']}" for t in TOPICS if f"doubt_{t}" in known]


def _detail(file: CloudFile) -> str:
    words = f"{file.path.name}, {file.format}, {file.stored:,} splats, SH degree {file.sh_degree}"
    if file.dropped:
        words += f"; {file.dropped} not finite left out"
    return words
