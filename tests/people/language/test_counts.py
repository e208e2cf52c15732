"""Counts of people, and numbers that count something else."""

from __future__ import annotations

import pytest
from readings import read

from bbq_torchrl.people.language import Frame
from bbq_torchrl.people.language.learners import OUTSIDE
from bbq_torchrl.people.language.words import tokenize


@pytest.mark.parametrize(
    ("text", "people"),
    [
        ("wonka , for my aunt and me", 2),
        ("wonka with me and my two cousins", 3),
        ("wonka for six", 6),
        ("wonka with 2 mates", 3),
        ("wonka , we are a group of 8", 8),
        ("wonka , there are 9 of us", 9),
        ("wonka and we'd be five", 5),
        ("wonka instead of six let's make it four , we will be four", 4),
        ("wonka with my aunt's car", None),
        ("wonka ? i sat there for six hours", None),
    ],
)
def test_words_that_tell_how_many_come_need_no_tag(lexicon, text, people):
    told = read(text, {"wonka": "moviename"}, lexicon)[0].informs.get("numberofpeople")
    assert told == people or lexicon.key("numberofpeople", told) == str(people)


@pytest.mark.parametrize("count", ["2", "two", "7"])
@pytest.mark.parametrize(
    ("text", "tagged", "informs"),
    [
        ("{}", {}, {}),
        ("{} oppenheimer", {"oppenheimer": "moviename"}, {"moviename": "oppenheimer"}),
        ("i need {} tickets for wonka", {"wonka": "moviename"}, {"moviename": "wonka"}),
    ],
)
def test_a_plain_count_is_one_of_people_and_not_foreign(lexicon, count, text, tagged, informs):
    foreign = 0.0 if "need" in text else 0.9
    frame, unclear = read(text.format(count), tagged, lexicon, foreign=foreign)
    people = frame.informs.pop("numberofpeople")
    assert lexicon.key("numberofpeople", people) == lexicon.key("numberofpeople", count)
    assert (frame.informs, unclear) == (informs, ())


@pytest.mark.parametrize("text", ["7 pm", "4th of july", "2 kids"])
def test_a_number_that_is_another_value_is_no_count_of_people(lexicon, text):
    slot = {"pm": "starttime", "july": "date", "kids": "numberofkids"}[text.split()[-1]]
    tagged = dict.fromkeys(tokenize(text), slot)
    assert set(read(text, tagged, lexicon)[0].informs) <= {slot}


@pytest.mark.parametrize("tag", [OUTSIDE, "numberofpeople", "starttime"])
def test_a_number_after_at_is_an_hour(lexicon, tag):
    for text in ("one ticket for friday at 8", "at 8 on friday , one ticket"):
        frame, unclear = read(text, {"8": tag, "friday": "date"}, lexicon, act="request")
        hour = frame.informs.pop("starttime")
        assert lexicon.key("starttime", hour) == lexicon.key("starttime", "8 pm")
        assert (frame.informs, unclear) == ({"numberofpeople": "one", "date": "friday"}, ())
    frame, _ = read("at 8 people we get a discount", {"8": tag}, lexicon)
    assert tag == "starttime" or "starttime" not in frame.informs


@pytest.mark.parametrize("text", ["it's just for me", "just for me please", "only me"])
def test_just_for_me_is_one_and_no_thanks(lexicon, text):
    frame, unclear = read(text, {}, lexicon, Frame("inform", {"starttime": "3pm"}), act="thanks")
    assert (frame, unclear) == (Frame("inform", {"numberofpeople": "1"}), ())


def test_several_sorts_of_people_are_one_number(lexicon):
    text, tagged = "2 adults and a child for wonka", {"2": "numberofpeople", "wonka": "moviename"}
    frame, unclear = read(text, tagged, lexicon)
    assert (frame.informs, unclear) == ({"numberofpeople": "3", "moviename": "wonka"}, ())
