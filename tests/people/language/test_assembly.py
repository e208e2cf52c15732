"""Readings become frames: counts, denials, unknown names, no preference, foreign sentences."""

import pytest
from readings import read
from tables import pairs, rows

from bbq_torchrl.people.language import Frame, Unclear
from bbq_torchrl.people.language.assembly import is_denied
from bbq_torchrl.people.language.words import tokenize

ASKED = Frame("request", {}, ("date",))


def doubt(text):
    """Returns what is unclear, as the last column of a row has it."""
    slot, words, meant = text.split(": ")
    candidates = () if meant in ("unknown", "denied") else tuple(meant.split(", "))
    return Unclear(slot, words, candidates, is_denied=meant == "denied")


@pytest.mark.parametrize("row", rows(__file__, "readings.txt"), ids=lambda row: row[0])
def test_a_reading_becomes_the_likeliest_frame(lexicon, row):
    text, act, tagged, asked, question, meant, *doubted = row
    chances = {slot: float(chance) for slot, chance in pairs(asked).items()}
    free = {name[4:]: chance for name, chance in chances.items() if name.startswith("any ")}
    question = Frame.parse(question) if question else None
    read_as = {"act": act, "asked": chances, "free": free}
    frame, unclear = read(text, pairs(tagged), lexicon, question, **read_as)
    assert (str(frame), unclear) == (meant, tuple(map(doubt, doubted)))


@pytest.mark.parametrize(("denied", "text"), rows(__file__, "denials.txt"))
@pytest.mark.parametrize("is_tagged", [True, False])
def test_a_denied_value_is_reported_and_not_informed(lexicon, denied, text, is_tagged):
    words = tokenize(text)
    (at,) = [place for place, word in enumerate(words) if word.startswith("friday")]
    assert is_denied(words, at, at + 1) == (denied == "yes")
    frame, unclear = read(text, {words[at]: "date"} if is_tagged else {}, lexicon, ASKED)
    if denied == "yes":
        assert "date" not in frame.informs
        if is_tagged:
            assert [(one.slot, one.is_denied) for one in unclear] == [("date", True)]
    elif is_tagged:
        assert (frame.informs, unclear) == ({"date": "friday"}, ())


def test_an_unknown_word_names_what_was_asked_for_unless_it_is_polite(lexicon):
    question = Frame("request", {}, ("theater",))
    for new, names in (("xylqo", (Unclear("theater", "xylqo"),)), ("please", ())):
        frame, unclear = read("the xylqo please", {}, lexicon, question, new=new)
        assert (frame, unclear) == (Frame("inform"), names)
