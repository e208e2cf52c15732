"""The rules between an agent's choice and what a person reads."""

from __future__ import annotations

import random
from dataclasses import replace
from functools import cache

import pytest
import torch
from acts import Acts

from bbq_torchrl.domains import tensorize
from bbq_torchrl.domains.values import NO_MATCH, NONE
from bbq_torchrl.people.chat import Partner
from bbq_torchrl.people.dialogue import RULES
from bbq_torchrl.people.dialogue.control import Control
from bbq_torchrl.people.dialogue.judge import Judge
from bbq_torchrl.people.dialogue.records import Records
from bbq_torchrl.people.language import Frame, Unclear, Understood

SHOWN = ("moviename", "city", "date")
SHOWING = "inform(moviename=wonka, city=reno)"


class Words(Acts):
    """Acts, and a few sentences of people; some of them are understood badly."""

    def __call__(self, text, question=None):
        known = {
            "yes": Understood(Frame("confirm_answer"), 0.9),
            "ok but let me check with her": Understood(Frame("confirm_answer"), 0.9),
            "ok, how do I get there?": Understood(Frame("request", {}, ("ticket",)), 0.9),
            "that works for me": Understood(Frame("deny"), 0.9),
            "book it": Understood(Frame("request", {}, ("ticket",)), 0.9),
            "no": Understood(Frame("deny"), 0.9),
            "wonderful, yes please": Understood(Frame("inform"), 0.1),
            "yes please, i take it": Understood(Frame("request", {}, ("ticket",)), 0.9),
            "lorem ipsum": Understood(Frame("closing"), 0.9),
            "goodbye": Understood(Frame("closing"), 0.9),
            "great, 6:40": Understood(Frame("thanks"), 0.9),
            "thanks, bye": Understood(Frame("thanks"), 0.9),
            "wonkka in renno?": Understood(
                Frame("request", {"moviename": "wonka", "city": "reno"}, ("theater",)), 0.2
            ),
            "which theater has wonka in reno?": Understood(
                Frame("request", {"moviename": "wonka", "city": "reno"}, ("theater",)), 0.2
            ),
            "wonka in albany, for two?": Understood(
                Frame("request", {"moviename": "wonka", "city": "albany"}, ("theater",)), 0.5
            ),
            "just the three of us": Understood(Frame("inform", {"numberofpeople": "3"}), 0.9),
            "just the three of us, please": Understood(
                Frame("inform", {"numberofpeople": "3"}), 0.9
            ),
            "not newark": Understood(
                Frame("inform"), 0.9, (Unclear("city", "newark", is_denied=True),)
            ),
            "something whimsical": Understood(
                Frame("inform", {"moviename": "wonka"}), 0.9, (Unclear("genre", "whimsical"),)
            ),
            "is it in reno?": Understood(Frame("request", {"city": "reno"}, ("ticket",)), 0.9),
            "is the reno one still on ?": Understood(Frame("inform", {"city": "reno"}), 0.9),
            "is the reno one still on?": Understood(Frame("inform", {"city": "reno"}), 0.9),
            "the cheap seats": Understood(Frame("inform"), 0.1),
        }
        if text == "where?":
            asked = question.requests if question else ("theater",)
            return Understood(Frame("request", {}, asked), 0.9)
        return known[text] if text in known else super().__call__(text, question)


@pytest.fixture(scope="module")
def partner_with(agents, mouth, spelling):
    """Makes the partner with these rules, once."""
    return cache(lambda rules: Partner(agents["bbqn"], Words(), mouth, spelling, rules=rules))


@pytest.fixture
def talk(partner_with, monkeypatch):
    """Talks with an agent that takes the first allowed of the actions it prefers in each turn.

    Without ``rules`` it has all but ``asks_first``, so that an offer needs no number of people.
    """
    most = tuple(name for name in RULES if name != "asks_first")

    def talk(*turns, rules=most):
        partner = partner_with(rules)
        answers, memory = [], None
        for number, (text, *preferred) in enumerate(turns):
            wishes = [partner.agent.domain.action_index(name) for name in preferred]

            def decide(observation, seed, allowed=None, wishes=wishes):
                if allowed is None:
                    return wishes[0]
                return next((item for item in wishes if allowed[item]), int(allowed.int().argmax()))

            monkeypatch.setattr(partner.agent, "decide", decide)
            answers.append(partner.reply(memory, text, number))
            memory = answers[-1].memory
        return answers

    return talk


