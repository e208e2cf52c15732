"""Replies of people to an agent that learned nothing, in their own words."""

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


def opened(partner, *texts):
    """The answer to the last text; none without."""
    answer = None
    for text in texts:
        answer = said(partner, answer, text)
    return answer


def is_taken(before, answer, so):
    """Whether a proposal is taken, or is not."""
    is_held = before.memory.proposal.items() <= answer.understood.informs.items()
    if so:
        return is_held and not answer.memory.proposal
    return not is_held


def is_another(before, answer, slot):
    """Whether others are told, or that there are none, in place of what is known."""
    act, known = answer.answered, before.answered.informs[slot]
    is_told = act.choices or answer.memory.proposal or "no other" in answer.text.lower()
    return act.informs.get(slot, "") != known and (is_told or slot in act.informs)


def is_heard(answer, slots):
    """Whether values of the slots are held, told, asked about or checked."""
    known, waiting = {*answer.understood.informs}, answer.memory.asking.waiting
    known |= {*(waiting.informs if waiting else ()), *answer.answered.requests}
    return {*slots} <= known | {*answer.answered.informs}


def is_told(answer, slot):
    """Returns whether an answer tells a value of a slot, or a list of them."""
    act = answer.answered
    told = {*act.informs, *answer.memory.proposal, *(act.requests if act.choices else ())}
    return slot in told


IS_SO = {
    "takes": is_taken,
    "stands": lambda before, answer, _: answer.memory.proposal == before.memory.proposal,
    "tells": lambda _, answer, slot: is_told(answer, slot),
    "understood": lambda _, answer, told: told.items() <= answer.understood.informs.items(),
    "hears": lambda _, answer, slots: is_heard(answer, slots),
    "another": is_another,
    "ended": lambda _, answer, by: answer.ended == by,
    "offered": lambda _, answer, so: answer.memory.state["offered"] == so,
    "begins": lambda _, answer, words: answer.text.startswith(words),
    "affirms": lambda _, answer, so: answer.text.startswith("Yes") == so,
    "says": lambda _, answer, words: words in answer.text,
    "lacks": lambda _, answer, words: words not in answer.text,
    "says_any": lambda _, answer, words: any(part in answer.text for part in words),
    "names_no": lambda before, answer, slot: (
        before.answered.informs[slot] not in answer.text.lower()
    ),
}


@pytest.mark.parametrize("case", TEXTS["replies"], ids=lambda case: case["what"])
def test_a_reply_is_answered(partner, offer, case):
    before = offer if case["after"] == "offer" else opened(partner, *case["after"])
    values = {}
    if before is not None:
        values = {**before.answered.informs, **before.memory.proposal}
        values["chain"] = values.get("theater", "").partition(" ")[0]
    for text in case["texts"]:
        answer = said(partner, before, text.format(**values))
        for key, wanted in case["then"].items():
            assert IS_SO[key](before, answer, wanted), (text, key, answer.text)


def test_most_replies_to_no_match_are_helped(partner):
    helped = []
    for talk in TEXTS["no_match"]:
        before = opened(partner, talk["open"])
        assert before.memory.proposal
        for reply in talk["replies"]:
            act = said(partner, before, reply).answered
            helped.append(bool(act.choices) or not {*act.informs.values()} <= {"no match"})
    assert sum(helped) / len(helped) >= 0.7


def test_a_showing_shown_before_comes_back(partner):
    first = opened(partner, "two tickets for barbie on christmas eve at 5 pm")
    other = said(partner, first, "no, something else")
    shown = first.memory.shown[-1]
    assert other.memory.proposal != first.memory.proposal
    chain = shown["theater"].partition(" ")[0]
    for text in (
        "let's go back to the first one",
        f"we take the {chain} one after all",
        f"the {shown['starttime']} one you proposed before. where is it?",
    ):
        back = said(partner, other, text)
        assert back.memory.proposal.items() >= shown.items(), text
        assert shown["theater"] in back.text.lower()
    assert said(partner, other, "go back to the one in Anchorage").memory.proposal != shown


def test_an_offer_says_where_and_when_it_is(partner, offer):
    place = {slot: offer.answered.informs[slot] for slot in ("moviename", "starttime", "theater")}
    assert all(value.lower() in offer.text.lower() for value in place.values())
    booked = said(partner, offer, "yes please")
    assert all(value.lower() in booked.text.lower() for value in place.values())


def test_what_is_proposed_beside_an_offer_is_not_booked_as_the_offer(partner, offer):
    before = said(partner, offer, "anything earlier than that?")
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


def test_an_offer_stands_after_anything_but_a_yes_that_nothing_contradicts(partner, offer):
    for text in [*TEXTS["not_ends"], *TEXTS["not_ends_beside"]]:
        assert not said(partner, offer, text).ended, text
    ended = [said(partner, said(partner, offer, text), "yes").ended for text in TEXTS["not_ends"]]
    assert ended.count("agent") / len(ended) >= 0.9
    for text in [*TEXTS["ends"], *TEXTS["ends_beside"]]:
        assert said(partner, offer, text).ended == "agent", text
