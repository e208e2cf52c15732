"""The rules between an agent's choice and what a person reads."""

from __future__ import annotations

import pytest
import torch
from acts import Acts

from bbq_torchrl.domains import NO_MATCH
from bbq_torchrl.people.chat import Partner
from bbq_torchrl.people.dialogue.control import RULES, Control
from bbq_torchrl.people.language import Frame, Understood

SHOWING = "inform(moviename=wonka, city=reno)"


class Words(Acts):
    """Acts, and a few sentences of people; some of them are understood badly."""

    def __call__(self, text, question=None):
        known = {
            "yes": Understood(Frame("confirm_answer"), 0.9),
            "no": Understood(Frame("deny"), 0.9),
            "any day but friday": Understood(Frame("inform", {"date": "friday"}), 0.95),
            "friday. for past lives": Understood(Frame("inform", {"date": "friday"}), 0.9),
            "lorem ipsum": Understood(Frame("closing"), 0.9),
            "goodbye": Understood(Frame("closing"), 0.9),
            "wonka in reno?": Understood(
                Frame("request", {"moviename": "wonka", "city": "reno"}, ("theater",)), 0.5
            ),
        }
        return known[text] if text in known else super().__call__(text, question)


@pytest.fixture
def talk(agents, mouth, spelling, monkeypatch):
    """Talks with an agent that takes the first allowed of the actions it prefers in each turn."""

    def talk(*turns, rules=None):
        partner = Partner(agents["bbqn"], Words(), mouth, spelling, rules=rules)
        answers, memory = [], None
        for number, (text, *preferred) in enumerate(turns):
            wishes = [partner.agent.domain.action_index(name) for name in preferred]

            def decide(observation, seed, allowed=None, wishes=wishes):
                return next(item for item in wishes if allowed is None or allowed[item])

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


def test_a_yes_to_an_offer_that_stands_ends_the_dialogue(talk):
    *_, last = talk(OFFER, ("yes", "inform(price)", "thanks"))
    assert (last.said.act, last.ended, last.control) == ("thanks", "agent", ("yes_ends",))


def test_a_yes_does_not_end_what_has_a_question_open(talk):
    question = (f"request(theater) {SHOWING}", "inform(taskcomplete)")
    *_, last = talk(question, ("yes", "thanks", "inform(theater)"))
    assert last.said.informs.keys() == {"theater"}


def test_a_question_after_an_offer_is_answered_next(talk):
    asks = ("request(theater)", "inform(taskcomplete)", "request(date)", "inform(theater)")
    *_, last = talk(OFFER, asks)
    assert last.said.informs.keys() == {"theater"}
    assert last.control[0] == "answers_first"


def test_with_a_question_open_nothing_else_is_told(talk):
    asks = (f"request(theater) {SHOWING}", "inform(genre)", "thanks", "request(date)")
    (answer,) = talk(asks)
    assert str(answer.said) == "request(date)"
    assert answer.control == ("no_unasked_inform",)


def test_no_act_is_repeated_unless_something_changed(talk):
    again = ("inform(numberofpeople=2)", "request(date)", "request(genre)")
    first, second = talk((SHOWING, "request(date)"), again)
    assert (str(first.said), str(second.said)) == ("request(date)", "request(genre)")
    other = ("inform(city=reno)", "inform(taskcomplete)", "thanks")
    assert [answer.said.informs["city"] for answer in talk(OFFER, other)] == ["newark", "reno"]


def test_a_no_match_is_forgotten_when_the_person_tells_a_value(talk):
    clash = ("inform(moviename=wonka, genre=horror)", "inform(theater)")
    tells = ("inform(moviename=barbie)", "request(price)")
    held = [
        talk(clash, tells, rules=rules)[-1].memory.state["held"] == NO_MATCH
        for rules in ((), ("drop_no_match",))
    ]
    assert [bool(slots.any()) for slots in held] == [True, False]


def test_what_is_known_is_checked_and_a_yes_confirms_it(talk):
    _, check, yes = talk(*KNOWN, ("yes", "request(genre)"))
    assert "right?" in check.text
    assert "reno" in check.text.lower()
    assert str(yes.heard) == "inform(city=reno)"


def test_a_no_to_a_check_forgets_the_value_and_asks_for_it(talk):
    *_, no, value = talk(*KNOWN, ("no",), ("inform(city=newark)", "request(genre)"))
    assert (no.acted, str(no.said)) == (False, "request(city)")
    assert "right?" not in no.text
    assert value.heard.informs == {"city": "newark"}


@pytest.mark.parametrize(
    ("reply", "informs"),
    [
        ("yes", {"moviename": "wonka", "city": "reno"}),
        ("inform(city=newark)", {"moviename": "wonka", "city": "newark"}),
    ],
)
def test_a_sentence_in_doubt_is_checked_and_keeps_what_was_understood(talk, reply, informs):
    check, answer = talk(("wonka in reno?",), (reply, "request(date)"))
    assert not check.acted
    assert "wonka" in check.text.lower()
    assert "right?" in check.text
    assert answer.heard == Frame("request", informs, ("theater",))


def test_a_no_to_what_was_in_doubt_asks_for_other_words(talk):
    _, no, said = talk(("wonka in reno?",), ("no",), ("inform(city=newark)", "request(date)"))
    assert (no.acted, no.said) == (False, Frame("not_sure"))
    assert said.heard.informs == {"city": "newark"}


def test_book_it_makes_the_agent_offer_and_after_an_offer_it_is_a_yes(talk):
    told = (OFFER[0], "request(date)")
    offer, end = talk(
        told, ("request(ticket)", "request(genre)", OFFER[1]), ("request(ticket)", "thanks")
    )[1:]
    assert "taskcomplete" in offer.said.informs
    assert offer.control == ("book",)
    assert end.ended == "agent"


def test_an_exact_name_that_the_understanding_dropped_is_checked(talk):
    check, yes = talk(("friday. for past lives",), ("yes", "request(city)"))
    assert not check.acted
    assert yes.heard.informs == {"date": "friday", "moviename": "past lives"}


def test_what_the_person_asks_for_is_not_asked_back(talk):
    asks = (
        "request(moviename) inform(city=reno)",
        "request(moviename)",
        "request(city)",
        "request(date)",
    )
    (answer,) = talk(asks)
    assert str(answer.said) == "request(date)"


def test_a_value_that_is_turned_round_is_checked(talk):
    check, no = talk(("any day but friday",), ("no",))
    assert not check.acted
    assert "friday" in check.text.lower()
    assert not no.acted


def test_only_words_of_farewell_end_a_conversation(talk):
    turns = ("lorem ipsum",), ("lorem ipsum",), ("lorem ipsum", "request(city)")
    assert [answer.ended for answer in talk(*turns)] == ["", "", ""]
    assert talk(("goodbye",))[0].ended == "person"


def test_without_rules_the_agent_has_its_way(talk):
    first, second = talk((SHOWING, "request(city)"), ("yes", "request(city)"), rules=())
    assert str(first.said) == str(second.said) == "request(city)"
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
    with pytest.raises(ValueError, match=f"a rule must be one of {', '.join(RULES)}, got 'no'"):
        Control(agents["bbqn"].simulator, ["no"])