KNOWN = (SHOWING, "request(date)"), ("inform(numberofpeople=2)", "request(city)")
OFFER = (
    "inform(moviename=guardians of the galaxy vol. 3, city=newark)",
    "inform(taskcomplete)",
)


def test_what_only_the_person_can_say_is_asked_for_once_before_an_offer(talk):
    *_, asked = talk(OFFER, rules=None)
    assert asked.answered.requests == ("numberofpeople",)
    for text, number in (("inform(numberofpeople=2)", "2"), ("inform(city=newark)", None)):
        *_, offer = talk(OFFER, (text, "inform(taskcomplete)"), rules=None)
        assert "taskcomplete" in offer.answered.informs
        assert offer.answered.informs.get("numberofpeople") == number


def test_a_yes_to_an_offer_that_stands_ends_the_dialogue(talk):
    *_, last = talk(OFFER, ("yes", "inform(price)", "thanks"))
    assert (last.answered.act, last.ended, last.control) == ("thanks", "agent", ("yes_ends",))


@pytest.mark.parametrize("text", ["yes", "that works for me", "book it"])
def test_an_offer_stands_until_it_is_accepted(talk, text):
    aside = ("ok, how do I get there?",), ("ok but let me check with her",)
    *answers, last = talk(OFFER, *aside, (text, "inform(price)", "thanks"))
    assert [answer.ended for answer in answers] == ["", "", ""]
    assert (last.answered.act, last.ended) == ("thanks", "agent")


def test_only_a_yes_to_an_offer_ends_the_dialogue(talk):
    more = ("inform(numberofpeople=3)", "thanks", "inform(taskcomplete)")
    *_, last = talk(OFFER, more)
    assert last.answered.informs["numberofpeople"] == "3"
    assert (last.ended, last.control) == ("", ("yes_ends",))


@pytest.mark.parametrize("before", [(OFFER[0], "request(date)"), OFFER])
def test_questions_are_answered_before_anything_else_in_the_same_reply(talk, before):
    asks = ("request(theater, starttime)", "inform(genre)", "thanks", "request(numberofpeople)")
    *_, answer = talk(before, asks)
    assert answer.answered.informs.keys() >= {"theater", "starttime"}
    is_offered = before is OFFER  # the offer is made again, with the answers
    assert ("taskcomplete" in answer.answered.informs) == is_offered
    assert answer.answered.requests == (() if is_offered else ("numberofpeople",))
    assert answer.control[0] == "answers_first"
    for slot in ("theater", "starttime"):
        assert answer.answered.informs[slot].lower() in answer.text.lower()


def test_answers_and_wishes_are_those_of_one_record(partner_with, spelling, monkeypatch):
    """Whatever else the agent does, and whenever the person asks and tells."""
    partner = partner_with(None)
    chance, judge = random.Random(3), Judge(spelling.domain)
    goals = [goal for goal in spelling.domain.goals if judge.is_attainable(goal)]

    def decide(observation, seed, allowed=None):
        mask = partner.agent.legal if allowed is None else allowed
        return chance.choice(mask.nonzero().flatten().tolist())

    monkeypatch.setattr(partner.agent, "decide", decide)
    right = 0
    for goal in chance.sample(goals, 20):
        texts = [f"inform({slot}={value})" for slot, value in goal.constraints.items()]
        texts += [f"request({slot})" for slot in goal.requests]
        chance.shuffle(texts)
        memory, told = None, {}
        for number, text in enumerate(texts):
            answer = partner.reply(memory, text, number)
            memory, asked = answer.memory, Frame.parse(text).requests
            told |= answer.answered.informs
            assert set(asked) <= answer.answered.informs.keys()
        wanted = {slot: told[slot] for slot in goal.requests}
        for slot, value in goal.constraints.items():
            if slot not in spelling.domain.free_slots:
                wanted[slot] = value
        right += any(wanted.items() <= record.items() for record in spelling.domain.records)
    assert right >= 19  # at random an agent seldom tells what cannot be taken back in time


