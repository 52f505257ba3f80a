"""Whether a scene source keeps the protocol: run a plug-in's class against it.

from gn0.testing.source_check import check_source
check_source(MySource, "path/to/an/example")
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from gn0.errors import Gn0Error
from gn0.progress import no_progress
from gn0.scenes.check import check_scene
from gn0.scenes.folder import load_scene, save_scene
from gn0.scenes.scene_sources import ImportSettings, SceneSource


def check_source(
    factory: Callable[[], SceneSource],
    example: Path | str,
    settings: ImportSettings | None = None,
) -> None:
    """Check a scene source on an example that it should recognise.

    Args:
        factory: builds the source (a class without required arguments will do).
        example: files of its kind.
        settings: import settings; by default few splats, so that the check is quick.

    Raises:
        AssertionError: the first rule that is broken, in plain words.
    """
    example = Path(example)
    settings = settings or ImportSettings(density=200, scene_id="check")
    source = factory()
    assert source.name, "the source has no name"
    assert source.looked_for, "the source does not say what it looks for"
    assert source.recognises(example), f"{source.name} does not recognise {example}"
    with tempfile.TemporaryDirectory() as scratch:
        empty = Path(scratch) / "empty"
        empty.mkdir()
        for stranger in (empty, empty / "absent"):
            assert source.recognises(stranger) is False, f"it recognises {stranger.name}"
            _fails_in_our_words(source, stranger, settings)
        first = source.build(example, settings, no_progress)
        again = factory().build(example, settings, no_progress)
        assert first.content_hash == again.content_hash, "two imports of one source differ"
        if settings.scene_id:
            assert first.id == settings.scene_id, "the scene id asked for is not used"
        saved = save_scene(first, Path(scratch) / "scene")
        loaded = load_scene(Path(scratch) / "scene")
        assert loaded.content_hash == saved.content_hash, "the scene does not read back"
        assert len(loaded.gaussians) == len(first.gaussians), "splats were lost in writing"
        errors = [f.text for f in check_scene(loaded) if f.level == "error"]
        assert not errors, f"the scene is unfit: {errors[0]}"


def _fails_in_our_words(source: SceneSource, path: Path, settings: ImportSettings) -> None:
    try:
        source.build(path, settings, no_progress)
    except Gn0Error:
        return
    except Exception as error:
        raise AssertionError(
            f"building from {path.name} raised {type(error).__name__}, not a Gn0Error"
        ) from error
    raise AssertionError(f"building from {path.name} did not fail")
