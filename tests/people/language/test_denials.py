"""Denied values and ranges."""

from __future__ import annotations

import re

import pytest
from readings import read

from bbq_torchrl.domains import movie_domain
from bbq_torchrl.people.language import Frame, Generator, Unclear, Understood
from bbq_torchrl.people.language.denials import is_denied
from bbq_torchrl.people.language.words import tokenize


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
def test_a_denied_value_is_reported_and_not_told(lexicon, text, is_tagged):
    tagged = {"friday": "date"} if is_tagged else {}
    frame, unclear = read(text, tagged, lexicon, Frame("request", {}, ("date",)))
    assert "date" not in frame.informs
    assert unclear == (Unclear("date", "friday", is_denied=True),)


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
    frame, unclear = read(text, {"friday": "date"}, lexicon, Frame("request", {}, ("date",)))
    assert (frame.informs, unclear) == ({"date": "friday"}, ())


@pytest.mark.parametrize("text", ["not friday , saturday", "saturday instead of friday"])
def test_beside_a_denied_value_the_other_one_is_meant(lexicon, text):
    tagged = dict.fromkeys(("friday", "saturday"), "date")
    frame, unclear = read(text, tagged, lexicon, Frame("request", {}, ("date",)))
    assert (frame.informs, unclear) == ({"date": "saturday"}, ())


def test_denying_what_the_agent_has_said_is_a_no(lexicon):
    said = Frame("inform", {"city": "tulsa"})
    frame, unclear = read("i do not live in tulsa", {"tulsa": "city"}, lexicon, said, act="deny")
    assert (frame, unclear) == (Frame("deny"), ())


@pytest.mark.parametrize(
    ("text", "meant", "unknown"),
    [
        ("6 pm or later", "after 6pm", None),
        ("6 pm", "6pm", None),
        ("6:31 pm or later", None, "after 6:31 pm"),
        ("not before 6 pm", "after 6pm", None),
        ("no earlier than 6 pm please", "after 6pm", None),
        ("not before 6:31 pm", None, "not before 6:31 pm"),
        ("some time after 6:31 pm", None, "after 6:31 pm"),
    ],
)
def test_a_range_is_what_was_meant_or_is_asked_about(lexicon, text, meant, unknown):
    words = dict.fromkeys(("6", "6:31", "pm"), "starttime")
    frame, unclear = read(text, words, lexicon, Frame("request", {}, ("starttime",)))
    got = frame.informs.get("starttime")
    key = lexicon.key
    assert (got and key("starttime", got)) == (meant and key("starttime", meant))
    assert [one.text for one in unclear] == ([unknown] if unknown else [])


@pytest.mark.parametrize(
    "text", ["not too far", "oh and not too far if you can", "no , not too far"]
)
def test_a_value_that_begins_with_not_is_no_denial(lexicon, text):
    tagged = dict.fromkeys(("not", "too", "far"), "distanceconstraints")
    frame, unclear = read(text, tagged, lexicon, Frame("request", {}, ("date",)))
    assert (frame.informs, unclear) == ({"distanceconstraints": "not too far"}, ())


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


@pytest.mark.parametrize("text", ["my boss and we despise friday", "we despise friday"])
def test_a_denial_that_was_tagged_as_part_of_a_name_still_denies_it(lexicon, text):
    tagged = dict.fromkeys(("despise", "friday"), "date")
    frame, unclear = read(text, tagged, lexicon, Frame("request", {}, ("date",)))
    assert (frame.informs, unclear) == ({}, (Unclear("date", "friday", is_denied=True),))


@pytest.mark.parametrize("text", ["not too late please", "nothing too late", "not so late"])
def test_not_too_late_is_not_late(lexicon, text):
    frame, unclear = read(
        text, {"late": "starttime"}, lexicon, Frame("request", {}, ("starttime",))
    )
    assert (frame.informs, unclear) == ({}, (Unclear("starttime", "late", is_denied=True),))
    frame, unclear = read(f"friday , {text}", {"friday": "date"}, lexicon)
    assert frame.informs == {"date": "friday"}
    assert unclear == (Unclear("starttime", "late", is_denied=True),)


def test_the_agent_asks_what_is_wanted_instead():
    denied = Unclear("date", "friday", is_denied=True)
    said = Generator(movie_domain()).clarify(Understood(Frame("inform"), 0.5, (denied,)))
    assert re.search(r"\bnot friday\b", said, re.IGNORECASE)
    assert said.endswith("?")