def test_no_act_is_repeated_unless_something_changed(talk):
    again = ("inform(numberofpeople=2)", "request(date)", "request(theater)")
    first, second = talk((SHOWING, "request(date)"), again)
    assert (str(first.answered), str(second.answered)) == ("request(date)", "request(theater)")
    other = ("inform(genre=superhero)", "inform(taskcomplete)", "thanks")
    assert ["genre" in answer.answered.informs for answer in talk(OFFER, other)] == [False, True]


def test_a_no_match_is_forgotten_when_the_person_tells_a_value(talk):
    clash = ("inform(moviename=wonka, genre=horror)", "inform(price)")
    tells = ("inform(moviename=barbie)", "request(price)")
    held = [
        talk(clash, tells, rules=rules)[-1].memory.state["held"] == NO_MATCH
        for rules in ((), ("take_back",))
    ]
    assert [bool(slots.any()) for slots in held] == [True, False]


@pytest.mark.parametrize(
    ("reply", "informs"),
    [
        ("yes", {"moviename": "wonka", "city": "reno"}),
        ("wonderful, yes please", {"moviename": "wonka", "city": "reno"}),
        ("yes please, i take it", {"moviename": "wonka", "city": "reno"}),
        ("inform(city=newark)", {"moviename": "wonka", "city": "newark"}),
    ],
)
def test_a_sentence_in_doubt_is_checked_and_keeps_what_was_understood(talk, reply, informs):
    check, answer = talk(("wonkka in renno?",), (reply, "request(date)"))
    assert not check.acted
    assert "wonka" in check.text.lower()
    assert "right?" in check.text
    assert answer.understood == Frame("request", informs, ("theater",))


def test_values_named_in_full_are_not_checked(talk):
    (answer,) = talk(("which theater has wonka in reno?", "request(date)"))
    assert not answer.memory.asking.is_check


@pytest.mark.parametrize(
    ("reply", "people"), [("yes, just the three of us", "3"), ("YES. Wonka.", None)]
)
def test_a_yes_to_a_check_may_say_more_and_is_not_checked_again(talk, reply, people):
    _, answer = talk(("wonkka in renno?",), (reply, "request(date)"))
    assert answer.memory.asking.is_check is False
    assert {"moviename": "wonka", "city": "reno"}.items() <= answer.understood.informs.items()
    assert answer.understood.informs.get("numberofpeople") == people


def test_what_was_heard_with_some_doubt_is_said_back_and_acted_on(talk):
    (answer,) = talk(("wonka in albany, for two?", "request(date)", "request(date)"))
    assert not answer.memory.asking.is_check
    assert "theater" in answer.understood.requests
    said = answer.text.lower()
    assert "wonka" in said
    assert "albany" in said
    assert "right?" not in said


def test_who_asks_what_another_theater_has_no_longer_wishes_the_movie(talk, spelling):
    on = {(r.get("city"), r.get("theater"), r.get("moviename")) for r in spelling.domain.records}
    on = sorted(one for one in on if None not in one)
    city, movie, theater = next(
        (city, movie, other)
        for city, _, movie in on
        for where, other, _ in on
        if where == city and (city, other, movie) not in on
    )
    wish = (f"inform(moviename={movie}, city={city})", "request(date)")
    _, answer = talk(wish, (f"request(moviename) inform(theater={theater})", "request(date)"))
    assert (city, theater, answer.answered.informs["moviename"]) in on


