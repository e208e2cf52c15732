"""Readings become frames: counts, denials, unknown names, no preference, foreign sentences."""

import re
from pathlib import Path

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


def rows(name):
    """Returns the columns of a table beside this file."""
    lines = Path(__file__).with_name(name).read_text("utf-8").splitlines()
    return [[part.strip() for part in line.split("|")] for line in lines if line[:1] not in "#"]


def pairs(text):
    return dict(pair.split("=") for pair in text.split(", ") if pair)


@pytest.mark.parametrize("row", rows("readings.txt"), ids=lambda row: row[0])
def test_a_reading_becomes_the_likeliest_frame(lexicon, row):
    text, act, tagged, asked, question, meant = row
    chances = {slot: float(chance) for slot, chance in pairs(asked).items()}
    question = Frame.parse(question)
    frame, unclear = read(text, pairs(tagged), lexicon, question, act=act, asked=chances)
    assert (str(frame), unclear) == (meant, ())


@pytest.mark.parametrize(("denied", "text"), rows("denials.txt"))
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


def test_of_two_names_joined_by_or_none_is_picked_though_one_was_not_tagged(lexicon):
    frame, unclear = read("seattle or portland", {"portland": "city"}, lexicon)
    assert (frame.informs, unclear[0].candidates) == ({}, ("seattle", "portland"))


@pytest.mark.parametrize("text", ["not friday , saturday", "saturday instead of friday"])
def test_beside_a_denied_value_the_other_one_is_meant(lexicon, text):
    tagged = dict.fromkeys(("friday", "saturday"), "date")
    frame, unclear = read(text, tagged, lexicon, ASKED)
    assert (frame.informs, unclear) == ({"date": "saturday"}, ())


def test_not_too_late_is_not_late_and_not_too_far_is_a_value(lexicon):
    frame, unclear = read("friday , not too late", {"friday": "date", "late": "starttime"}, lexicon)
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
        ("anything is fine for everyone", "city"),
    ],
)
def test_no_preference_is_about_the_slot_that_is_named(lexicon, text, slot):
    question = Frame("request", {}, ("city",))
    frame, unclear = read(text, {}, lexicon, question, free={"city": 0.9})
    assert (frame, unclear) == (Frame("inform", {slot: ANY}), ())


@pytest.mark.parametrize(
    ("text", "informs"),
    [
        ("wonka tomorrow at 9:45 pm", {"starttime": "9:45 pm"}),
        ("my cousin and i love wonka", {"numberofpeople": "2"}),
        ("hello , 7 of us here", {"numberofpeople": "7"}),
        ("we have 7 dogs", {}),
    ],
)
def test_a_quantity_that_nothing_else_can_be_needs_no_tag(lexicon, text, informs):
    frame, _ = read(text, {"wonka": "moviename"} if "wonka" in text else {}, lexicon, act="deny")
    assert {slot: v for slot, v in frame.informs.items() if slot != "moviename"} == informs


def test_a_correction_of_names_alone_is_no_bare_no(lexicon):
    for text in ("no , i said newark , not reno", "nope , newark"):
        frame, _ = read(text, {}, lexicon, act="deny")
        assert (frame.act, frame.informs) == ("inform", {"city": "newark"})
    assert read("no thanks", {}, lexicon, act="deny")[0] == Frame("deny")


def test_what_stands_beside_a_choice_is_not_lost(lexicon):
    question = Frame("multiple_choice", {}, ("starttime",), ("7:55 pm", "2:50pm"))
    frame, _ = read("the second . 4 of us", {"4": "numberofpeople"}, lexicon, question)
    assert frame.informs == {"starttime": "2:50pm", "numberofpeople": "4"}


def test_an_unknown_name_is_reported_with_its_slot_and_words(lexicon):
    tagged = {"2": "numberofpeople", "xylqo": "moviename", "vrit": "moviename"}
    frame, unclear = read("2 for xylqo vrit", tagged, lexicon)
    assert frame.informs == {"numberofpeople": "2"}
    assert unclear == (Unclear("moviename", "xylqo vrit"),)
    question = Frame("request", {}, ("theater",))
    for new, names in (("xylqo", (Unclear("theater", "xylqo"),)), ("please", ())):
        frame, unclear = read("the xylqo please", {}, lexicon, question, new=new)
        assert (frame, unclear) == (Frame("inform"), names)


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
