"""Answers slot by slot: forms convert without loss, and a decoder allows what the parser reads."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gn0.config import decode_json
from gn0.data.answer_form import POINTS_OF, AnswerForm
from gn0.data.answer_grammar import write_grammar
from gn0.data.answer_slots import FREE, AnswerSlots, compile_slots
from gn0.data.codec import (
    NAVIGATION_TOKENS,
    ORDERS,
    Answer,
    parse_answer,
    without_control_tokens,
    write_answer,
)
from gn0.data.navigation_vocabulary import (
    NavigationVocabulary,
    add_navigation_tokens,
    load_vocabulary,
)
from gn0.errors import ConfigError, FormatError
from gn0_trials.toy_tokenizer import ToyTokenizer

ROWS = 1344  # of a model: padded to a multiple of 64
FORMS = [
    AnswerForm(points=points, order=order, layout=layout, current_said=said)  # type: ignore[arg-type]
    for points in POINTS_OF.values()
    for order in ORDERS
    for layout, said in (("json", False), ("compact", False), ("compact", True))
]
codes = st.lists(st.integers(0, 3), min_size=6, max_size=6).map(tuple)
pair = st.tuples(st.integers(0, 999), st.integers(0, 999))
forms = st.sampled_from(FORMS)


def answers(form: AnswerForm) -> st.SearchStrategy[Answer]:
    way = st.lists(pair, min_size=form.points, max_size=form.points).map(tuple)
    return st.builds(Answer, codes, way if form.points else st.none())


def make() -> tuple[ToyTokenizer, NavigationVocabulary]:
    tokenizer = ToyTokenizer()
    return tokenizer, add_navigation_tokens(tokenizer, rows=ROWS)


TOKENIZER, VOCABULARY = make()
COMPILED = {form: compile_slots(form, VOCABULARY, TOKENIZER) for form in FORMS}


# ------------------------------------------------------------------------------- forms


@given(forms, st.data())
def test_every_form_reads_what_it_writes(form: AnswerForm, data: st.DataObject) -> None:
    answer = data.draw(answers(form))
    current = answer.tokens[0] if answer.tokens else None
    text = form.write(answer)
    assert form.read(text, current) == answer
    if not form.first_point:
        assert form.read(f" {text}\n") == answer
        found = parse_answer(text, points=form.points, layout=form.layout)  # both orders
        assert found == answer


@given(forms, forms, st.data())
def test_forms_of_as_many_points_convert_without_loss(
    form: AnswerForm, other: AnswerForm, data: st.DataObject
) -> None:
    other = msgspec.structs.replace(other, points=form.points)
    answer = data.draw(answers(form))
    current = answer.tokens[0] if answer.tokens else None
    there = form.convert(form.write(answer), other, current)
    assert there == other.write(answer)
    assert other.convert(there, form, current) == form.write(answer)


def test_what_a_compact_text_would_lose_is_not_converted() -> None:
    long, short = AnswerForm(), AnswerForm(layout="compact")
    text = long.write(Answer((1,) * 6, ((5, 6),) * 13))
    with pytest.raises(ConfigError, match="would be lost"):
        long.convert(text, short, (5, 7))
    with pytest.raises(ConfigError, match="point 0"):
        long.convert(text, short)
    with pytest.raises(ConfigError, match="point 0"):
        short.read(short.write(Answer((1,) * 6, ((5, 6),) * 13)))
    with pytest.raises(FormatError, match="point 0 is"):
        long.read(text, (5, 7))
    whole = AnswerForm(layout="compact", current_said=True)
    assert whole.convert(long.convert(text, whole), long) == text


def test_a_compact_answer_is_24_coordinates_6_actions_and_2_brackets() -> None:
    form = AnswerForm(layout="compact")
    text = form.write(Answer((1, 1, 2, 3, 0, 0), tuple((n, 2 * n) for n in range(13))))
    assert text.startswith("<1><2><2><4>") and text.endswith(
        "<12><24><action><FWD><FWD><LEFT><RIGHT><STOP><STOP></action>"
    )
    slots = form.slots()
    assert len(slots) == 32 == len(COMPILED[form]) - 1  # and the end
    assert sum(not slot.forced for slot in slots) == 30
    assert len(AnswerForm(layout="compact", current_said=True).slots()) == 34


@pytest.mark.parametrize(("task", "chosen"), [("planning", 30), ("tracking", 18), ("views", 6)])
def test_where_the_agent_stands_is_forced(task: str, chosen: int) -> None:
    for form in (f for f in FORMS if f.points == POINTS_OF[task]):
        slots = COMPILED[form]
        assert int(slots.chosen.sum()) == chosen
        forced = slots.forced(np.array([[7, 8], [9, 10]]))
        assert ((forced == FREE).sum(axis=1) == chosen).all()
        told = form.slots((7, 8))
        assert sum(not slot.forced for slot in told) == chosen
        if form.points and not form.first_point:
            at = [slot.choices for slot in told if slot.number == 0 and slot.role in ("x", "y")]
            assert at == [("<7>",), ("<8>",)]


def test_a_form_is_kept_as_json_and_says_one_thing_one_way() -> None:
    for form in FORMS:
        assert decode_json(msgspec.json.encode(form), AnswerForm) == form
    assert AnswerForm(current_said=True) == AnswerForm()
    with pytest.raises(ConfigError):
        AnswerForm(points=1)
    with pytest.raises(FormatError):
        decode_json('{"order": "vlnce"}', AnswerForm)
    with pytest.raises(ConfigError, match="no place"):
        AnswerForm().slots((5, 1000))
    with pytest.raises(ConfigError, match="12 points"):
        AnswerForm().write(Answer((1,) * 6, ((1, 2),) * 12))


# ------------------------------------------------------------------------------- ids


@given(forms, st.data())
def test_ids_are_those_of_the_text(form: AnswerForm, data: st.DataObject) -> None:
    given_answers = data.draw(st.lists(answers(form), min_size=1, max_size=4))
    slots = COMPILED[form]
    actions = np.array([a.actions for a in given_answers])
    way = np.array([a.tokens for a in given_answers]) if form.points else None
    ids = slots.encode(actions, way)
    for row, answer in zip(ids.tolist(), given_answers, strict=True):
        assert row == [*TOKENIZER.encode(form.write(answer)), VOCABULARY.end]
    current = way[:, 0] if way is not None else None
    said, back = slots.decode(ids, current)
    assert (said == actions).all() and (back is None) == (way is None)
    assert back is None or (back == way).all()
    mask = slots.mask()
    assert mask.shape == (len(slots), ROWS)
    assert mask[np.arange(len(slots)), ids].all()
    assert not mask[:, VOCABULARY.padded_rows()].any()
    assert [int(n) for n in mask.sum(axis=1)] == [len(slots.allowed(k)) for k in range(len(slots))]


@given(forms, st.data())
def test_an_id_that_may_not_stand_there_is_named(form: AnswerForm, data: st.DataObject) -> None:
    slots = COMPILED[form]
    answer = data.draw(answers(form))
    current = answer.tokens[0] if answer.tokens else None
    ids = slots.encode(
        np.array([answer.actions]), np.array([answer.tokens or ()]).reshape(1, -1, 2)
    )
    at = data.draw(st.integers(0, len(slots) - 1))
    wrong = data.draw(st.integers(-1, ROWS))
    ids[0, at] = wrong
    place = None if current is None else np.array([current])
    fits = wrong in slots.allowed(at) and slots.forced(place)[0, at] in (FREE, wrong)
    if fits:
        slots.decode(ids, place)
    else:
        with pytest.raises(FormatError, match=f"slot {at} of answer 0"):
            slots.decode(ids, place)


def accepts(slots: AnswerSlots, ids: list[int], current: Any = None) -> Answer | None:
    """What the decoder makes of ids; None if it refuses one, or they end too early."""
    decoder = slots.decoder(current)
    for own in ids:
        try:
            decoder.accept(own)
        except FormatError:
            return None
    return decoder.answer() if decoder.done else None


MENDS = ["", "0", "<", ">", ",", " ", "[", "}", '"', "<FWD>", "<7>", "<1000>", "</action>", "7"]


@settings(max_examples=80)
@given(forms, st.booleans(), st.data())
def test_the_decoder_accepts_exactly_what_the_strict_parser_reads(
    form: AnswerForm, knows: bool, data: st.DataObject
) -> None:
    """Any change of a text is refused by both, or read by both as the same answer."""
    answer = data.draw(answers(form))
    text = form.write(answer)
    for _ in range(data.draw(st.integers(0, 2))):
        at = data.draw(st.integers(0, len(text)))
        piece = data.draw(st.sampled_from(MENDS))
        text = text[:at] + piece + text[at + data.draw(st.integers(0, 5)) :]
    text = text.strip()  # white space around it is forgiven by the parser alone
    current = answer.tokens[0] if answer.tokens and (knows or form.first_point) else None
    try:
        read: Answer | None = form.read(text, current)
    except FormatError:
        read = None
    ids = [*TOKENIZER.encode(text), VOCABULARY.end]
    assert accepts(COMPILED[form], ids, current) == read
    orders = [
        accepts(COMPILED[msgspec.structs.replace(form, order=order)], ids) for order in ORDERS
    ] if not form.first_point else []  # fmt: skip
    try:
        either = parse_answer(text, points=form.points, layout=form.layout)
    except FormatError:
        either = None
    if not form.first_point:
        assert next((found for found in orders if found), None) == either


@given(forms, st.data())
def test_any_walk_through_the_decoder_is_an_answer(form: AnswerForm, data: st.DataObject) -> None:
    """Choosing among what is allowed, and feeding what is forced, ends in a text that is read."""
    slots = COMPILED[form]
    current = data.draw(pair) if form.points else None
    decoder, chosen = slots.decoder(current), 0
    while not decoder.done:
        run = decoder.forced_run()
        if run:
            for own in run:
                assert decoder.allowed().tolist() == [own]
                decoder.accept(own)
            continue
        allowed = decoder.allowed()
        assert len(allowed) in (4, 1000) and (np.diff(allowed) > 0).all()
        decoder.accept(int(allowed[data.draw(st.integers(0, len(allowed) - 1))]))
        chosen += 1
    assert chosen == int(slots.chosen.sum()) and not len(decoder.allowed())
    text = TOKENIZER.decode(decoder.ids)  # the end is special, and left out
    assert form.read(text, current) == decoder.answer()
    with pytest.raises(FormatError, match="may not come"):
        decoder.accept(0)


@pytest.mark.parametrize("form", FORMS, ids=lambda f: f"{f.points}-{f.order}-{f.layout}")
def test_the_ids_beside_the_allowed_ones_are_refused_everywhere(form: AnswerForm) -> None:
    slots, rng = COMPILED[form], np.random.default_rng(0)
    way = rng.integers(1, 999, (1, form.points, 2))
    current = tuple(way[0, 0].tolist()) if form.points else None
    ids = slots.encode(rng.integers(0, 4, (1, 6)), way)
    decoder = slots.decoder(current)
    place = None if current is None else np.array([current])
    for slot, own in enumerate(ids[0].tolist()):
        allowed = decoder.allowed()
        beside = {0, ROWS, int(allowed[0]) - 1, int(allowed[-1]) + 1} - set(allowed.tolist())
        for wrong in beside:
            with pytest.raises(FormatError, match=f"place {slot} of"):
                decoder.accept(wrong)
            changed = ids.copy()
            changed[0, slot] = wrong
            with pytest.raises(FormatError, match=f"slot {slot} of"):
                slots.decode(changed, place)
        decoder.accept(own)
    assert decoder.done


def test_batches_that_do_not_fit_are_refused() -> None:
    slots = COMPILED[AnswerForm()]
    good = np.ones((2, 6), int), np.ones((2, 13, 2), int)
    assert slots.encode(*good).shape == (2, len(slots))
    for actions, way in (
        (np.ones((2, 5), int), good[1]),
        (np.full((2, 6), 4), good[1]),
        (good[0], None),
        (good[0], np.ones((1, 13, 2), int)),
        (good[0], np.ones((2, 12, 2), int)),
        (good[0], np.full((2, 13, 2), -1)),
        (good[0], np.full((2, 13, 2), 1000)),
    ):
        with pytest.raises(ConfigError):
            slots.encode(actions, way)
    with pytest.raises(FormatError, match="tokens, expected"):
        slots.decode(np.ones((1, 3), int))
    with pytest.raises(ConfigError, match="no place"):
        slots.forced(np.array([[1, 1000]]))
    with pytest.raises(ConfigError, match="point 0"):
        short = COMPILED[AnswerForm(layout="compact")]
        short.decode(short.encode(*good))


# ------------------------------------------------------------------------- vocabulary


def test_the_tokens_come_last_and_in_order() -> None:
    tokenizer = ToyTokenizer()
    before = len(tokenizer)
    found = add_navigation_tokens(tokenizer, rows=ROWS)
    assert found.first == found.number == before and found.size == before + 1006
    assert (
        found
        == load_vocabulary(tokenizer, rows=ROWS)
        == add_navigation_tokens(tokenizer, rows=ROWS)
    )
    assert int(found.padded_rows().sum()) == ROWS - found.size
    assert [found.id_of(token) for token in NAVIGATION_TOKENS] == list(range(before, before + 1006))


def _gap(tokenizer: ToyTokenizer) -> None:
    tokenizer.add_tokens([*NAVIGATION_TOKENS[:500], "<gap>", *NAVIGATION_TOKENS[500:]])


@pytest.mark.parametrize(
    ("prepare", "word"),
    [
        (lambda t: None, "1006 of 1006 navigation tokens are missing"),
        (lambda t: t.add_tokens(NAVIGATION_TOKENS[1:]), "1 of 1006"),
        (_gap, "have a gap: <500>"),
        (lambda t: t.add_tokens(NAVIGATION_TOKENS[::-1]), "have a gap: <1>"),
        (lambda t: t.add_tokens([*NAVIGATION_TOKENS, "</action><FWD>"]), "as one token"),
    ],
)
def test_a_tokenizer_that_would_not_work_is_refused(prepare: Any, word: str) -> None:
    tokenizer = ToyTokenizer()
    prepare(tokenizer)
    with pytest.raises(FormatError, match=word):
        load_vocabulary(tokenizer)


def test_what_else_is_refused_says_what_to_do() -> None:
    with pytest.raises(FormatError, match="special=False"):
        add_navigation_tokens(ToyTokenizer(adds_special=True))
    with pytest.raises(FormatError, match="1200 rows for"):
        add_navigation_tokens(ToyTokenizer(), rows=1200)
    with pytest.raises(FormatError, match="ends an answer"):
        add_navigation_tokens(ToyTokenizer(()))
    assert add_navigation_tokens(ToyTokenizer(()), end=None).end is None
    half = ToyTokenizer()
    half.add_tokens(NAVIGATION_TOKENS[:3])
    with pytest.raises(FormatError, match="has 3 of 1006"):
        add_navigation_tokens(half)


TYPED = [*NAVIGATION_TOKENS[::97], "<", ">", "|", "im_end", "<|", "go", "</", "<|im_end|>"]


@settings(max_examples=300)
@given(st.text(max_size=80) | st.lists(st.sampled_from(TYPED)).map("".join))
def test_no_text_of_a_user_gives_one_of_the_tokens(text: str) -> None:
    ids = TOKENIZER.encode(without_control_tokens(text))
    assert all(own < VOCABULARY.first and own not in TOKENIZER.special for own in ids)


# --------------------------------------------------------------------------- grammars


@pytest.mark.parametrize("form", FORMS, ids=lambda f: f"{f.points}-{f.order}-{f.layout}")
def test_a_grammar_has_a_place_for_each_slot(form: AnswerForm) -> None:
    slots = COMPILED[form]
    for dialect in ("llguidance", "xgrammar"):
        text = write_grammar(slots, dialect)
        first = next(line for line in text.splitlines() if line.startswith(("start", "root")))
        assert len(first.split(":", 1)[1].removeprefix(":=").split()) == len(slots) - 1
    with pytest.raises(ConfigError):
        write_grammar(slots, "gbnf")  # type: ignore[arg-type]


def test_the_answer_text_has_one_home() -> None:
    """A compact text and a JSON text are written by the codec alone."""
    answer = Answer((1, 1, 2, 3, 0, 0), ((12, 34), (5, 6)))
    for form in (AnswerForm(points=2), AnswerForm(points=2, layout="compact", current_said=True)):
        assert form.write(answer) == write_answer(
            answer.actions, answer.tokens, order=form.order, layout=form.layout
        )