def test_no_detail_is_owned_up_to_that_the_name_of_the_theater_says(talk, spelling):
    chain, theater = "theater_chain", "theater"
    record = next(
        record
        for record in spelling.domain.records
        if chain not in record and record.get(theater, "").startswith("amc ")
    )
    told = ", ".join(f"{slot}={record[slot]}" for slot in ("moviename", theater))
    (answer,) = talk((f"inform({told}, {chain}=amc)", "request(date)"))
    assert answer.memory.state["aside"].any()
    assert "on file" not in answer.text
    assert "promise" not in answer.text


@pytest.mark.parametrize(
    ("text", "kept"),
    [
        ("is there another {theater_chain}?", "theater_chain"),
        ("what else that time?", "starttime"),
    ],
)
def test_who_asks_for_another_of_a_chain_or_at_that_time_keeps_that(talk, spelling, text, kept):
    place = ("moviename", "theater", "date", "starttime")
    named = [record for record in spelling.domain.records if {"theater_chain", *place} <= {*record}]
    slot = {"theater_chain": "theater", "starttime": "moviename"}[kept]
    for record in named[:20]:
        told = ", ".join(f"{name}={record[name]}" for name in (*place, "theater_chain"))
        *_, answer = talk((f"inform({told})", "inform(taskcomplete)"), (text.format(**record),))
        act = answer.answered
        told = act.informs if act.choices else answer.memory.proposal
        is_told = "no other" in answer.text and "theater chain" not in answer.text
        assert is_told or slot in {*act.requests, *told}, answer.text
        assert told.get(kept, record[kept]) == record[kept]


def test_others_are_of_what_the_words_name_and_keep_the_wishes(talk, spelling):
    wishes = {"moviename": "oppenheimer", "city": "los angeles", "date": "tonight"}
    told = ", ".join(f"{slot}={value}" for slot, value in wishes.items())
    fits = [record for record in spelling.domain.records if wishes.items() <= record.items()]
    for text, slot in (("who else shows it?", "theater"), ("which times are there?", "starttime")):
        _, answer = talk((f"inform({told})", "request(numberofpeople)"), (text,))
        assert answer.answered.requests == (slot,)
        assert {*answer.answered.choices} <= {record.get(slot) for record in fits}, text
    _, answer = talk((f"inform({told})", "request(theater)"), ("what's the latest I could go?",))
    assert answer.memory.proposal["starttime"] == "11:45pm"


def test_an_unknown_detail_is_owned_up_to_and_what_else_was_said_is_acted_on(talk):
    (answer,) = talk(("something whimsical", "request(city)"))
    assert "on file about this: whimsical" in answer.text
    assert answer.answered == Frame("request", {}, ("city",))
    assert answer.understood.informs == {"moviename": "wonka"}


def test_a_detail_is_owned_up_to_whenever_it_is_told(talk, spelling):
    told = "inform(moviename=barbie, other=based on a book)"
    first, *_, again = talk(
        (told, "request(city)"), ("two", "request(city)"), (told, "request(date)")
    )
    for answer in (first, again):
        assert "based on a book" in answer.text


def test_the_only_one_is_said_to_be_the_only_one(talk):
    *_, answer = talk(
        ("inform(state=ohio, date=tonight, starttime=7:55 pm)", "inform(taskcomplete)"),
        ("is that the only one?",),
    )
    assert "no other movie" in answer.text
    assert not answer.memory.proposal


def test_a_yes_after_a_proposal_takes_that_and_no_earlier_offer(talk):
    *_, proposed, answer = talk(
        ("inform(moviename=kung fu panda 4, state=ny, date=friday)", "inform(taskcomplete)"),
        ("is there a later time?",),
        ("great, 6:40", "inform(taskcomplete)"),
    )
    assert proposed.memory.proposal.keys() == {"starttime"}
    assert proposed.memory.proposal.items() <= answer.answered.informs.items()
    assert not answer.ended


def test_a_wish_for_a_detail_excludes_nothing_and_is_owned_up_to_once(talk):
    detail = ("inform(moviename=wonka, city=tampa, genre=horror)", "inform(taskcomplete)")
    answer, later = talk(detail, ("inform(numberofpeople=2)", "inform(taskcomplete)"))
    assert answer.answered.informs["taskcomplete"] == "ticket available"
    assert answer.text.count("horror") == 1
    assert "horror" not in later.text


