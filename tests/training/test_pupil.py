"""A policy in training is asked in one way, whatever the texts, and is saved with it."""

from __future__ import annotations

import pytest
from msgspec.structs import replace

pytest.importorskip("torch")

from gn0.data.answer_form import AnswerForm
from gn0.errors import CheckpointError, ConfigError
from gn0.policies.bae.policy_settings import PolicySettings, join_inputs
from gn0.sim.ego_map import EgoSquare, MapView
from gn0.training.pupil import ask_anew, build_pupil, fit_texts, load_pupil

SETTINGS = PolicySettings(
    prompt="short",
    pictures=("near", "far"),
    form=AnswerForm(layout="compact"),
    view=MapView((EgoSquare(32, 0.24), EgoSquare(32, 0.6))),
)
TEXTS = ("go to the sofa", "turn left at the door, then wait by the second chair on the right")


def test_the_layout_is_the_same_for_all_texts_that_fit(tmp_path) -> None:
    pupil = build_pupil("nano", SETTINGS, TEXTS)
    full, short = pupil.table(TEXTS), pupil.table(TEXTS[:1])
    assert full.layout.ids.tolist() == short.layout.ids.tolist()
    with pytest.raises(ConfigError, match="shorten the instruction"):
        pupil.table(["find a " + "very " * 90 + "large plant"])
    pupil.save(tmp_path / "policy")
    again = load_pupil(tmp_path / "policy")
    assert again.settings.text_length == pupil.settings.text_length
    assert again.table(TEXTS).layout.ids.tolist() == full.layout.ids.tolist()
    assert again.template.digest == pupil.template.digest


def test_sizes_and_folders_that_are_none_are_refused(tmp_path) -> None:
    with pytest.raises(ConfigError, match="no size 'huge'"):
        build_pupil("huge", SETTINGS, TEXTS)
    with pytest.raises(CheckpointError):
        load_pupil(tmp_path)


def test_no_text_that_a_prompt_was_fitted_to_is_left_out() -> None:
    """Of any length: rounding is no room that one can count on."""
    views = replace(SETTINGS, pictures=("rgb",), form=AnswerForm(points=0, layout="compact"))
    both = join_inputs({"maps": SETTINGS, "views": views})
    pupil = build_pupil("nano", both, TEXTS)
    for many in range(1, 18):
        texts = ["go to the sofa" + ", then the chair" * many, *TEXTS, "go on" + "!" * many]
        fitted = fit_texts(pupil, texts)
        longest = fitted.longest_text
        assert max(len(fitted.words.encode(text)) for text in texts) <= longest
        for one in fitted.inputs.values():
            one.table(texts)


@pytest.mark.slow
def test_a_prompt_that_a_policy_knows_keeps_its_length(tmp_path) -> None:
    """Whatever it is to be told, and whatever pictures it is shown; another one is fitted."""
    pupil = build_pupil("nano", SETTINGS, TEXTS)
    pupil.save(tmp_path / "policy")
    texts = [*TEXTS, "go to the sofa" + ", then the chair" * 9]
    fewer = replace(SETTINGS, pictures=("near",))
    for settings in (SETTINGS, fewer, replace(SETTINGS, without=("heading",))):
        anew = ask_anew(tmp_path / "policy", settings, texts).settings.text_length
        assert (anew == pupil.settings.text_length) == (not settings.without)
    assert fit_texts(pupil, texts).settings.text_length > pupil.settings.text_length
