"""Replies of people to an agent that learned nothing, in their own words."""

from __future__ import annotations

from itertools import count
from pathlib import Path

import pytest
import yaml

from bbq_torchrl.people.chat import Partner

TEXTS = yaml.safe_load(Path(__file__).with_name("conversations.yaml").read_text(encoding="utf-8"))
WONKA = "two tickets for wonka in tampa"

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def partner(agents, understand, mouth, spelling):
    return Partner(agents["bbqn"], understand, mouth, spelling)


@pytest.fixture(scope="module")
def offer(partner):
    """The answer with an offer of tickets for Wonka in Tampa."""
    answer = said(partner, None, WONKA)
    for seed in count():
        if answer.memory.state is not None and answer.memory.state["offered"]:
            return answer
        answer = said(partner, answer, "book it", seed)


def said(partner, answer, text, seed=0):
    return partner.reply(None if answer is None else answer.memory, text, seed)


def opened(partner, text):
    """The first answer to a text but the check of whether it was understood."""
    answer = said(partner, None, text)
    while answer.memory.asking.is_check:
        answer = said(partner, answer, "yes")
    return answer


def test_most_replies_to_no_match_are_helped(partner):
    helped = []
    for talk in TEXTS["no_match"]:
        before = opened(partner, talk["open"])
        assert before.memory.proposal
        for reply in talk["replies"]:
            act = said(partner, before, reply).answered
            helped.append(bool(act.choices) or not {*act.informs.values()} <= {"no match"})
    assert sum(helped) / len(helped) >= 0.7


def test_a_proposal_is_taken_by_a_yes_with_more_or_by_its_name(partner):
    before = opened(partner, "two tickets for barbie on christmas eve at 5 pm")
    proposal = before.memory.proposal
    assert proposal.keys() >= {"city", "theater"}
    for case in TEXTS["takes"]:
        answer = said(partner, before, case["text"].format(**proposal))
        assert answer.understood.informs.items() >= proposal.items(), case
        assert not answer.memory.proposal, case
        assert case.get("asks", "theater") in {*answer.answered.informs, *proposal}, case
    for text in TEXTS["keeps"]:
        answer = said(partner, before, text.format(**proposal))
        assert not proposal.items() <= answer.understood.informs.items(), text


def test_a_bare_yes_books_what_is_proposed_if_all_of_it_was_told(partner):
    before = opened(partner, "four tickets for oppenheimer on sunday night in oklahoma")
    before = said(partner, before, "what theaters do you have?")
    for text in ("yes", "that works for me"):
        assert said(partner, before, text).ended == "agent", text
    for text in ("yes, is it far?", "yes for five", "ok but let me check with her"):
        assert not said(partner, before, text).ended, text
    part = opened(partner, "which movies are on in tampa?")
    part = said(partner, part, "another theater?")
    assert not said(partner, part, "yes").ended


def test_whether_a_record_has_a_value_is_answered_and_changes_nothing(partner, offer):
    before = opened(partner, "two tickets for barbie on christmas eve at 5 pm")
    values = {**before.memory.proposal, "chain": before.memory.proposal["theater"].split()[0]}
    for case in TEXTS["whether"]:
        answer = said(partner, before, case["text"].format(**values))
        assert case["says"] in answer.text, case
        assert answer.memory.proposal == before.memory.proposal, case
    for text in TEXTS["not_whether"]:
        answer = said(partner, before, text)
        assert "Chicago" in answer.text, text
        assert not answer.text.startswith(("Yes", "No.", "No, ")), text
    value = offer.answered.informs["starttime"]
    answer = said(partner, offer, f"Great! Is it at {value}?")
    assert answer.text.startswith("Yes")
    assert not answer.ended
    assert answer.memory.state["offered"]


def test_an_offer_says_where_and_when_it_is(partner, offer):
    place = {slot: offer.answered.informs[slot] for slot in ("date", "starttime", "theater")}
    assert all(value.lower() in offer.text.lower() for value in place.values())
    booked = said(partner, offer, "yes please")
    assert all(value.lower() in booked.text.lower() for value in place.values())


def test_plain_openings_are_not_checked_and_a_yes_is_true(partner):
    assert not [text for text in TEXTS["plain"] if said(partner, None, text).memory.asking.is_check]
    for case in TEXTS["any"]:
        answer = said(partner, None, case["text"])
        assert answer.text.startswith("Yes") == case["is_yes"], case


