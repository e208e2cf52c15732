"""Readings become frames: counts, denials, unknown names, no preference, foreign sentences."""

from __future__ import annotations

import re

import pytest
from readings import read

from bbq_torchrl.domains.frames import ANY
from bbq_torchrl.people.language import Frame, Unclear
from bbq_torchrl.people.language.assembly import chosen, is_denied
from bbq_torchrl.people.language.words import tokenize

ASKED = Frame("request", {}, ("date",))


@pytest.mark.parametrize(
    ("slot", "choices", "text", "taken"),
    [
        ("moviename", ("godzilla minus one", "kong"), "the second one", "kong"),
        ("moviename", ("kong", "godzilla minus one"), "the first one", "kong"),
        ("moviename", ("kong", "wicked"), "number one", "kong"),
        ("moviename", ("kong", "wicked"), "one", "kong"),
        ("moviename", ("kong", "wicked"), "not that one", None),
        ("moviename", ("kong", "wicked"), "the later one", None),  # of what has no order
        # Not by the letters of "after" and "at".
        ("starttime", ("2:15 pm", "after 6pm"), "the later one", "after 6pm"),
        ("starttime", ("2:15 pm", "after 6pm"), "the earlier one", "2:15 pm"),
        ("starttime", ("7:30 pm", "matinee"), "the later one", None),  # which has no clock
        ("starttime", ("7pm", "9:30 pm"), "the earlier one", "7pm"),
    ],
)
def test_a_choice_is_taken_by_its_place(lexicon, slot, choices, text, taken):
    question = Frame("multiple_choice", requests=(slot,), choices=choices)
    assert chosen(text.split(), question, lexicon) == taken


OFFER = "inform(taskcomplete=ticket available)"
READINGS = {
    "a name that is asked about is a question":
        ("comedies ?", "request", {"comedies": "genre"}, {"moviename": 0.9},
         "request(moviename)", "request(moviename) inform(genre=comedy)"),
    "a name that is told is an answer":
        ("comedies ?", "inform", {"comedies": "genre"}, {}, "request(moviename)",
         "inform(genre=comedy)"),
    "agreeing to a booking and asking is thanks":
        ("sure . price ?", "thanks", {}, {"price": 1.0}, OFFER, "thanks request(price)"),
    "act and questions are chosen together":
        ("is it pricey", "greeting", {}, {"price": 0.99}, "request(genre)", "request(price)"),
    "a question that is less sure than the act gives way":
        ("is it pricey", "greeting", {}, {"price": 0.6}, "request(genre)", "greeting"),
    "a request without a sure question asks for the likeliest":
        ("is it pricey", "request", {}, {"price": 0.3}, "request(genre)", "request(price)"),
    "another value than the agent's is told":
        ("tulsa is fine", "thanks", {"tulsa": "city"}, {}, "inform(city=reno)",
         "inform(city=tulsa)"),
    "a farewell denies nothing":
        ("not today then , bye", "closing", {}, {}, "thanks", "closing"),
    "a name that the tagger passed over is the answer":
        ("i'm thinking saturday because of work", "inform", {}, {}, "inform(city=no match)",
         "inform(date=saturday)"),
    "of a corrected value the last one is meant":
        ("friday , no wait saturday", "inform", {"friday": "date", "saturday": "date"}, {},
         "request(date)", "inform(date=saturday)"),
    "a number of people is read with the company around it":
        ("with my three brothers", "inform", {"three": "numberofpeople"}, {},
         "greeting", "inform(numberofpeople=4)"),
    "denying what the agent has said is a no":
        ("i do not live in tulsa", "deny", {"tulsa": "city"}, {}, "inform(city=tulsa)", "deny"),
}  # fmt: skip


@pytest.mark.parametrize(
    ("text", "act", "tagged", "asked", "question", "meant"), READINGS.values(), ids=READINGS
)
def test_a_reading_becomes_the_likeliest_frame(lexicon, text, act, tagged, asked, question, meant):
    frame, unclear = read(text, tagged, lexicon, Frame.parse(question), act=act, asked=asked)
    assert (str(frame), unclear) == (meant, ())


@pytest.mark.parametrize(
    "text",
    [
        "not on friday",
        "any day but friday",
        "friday is no good",
        "i can't do friday",
        "everything except friday please",
        "friday won't work for us",
        "we are busy on friday",
        "any day other than friday",
        "friday is out of the question",
        "i refuse to go on friday",
        "my sister hates friday",
        "please don't book us for friday",
        "friday clashes with my exam",
        "i would rather walk than friday",
    ],
)
@pytest.mark.parametrize("is_tagged", [True, False])
def test_a_denied_value_is_reported_and_not_informed(lexicon, text, is_tagged):
    frame, unclear = read(text, {"friday": "date"} if is_tagged else {}, lexicon, ASKED)
    assert "date" not in frame.informs
    assert [(one.slot, one.text.split()[-1], one.is_denied) for one in unclear] == [
        ("date", "friday", True)
    ]