def test_whether_another_one_is_there_is_not_answered_from_the_offer(talk):
    _, about = talk(OFFER, ("is it in reno?", "request(date)"))
    _, another = talk(OFFER, ("is the reno one still on?", "request(date)"))
    assert about.memory.state["offered"]
    assert not another.memory.state["offered"]
    assert another.understood.informs["city"] == "reno"


def test_what_is_refused_by_name_comes_back_only_when_it_is_named(talk):
    again = ("inform(numberofpeople=2)", "inform(taskcomplete)")
    named = ("inform(city=newark)", "inform(taskcomplete)")
    _, other, later, back = talk(OFFER, ("not newark", "inform(taskcomplete)"), again, named)
    for answer in (other, later):
        assert "newark" not in [*answer.answered.informs.values(), *answer.memory.proposal.values()]
    assert {"city": "newark"} in later.memory.refused
    assert "newark" in " ".join(back.answered.informs.values())


@pytest.mark.parametrize("refused", [{}, {"city": "atlantis"}])
def test_to_refuse_what_no_record_has_refuses_nothing(partner_with, talk, refused):
    (offer,) = talk(OFFER)
    memory = replace(offer.memory, refused=(refused,))
    assert partner_with(None).reply(memory, "yes", 1).ended == "agent"
    again = partner_with(None).reply(memory, "inform(numberofpeople=2)", 1)
    assert "newark" in again.answered.informs.values()


def test_another_part_of_the_day_is_proposed_before_another_city(talk):
    told = "inform(moviename=air, theater=regal san francisco pavilion 16, date=tonight)"
    (answer,) = talk((told, "request(date)"))
    assert answer.memory.proposal["date"] == "later today"
    assert "nothing" not in answer.text.lower()


def test_another_day_is_proposed_before_another_city_or_movie(spelling):
    domain = tensorize(spelling.domain)
    records, (movie, city, date) = Records(domain), map(domain.slot.get, SHOWN)
    rows = domain.records[(domain.records[:, [movie, city, date]] != NONE).all(-1)]
    for row in rows[::20]:
        there = (rows[:, [movie, city]] == row[[movie, city]]).all(-1)
        other = next(value for value in rows[:, date].tolist() if value not in rows[there, date])
        held = torch.zeros_like(row)
        held[[movie, city]] = row[[movie, city]]
        held[date] = other
        assert records.nearest(held).keys() == {date}


@pytest.mark.parametrize("text", ["yes", "book it"])
def test_a_goodbye_says_what_is_booked_and_where(talk, text):
    *_, end = talk(OFFER, (text, "thanks"))
    assert end.ended == "agent"
    assert "booked" in end.text
    for part in ("Guardians of the Galaxy", "Newark", "at "):
        assert part in end.text


def test_a_yes_may_add_to_an_offer_what_it_does_not_say(talk):
    *_, end = talk(OFFER, ("yes please, just the three of us", "inform(taskcomplete)", "thanks"))
    assert (end.ended, end.answered.act) == ("agent", "thanks")
    assert end.answered.informs["numberofpeople"] == "3"
    assert end.answered.informs["taskcomplete"] == "ticket available"


@pytest.mark.parametrize(
    "text",
    [
        "just the three of us, please",
        "yes, the cheap seats",
        "yes, just the three of us?",
        "ok, inform(city=reno)",
    ],
)
def test_a_yes_that_says_something_else_books_nothing(talk, text):
    *_, answer = talk(OFFER, (text, "inform(taskcomplete)", "thanks"))
    assert answer.ended == ""


def test_a_yes_to_a_question_after_an_offer_books_nothing(talk):
    denied = ("deny", "request(date)", "request(date)")
    *_, answer = talk(OFFER, denied, ("yes", "request(genre)", "thanks"))
    assert answer.ended == ""


def test_a_no_to_what_was_in_doubt_asks_for_other_words(talk):
    _, no, said = talk(("wonkka in renno?",), ("no",), ("inform(city=newark)", "request(date)"))
    assert (no.acted, no.answered) == (False, Frame("not_sure"))
    assert said.understood.informs == {"city": "newark"}


