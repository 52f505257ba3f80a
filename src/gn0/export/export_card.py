"""The README of an export: what it is, where it comes from, who reads it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from gn0.export.trips import ExportSource
from gn0.missions.episode import tell_pace
from gn0.storage import write_text

if TYPE_CHECKING:
    from gn0.export.export_file import ExportFile
    from gn0.export.exporter import DatasetExporter

CARD = "README.md"


def write_card(
    folder: Path, exporter: DatasetExporter, source: ExportSource, about: ExportFile
) -> None:
    """Write `README.md`: facts only.

    Raises:
        StorageError: it cannot be written.
    """
    rows = [
        ("format", exporter.title),
        ("read by", exporter.reader),
        ("episodes", f"{about.written:,}"),
        ("splits", ", ".join(f"{k} {v:,}" for k, v in about.splits.items())),
        ("frame", exporter.frame),
    ]
    if about.agent is not None:
        body = about.agent
        rows.append(
            (
                "agent",
                f"steps of {body.forward_step:g} m, turns of {body.turn_degrees:g}°, eye at "
                f"{body.camera_height:g} m, radius {body.radius:g} m{tell_pace(body)}",
            )
        )
    if exporter.pictures:
        rows.append(("frames", f"{about.frames:,} for each camera"))
        for preset in exporter.cameras(source, about.settings):
            width, height = preset.picture_size
            rows.append(
                (
                    "camera",
                    f"{preset.name}: {width}×{height}, horizontal field of view "
                    f"{preset.rgb.hfov:.2f}°, vertical {preset.rgb.vfov:.2f}°",
                )
            )
    lines = [
        f"# {source.name}, as {exporter.title}",
        "",
        "Written by `gn0 export` from Gaussian splatting scenes; episodes, poses and labels are "
        "GN-Matrix data.",
        "",
        "| | |",
        "| --- | --- |",
        *(f"| {name} | {_cell(text)} |" for name, text in rows),
        "",
        "## Left out",
        "",
        *([f"- {count:,} × {why}" for why, count in about.skipped.items()] or ["Nothing."]),
    ]
    if about.notes:
        lines += ["", "## Counted", ""]
        lines += [f"- {count:,} × {what}" for what, count in about.notes.items()]
    remarks = exporter.remarks(folder)
    if remarks:
        lines += ["", "## To know", "", *(f"- {_cell(remark)}" for remark in remarks)]
    lines += ["", "## Scenes", "", "| scene | source | licence |", "| --- | --- | --- |"]
    lines += [
        f"| {_cell(card.id)} | {_cell(card.source)} | {_cell(card.licence or 'not stated')} |"
        for _, card in sorted(source.scenes.items())
    ]
    lines += ["", "Check it with", "", f"    gn0 export check {folder.name}", ""]
    write_text(folder / CARD, "\n".join(lines))


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")
