"""Paths that a stranger's file may name to make a reader leave its folder, or trip over it.

Each is refused by `gn0.storage.safe_join`, on every system alike. Readers, suites, episode sets and
plug-ins are tested against the same list, so that a new way out is closed everywhere at once.
"""

from __future__ import annotations

CLIMBING: dict[str, tuple[str, ...]] = {
    "parent": (
        "..", "../x", "../../etc/passwd", "a/..", "a/../..", "a/../../x", "./../x", "a/./../../x",
        "a//../../x", "../", "a/b/c/../../../../x", ".. ", " ..", "a/.. /x", "...", "a/.../x",
        "../" * 40 + "etc/passwd", ". .", "a/ . /x",
    ),
    "absolute": (
        "/", "/etc/passwd", "//etc/passwd", "///x", "/proc/self/environ", "/dev/zero",
        "/dev/stdin", "~", "~/x", "~root/x", "/./x",
    ),
    "encoded": (
        "%2e%2e/x", "%2E%2E/x", "a%2fb", "%2fetc%2fpasswd", "..%2fx", "%2e./x", ".%2e/x",
        "%5cx", "..%5cx", "a%00b", "x.ply%00.png", "%252e%252e%252fx", "%25252e%25252e/x",
    ),
    "windows": (
        "..\\x", "a\\..\\..\\x", "\\x", "\\\\server\\share\\x", "C:\\x", "C:/x", "c:x", "C:",
        "\\\\?\\C:\\x", "\\\\.\\PhysicalDrive0", "a/..\\x", "x.ply:stream", "x.ply::$DATA",
        "//server/share/x", "//?/C:/x",
    ),
    "device": (
        "CON", "con", "NUL", "nul.ply", "aux", "AUX.json", "PRN", "COM1", "com9.txt", "LPT1",
        "a/con/x", "CONIN$", "nul .ply", "COM¹",
    ),
    "url": (
        "file:///etc/passwd", "http://example.invalid/x", "https:x", "ftp://x", "data:,x",
        "javascript:x", "\\\\example.invalid@80\\x",
    ),
    "hidden": (
        "", "\0", "a\0b", "../\0x", "x.ply\0.png", "a\nb", "a\rb", "a\tb", "\x1b[2Jx", "a\x7fb",
        "a\u202egnp.x", "a\u200bb", "\ufeffx", "a\u2028b", "\x85x",
    ),
    "unicode": (
        "\uff0e\uff0e/x", "\uff0e\uff0e\uff0fx", "\u2024\u2024/x", "\u2025/x", "..\u2215x",
        "..\u2044x", "..\u29f8x", "..\uff3cx", "..\ufe68x", "\uff0fetc/passwd", "\uff23\uff1a/x",
        "\udcc0\udcae\udcc0\udcae/x", "\ud800x", "\u2026/x",
    ),
    "long": ("a" * 256, "a/" * 3000 + "x", "é" * 200, "x" * 100_000),
}  # fmt: skip
"""Refused paths by the trick that they play."""

HARMLESS: tuple[str, ...] = (
    "x", "a/b.txt", "./x", "a/./b", "3dgs_compressed.ply", "gaussians_aux.npz", "..x", "x..",
    "a..b",
    ".hidden", "100%.ply", "a%20b", "Küche/Stühle.glb", "厨房/椅子.ply", "con1", "console.ply",
    "nullable", "a b.ply", "a" * 255, "lod0/chunk_0/meta.json", "means_l.webp",
)  # fmt: skip
"""Plain names that must not be refused."""


def climbing_paths() -> list[str]:
    """All refused paths, in order."""
    return [path for paths in CLIMBING.values() for path in paths]
