"""A conversation of acts with an agent whose decisions are given."""

from __future__ import annotations

import pytest
from acts import Acts

from bbq_torchrl.people.chat import Partner
from bbq_torchrl.people.dialogue.exchange import Memory
from bbq_torchrl.people.language import Frame


def talk(partner, *texts):
    answers, memory = [], None
    for number, text in enumerate(texts):
        answers.append(partner.reply(memory, text, number))
        memory = answers[-1].memory
    return answers


def test_an_act_is_answered_with_an_act_and_its_sentence(partner, decided):
    decided(partner.agent, "request(city)", "inform(taskcomplete)", "thanks")
    first, second, third = talk(
        partner, "request(ticket) inform(moviename=barbie)", "inform(city=reno)", "thanks"
    )
    assert str(first.answered) == "request(city)"
    assert first.text.endswith((".", "?"))
    assert second.answered.informs["city"] == "reno"
    assert second.answered.informs["taskcomplete"] in ("ticket available", "no match")
    assert (first.ended, second.ended, third.ended) == ("", "", "agent")


def test_memory_is_all_there_is(partner, decided, agents, mouth):
    decided(partner.agent, "request(city)", "request(date)", "request(date)")
    first, second = talk(partner, "inform(moviename=barbie)", "inform(city=reno)")
    other = Partner(agents["bbqn"], Acts(), mouth, rules=())
    again = other.reply(Memory.from_json(first.memory.to_json()), "inform(city=reno)", 1)
    assert again.memory.to_json() == second.memory.to_json()
    assert (again.text, again.understood, again.answered) == (
        second.text,
        second.understood,
        second.answered,
    )


def test_what_is_not_understood_is_asked_again_twice_at_most(partner, decided):
    decided(partner.agent, "request(city)")
    answers = talk(partner, "?", "?", "?", "?")
    assert [answer.acted for answer in answers] == [False, False, True, False]
    assert answers[0].answered == Frame("not_sure")


def test_what_cannot_be_read_changes_nothing(partner, decided):
    decided(partner.agent, "request(city)", "request(date)")
    answers = talk(partner, "inform(moviename=barbie)", "\x00", "inform(city=reno)")
    assert answers[1].reading is None
    assert "at least one character" in answers[1].text
    assert str(answers[2].answered) == "request(date)"


def test_a_greeting_is_returned_and_a_farewell_ends_it(partner):
    hello, bye = talk(partner, "greeting", "closing")
    assert (hello.answered, hello.acted, hello.ended) == (Frame("greeting"), False, "")
    assert (bye.answered, bye.ended) == (Frame("closing"), "person")


@pytest.mark.parametrize(("last", "ended"), [("request(city)", "turns"), ("thanks", "agent")])
def test_it_ends_after_as_many_turns_as_the_agent_has_learned_with(partner, decided, last, ended):
    decided(partner.agent, "request(city)", last)
    # What is asked again takes turns, too; it has 8 acts.
    answers = talk(partner, "inform(moviename=barbie)", "?", "?", "inform(city=reno)")
    assert [answer.ended for answer in answers] == ["", "", "", ended]