@pytest.mark.parametrize(
    "text",
    [
        "why not friday",
        "friday if it is not sold out",
        "no , friday",
        "i don't mind , friday",
        "friday isn't sold out , is it",
        "let's say friday",
        "friday too please",
        "i can't wait until friday",
        "they won't stop talking about friday",
        "nothing better than friday",
        "i don't care what we see on friday",
        "i don't want to be late on friday",
    ],
)
def test_words_of_denial_about_something_else_leave_the_value(lexicon, text):
    frame, unclear = read(text, {"friday": "date"}, lexicon, ASKED)
    assert (frame.informs, unclear) == ({"date": "friday"}, ())


def test_of_two_names_joined_by_or_none_is_picked_though_one_was_not_tagged(lexicon):
    frame, unclear = read("seattle or portland", {"portland": "city"}, lexicon)
    assert (frame.informs, unclear[0].candidates) == ({}, ("seattle", "portland"))


@pytest.mark.parametrize("text", ["not friday , saturday", "saturday instead of friday"])
def test_beside_a_denied_value_the_other_one_is_meant(lexicon, text):
    tagged = dict.fromkeys(("friday", "saturday"), "date")
    frame, unclear = read(text, tagged, lexicon, ASKED)
    assert (frame.informs, unclear) == ({"date": "saturday"}, ())


@pytest.mark.parametrize(
    ("text", "denied"),
    [
        ("friday's no good", True),
        ("friday's fine", False),
        ("i have got an exam on friday", True),
        ("haven't you got friday", False),
        ("i haven't seen friday", False),
        ("please rule out friday", True),
        ("it hurts friday", False),
    ],
)
def test_words_before_and_after_a_value_deny_it(text, denied):
    words = tokenize(text)
    (at,) = [place for place, word in enumerate(words) if word.startswith("friday")]
    assert is_denied(words, at, at + 1) == denied


def test_not_too_late_is_not_late_and_not_too_far_is_a_value(lexicon):
    frame, unclear = read("friday , not too late", {"friday": "date"}, lexicon)
    assert frame.informs == {"date": "friday"}
    assert unclear == (Unclear("starttime", "late", is_denied=True),)
    tagged = dict.fromkeys(("not", "too", "far"), "distanceconstraints")
    frame, unclear = read("no , not too far", tagged, lexicon, ASKED)
    assert (frame.informs, unclear) == ({"distanceconstraints": "not too far"}, ())


@pytest.mark.parametrize(
    ("text", "slot"),
    [
        ("any time", "starttime"),
        ("any theater please", "theater"),
        ("whatever day", "date"),
        ("the day doesn't matter", "date"),
        ("time does not matter to me.", "starttime"),
        ("i have no preference on the theater", "theater"),
        ("i don't care which day", "date"),
        ("we're flexible about the time", "starttime"),
        ("any movie would be fine", "moviename"),
        ("any", "city"),
        ("anything is fine for the four of us", "city"),
    ],
)
def test_no_preference_is_about_the_slot_that_is_named(lexicon, text, slot):
    question = Frame("request", {}, ("city",))
    frame, unclear = read(text, {}, lexicon, question, free={"city": 0.9})
    assert (frame, unclear) == (Frame("inform", {slot: ANY}), ())


def test_an_answer_that_names_nothing_does_not_care_if_that_is_likely(lexicon):
    for chance, informs in ((0.3, {"date": ANY}), (0.01, {})):
        frame, _ = read("hm ?", {}, lexicon, ASKED, free={"date": chance})
        assert frame == Frame("inform", informs)


def test_an_unknown_name_is_reported_with_its_slot_and_words(lexicon):
    tagged = {"2": "numberofpeople", "xylqo": "moviename", "vrit": "moviename"}
    frame, unclear = read("2 for xylqo vrit", tagged, lexicon)
    assert frame.informs == {"numberofpeople": "2"}
    assert unclear == (Unclear("moviename", "xylqo vrit"),)
    frame, unclear = read("the xylqo please", {}, lexicon, Frame("request", {}, ("theater",)))
    assert (frame, unclear) == (Frame("inform"), (Unclear("theater", "xylqo"),))


@pytest.mark.parametrize("act", ["request", "closing"])
def test_what_the_domain_cannot_mean_informs_only_of_values(lexicon, act):
    frame, _ = read("will it rain here", {}, lexicon, act=act, foreign=0.9)
    assert frame == Frame("not_sure")
    tagged = {"tulsa": "city", "friday": "date"}
    frame, _ = read("will it rain in tulsa on friday", tagged, lexicon, act="closing", foreign=0.9)
    assert frame == Frame("inform", {"city": "tulsa", "date": "friday"})


@pytest.mark.parametrize(
    ("text", "tags", "informs"),
    [
        ("grand rapids", "grand rapids:theater", {"city": "grand rapids"}),
        ("around los angeles", "around los angeles:city", {"city": "los angeles"}),
        (
            "regal grand rapids 12",
            "regal grand rapids 12:theater",
            {"theater": "regal grand rapids 12"},
        ),
    ],
)
def test_a_name_in_full_is_of_its_slot_whatever_was_tagged(lexicon, text, tags, informs):
    tagged = {}
    for words, slot in re.findall(r"([^:]+):(\w+) ?", tags):
        tagged |= dict.fromkeys(words.split(), slot)
    frame, unclear = read(text, tagged, lexicon, Frame("request", {}, ("theater",)))
    assert (dict(frame.informs), unclear) == (informs, ())