def test_book_it_makes_the_agent_offer_and_after_an_offer_it_is_a_yes(talk):
    told = (OFFER[0], "request(date)")
    offer, end = talk(told, ("book it", "request(genre)", OFFER[1]), ("book it", "thanks"))[1:]
    assert "taskcomplete" in offer.answered.informs
    assert offer.control == ("book",)
    assert end.ended == "agent"


def test_a_name_that_no_record_has_is_asked_about(talk):
    (answer,) = talk(("inform(city=atlantis, moviename=barbie)",))
    assert (answer.acted, answer.answered.requests) == (False, ("city",))
    assert "atlantis" in answer.text.lower()
    assert answer.memory.asking.waiting.informs == {"moviename": "barbie"}


@pytest.mark.parametrize(
    ("texts", "slot"),
    [
        (["request(city) inform(moviename=wonka)"], "city"),
        (["inform(city=I do not care)"], "city"),
        ([SHOWING, "inform(numberofpeople=2)"], "city"),
        (["inform(city=newark)"], "state"),
        (["inform(city=newark)"], "video_format"),  # few goals have it
        ([OFFER[0], "request(theater)"], "theater"),
    ],
)
def test_the_agent_does_not_ask_for_what_it_should_know(talk, texts, slot):
    *first, last = texts
    before = [(text, "request(starttime)") for text in first]
    *_, answer = talk(*before, (last, f"request({slot})", "request(date)"))
    assert answer.answered.requests == ("date",)


def test_nothing_is_told_that_nobody_asked_for_and_nothing_empty_is_said(talk):
    wishes = ("inform(city)", "inform(theater)", "inform(ticket)", "deny", "request(date)")
    (answer,) = talk((SHOWING, *wishes))
    assert (str(answer.answered), answer.control) == ("request(date)", ("news",))


@pytest.mark.parametrize(
    ("rules", "heard"), [((), "request(city)"), (("aside",), "request(theater)")]
)
def test_a_question_in_place_of_an_answer_is_read_by_itself(talk, rules, heard):
    *_, answer = talk(
        ("inform(moviename=wonka)", "request(city)"), ("where?", "thanks"), rules=rules
    )
    assert str(answer.understood) == heard


def test_only_words_of_farewell_end_a_conversation(talk):
    turns = ("lorem ipsum",), ("lorem ipsum",), ("lorem ipsum", "request(city)")
    assert [answer.ended for answer in talk(*turns)] == ["", "", ""]
    assert talk(("goodbye",))[0].ended == "person"


def test_thanks_with_a_goodbye_ends_a_conversation_unless_it_takes_an_offer(talk):
    *_, answer = talk(*KNOWN, ("thanks, bye", "request(city)"))
    assert (answer.understood, answer.ended) == (Frame("closing"), "person")
    *_, answer = talk(OFFER, ("thanks, bye", "inform(price)", "thanks"))
    assert (answer.answered.act, answer.ended) == ("thanks", "agent")


def test_without_rules_the_agent_has_its_way(talk):
    first, second = talk((SHOWING, "request(city)"), ("yes", "request(city)"), rules=())
    assert str(first.answered) == str(second.answered) == "request(city)"
    assert "right?" not in first.text
    assert second.control == ()


def test_a_rule_that_leaves_nothing_is_passed_over(agents):
    agent = agents["bbqn"]
    draws = agent.simulator.draw_reset((50,), torch.Generator().manual_seed(0))
    state = agent.simulator.reset(draws, agent.active)
    only_thanks = torch.zeros_like(agent.legal)
    only_thanks[agent.domain.action_index("thanks")] = True
    allowed, _ = Control(agent.simulator).allowed(state, only_thanks.expand(50, -1))
    assert torch.equal(allowed, only_thanks.expand(50, -1))


def test_an_unknown_rule_is_refused(agents):
    with pytest.raises(ValueError, match="rule"):
        Control(agents["bbqn"].simulator, ["no"])
