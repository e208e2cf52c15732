"""Readings become frames: counts, denials, unknown names, no preference, foreign sentences."""

import pytest
import torch
from tables import pairs, rows

from bbq_torchrl.people.language import Frame, Unclear
from bbq_torchrl.people.language.asking import OPENING
from bbq_torchrl.people.language.assembly import assemble, is_denied
from bbq_torchrl.people.language.model import Reading
from bbq_torchrl.people.language.words import OUTSIDE, tokenize

ASKED = Frame("request", {}, ("date",))


def read(text, tagged, lexicon, question=None, *, act="inform", asked=(), free=(), new=()):
    """Returns the frame and what is unclear of words, as if these were tagged, and this act.

    ``asked`` and ``free`` are the probabilities that slots are asked for, or do not matter, and
    ``new`` the unknown words.
    """
    words, domain = tokenize(text), lexicon.domain
    tags = [tagged.get(word, OUTSIDE) for word in words]
    acts = torch.tensor([-0.1 if name == act else -2.5 for name in domain.acts])
    requests, dont_care = (
        torch.tensor([dict(chances).get(slot, 0.0) for slot in domain.slots])
        for chances in (asked, free)
    )
    reading = Reading(tags, 1.0, [word in new for word in words], acts, requests, dont_care, 0.0)
    return assemble(words, reading, question or OPENING, lexicon)[:2]


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