def test_what_is_said_is_held_or_asked_about(partner):
    for case in TEXTS["said"]:
        answer = said(partner, None, case["text"])
        waiting = answer.memory.asking.waiting
        known = {**answer.understood.informs, **(waiting.informs if waiting else {})}
        assert {*case["slots"]} <= {*known, *answer.answered.requests, *answer.answered.informs}, (
            case
        )


def test_a_correction_is_no_bare_no(partner):
    before = opened(partner, "two tickets for barbie on christmas eve at 5 pm")
    answer = said(partner, before, "no, I said Seattle, not Houston")
    assert answer.understood.informs["city"] == "seattle"


def test_who_asks_for_others_than_the_offered_gets_them_and_the_offer_stands(partner, offer):
    for text in TEXTS["others"]:
        answer = said(partner, offer, text)
        act = answer.answered
        is_told = "no other" in answer.text.lower()
        assert is_told or act.choices or act.informs.get("moviename", "wonka") != "wonka", text
        assert not answer.ended


def test_a_question_beside_another_name_is_about_that(partner, offer):
    for text in TEXTS["named"]:
        answer = said(partner, offer, text)
        assert offer.answered.informs["theater"] not in answer.text.lower(), text
        assert "moviename" in answer.understood.informs, text


def test_what_is_proposed_beside_an_offer_is_not_booked_as_the_offer(partner, offer):
    before = said(partner, offer, "anything later than that?")
    assert before.memory.proposal.keys() == {"starttime"}
    time = before.memory.proposal["starttime"]
    for text in (f"Lovely, {time}.", f"Splendid, {time}. Is it still in Tampa?", "is that wonka?"):
        assert said(partner, before, text).ended != "agent", text


def test_the_same_is_not_proposed_three_times(partner):
    text = "two tickets for barbie on christmas eve at 5 pm"
    before = opened(partner, text)
    again = said(partner, before, text)
    assert again.memory.proposal == before.memory.proposal
    assert again.text != before.text
    third = said(partner, again, text)
    assert not third.memory.proposal
    assert third.text.endswith("?")


def test_an_offer_stands_after_anything_but_a_whole_yes(partner, offer):
    for text in TEXTS["not_ends"]:
        assert not said(partner, offer, text).ended, text
    ended = [said(partner, said(partner, offer, text), "yes").ended for text in TEXTS["not_ends"]]
    assert ended.count("agent") / len(ended) >= 0.9
    for text in TEXTS["ends"]:
        assert said(partner, offer, text).ended == "agent", text


def test_a_clear_booking_is_a_yes_beside_anything_that_contradicts_nothing(partner, offer):
    assert not [t for t in TEXTS["ends_beside"] if said(partner, offer, t).ended != "agent"]
    assert not [t for t in TEXTS["not_ends_beside"] if said(partner, offer, t).ended]


def test_what_is_asked_beside_a_choice_is_answered(partner):
    for case in TEXTS["asks"]:
        answer = said(partner, opened(partner, case["open"]), case["text"])
        assert case["slot"] in {*answer.answered.informs, *answer.memory.proposal}, case


def test_a_detail_that_is_nowhere_on_file_is_owned_up_to_each_time_and_never_affirmed(partner):
    first = said(partner, opened(partner, "two for wonka in tampa"), "with a magician in 3d please")
    again = said(partner, first, "Is there one with subtitles and a magician?")
    for answer in (first, again):
        assert not answer.text.startswith("Yes")


def test_who_asks_for_another_time_is_not_told_the_known_one(partner, offer):
    time = offer.answered.informs["starttime"]
    for text in (
        "And when else could we see it?",
        "another screening?",
        f"is {time} the only one?",
    ):
        answer = said(partner, offer, text)
        assert answer.answered.informs.get("starttime") != time, text
        assert answer.memory.proposal or answer.answered.choices or "no other" in answer.text, text


def test_what_is_asked_beside_a_question_for_others_is_answered(partner, offer):
    opening = opened(partner, "which movies are on in tampa?")
    for before in (offer, opening):
        answer = said(partner, before, "What other films are there, and how much is it?")
        assert any(words in answer.text for words in ("price", "on file")), answer.text
