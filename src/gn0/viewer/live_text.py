"""Texts on viser's page, ours and others'.

viser's Markdown passes raw HTML through, and scene files are written by strangers. So whatever
does not come from this package goes through `plain` before it meets Markdown.
"""

from __future__ import annotations

import re

_SPECIAL = re.compile(r"[^\w ,.;:!?%°·–—/()']|_")  # all but letters, digits and calm signs


def plain(text: object, limit: int = 200) -> str:
    """Text that Markdown and HTML show as it is: one line, no mark-up, cut at `limit` letters."""
    line = " ".join(str(text).split())
    if len(line) > limit:
        line = line[: limit - 1].rstrip() + "…"
    # numeric entities are the one escape that both HTML and Markdown take literally
    return _SPECIAL.sub(lambda found: f"&#{ord(found.group())};", line)


def name_line(text: object, limit: int = 80) -> str:
    """Text for a label or a list entry, which viser shows literally: one line, cut."""
    line = "".join(c if c.isprintable() else " " for c in " ".join(str(text).split()))
    return line if len(line) <= limit else line[: limit - 1].rstrip() + "…"


def table(head: list[str], rows: list[list[str]]) -> str:
    """A Markdown table of cells that are already plain."""
    lines = ["| " + " | ".join(head) + " |", "|" + " --- |" * len(head)]
    return "\n".join(lines + ["| " + " | ".join(row) + " |" for row in rows])
