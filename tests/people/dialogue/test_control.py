"""The rules between an agent's choice and what a person reads, and asking again."""

import random
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
import yaml
from acts import Acts

from bbq_torchrl.domains import tensorize
from bbq_torchrl.domains.values import NO_MATCH
from bbq_torchrl.envs.text_channel import TextChannel
from bbq_torchrl.people.chat import Partner
from bbq_torchrl.people.dialogue import RULES
from bbq_torchrl.people.dialogue.control import Control
from bbq_torchrl.people.dialogue.exchange import Memory
from bbq_torchrl.people.dialogue.judge import Judge
from bbq_torchrl.people.language import Frame, Unclear, Understood
from bbq_torchrl.simulator import Utterance

TABLE = yaml.safe_load(Path(__file__).with_name("control.yaml").read_text(encoding="utf-8"))
MOST = tuple(name for name in RULES if name != "asks_first")
HEARD = {
    row["text"]: Understood(
        Frame.parse(row["frame"]),
        row.get("confidence", 0.9),
        tuple(Unclear(**unclear) for unclear in row.get("unclear", ())),
    )
    for row in TABLE["heard"]
}


class Words(Acts):
    """Acts, and the sentences of the table."""

    def __call__(self, text, question=None):
        if text == "where?":
            asked = question.requests if question else ("theater",)
            return Understood(Frame("request", {}, asked), 0.9)
        return HEARD[text] if text in HEARD else super().__call__(text, question)


@pytest.fixture(scope="module")
def partner_with(agents, mouth, spelling):
    """Makes the partner with these rules, once."""
    return cache(lambda rules: Partner(agents["bbqn"], Words(), mouth, spelling, rules=rules))


@pytest.fixture
def talk(partner_with, monkeypatch):
    """Talks with an agent that takes the first allowed of the actions it prefers in each turn.

    Without ``rules`` it has all but ``asks_first``, so that an offer needs no number of people.
    """

    def talk(*turns, rules=MOST):
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
            memory = Memory.from_json(answers[-1].memory.to_json())  # which is all there is
        return answers

    return talk


WHOLE = {
    "answered": lambda answer: str(answer.answered),
    "understood": lambda answer: str(answer.understood),
    "requests": lambda answer: [*answer.answered.requests],
    "choices": lambda answer: [*answer.answered.choices],
    "acted": lambda answer: answer.acted,
    "ended": lambda answer: answer.ended,
    "control": lambda answer: [*answer.control],
    "waiting": lambda answer: str(answer.memory.asking.waiting),
    "proposal": lambda answer: answer.memory.proposal,
    "offered": lambda answer: answer.memory.state["offered"],
    "excludes": lambda answer: not answer.memory.state["aside"].any(),
    "lacks_a_match": lambda answer: bool((answer.memory.state["held"] == NO_MATCH).any()),
}


@pytest.mark.parametrize("case", TABLE["talks"], ids=lambda case: case["what"])
def test_in_a_talk(talk, case):
    rules = case.get("rules", MOST)
    answers = talk(*case["turns"], rules=rules if rules is None else tuple(rules))
    for answer, then in zip(answers[-len(case["then"]) :], case["then"], strict=True):
        told, text = answer.answered.informs, answer.text.lower()
        whole = {key: WHOLE[key](answer) for key in WHOLE.keys() & then}
        assert whole.items() <= then.items()
        assert then.get("tells", {}).items() <= told.items()
        assert then.get("hears", {}).items() <= answer.understood.informs.items()
        assert then.get("proposes", {}).items() <= answer.memory.proposal.items()
        assert told.keys().isdisjoint(then.get("lacks", ()))
        assert {*told.values(), *answer.memory.proposal.values()}.isdisjoint(then.get("never", ()))
        said = [*then.get("says", ()), *(told[slot] for slot in then.get("answers", ()))]
        assert not [part for part in said if part.lower() not in text]
        assert not [part for part in then.get("says_not", ()) if part in text]


OFFER = ("inform(moviename=guardians of the galaxy vol. 3, city=newark)", "inform(taskcomplete)")


def test_answers_and_wishes_are_those_of_one_record(talk, spelling):
    """Whatever else the agent does, and whenever the person asks and tells, without lists."""
    chance, judge = random.Random(3), Judge(spelling.domain)
    goals = [goal for goal in spelling.domain.goals if judge.is_attainable(goal)]
    actions = list(map(str, spelling.domain.actions))
    right = 0
    for goal in chance.sample(goals, 20):
        texts = [f"inform({slot}={value})" for slot, value in goal.constraints.items()]
        texts += [f"request({slot})" for slot in goal.requests]
        chance.shuffle(texts)
        told = {}
        turns = [(text, *chance.sample(actions, len(actions))) for text in texts]
        rules = tuple(name for name in RULES if name != "way_out")
        for text, answer in zip(texts, talk(*turns, rules=rules), strict=True):
            told |= answer.answered.informs
            assert set(Frame.parse(text).requests) <= answer.answered.informs.keys()
        wanted = {**goal.constraints, **{slot: told[slot] for slot in goal.requests}}
        for slot in spelling.domain.free_slots:
            wanted.pop(slot, None)
        right += any(wanted.items() <= record.items() for record in spelling.domain.records)
    assert right >= 19  # at random an agent seldom tells what cannot be taken back in time


@pytest.mark.parametrize("refused", [{}, {"city": "atlantis"}])
def test_to_refuse_what_no_record_has_refuses_nothing(partner_with, talk, refused):
    (offer,) = talk(OFFER)
    memory = replace(offer.memory, refused=(refused,))
    assert partner_with(None).reply(memory, "yes", 1).ended == "agent"
    again = partner_with(None).reply(memory, "inform(numberofpeople=2)", 1)
    assert "newark" in again.answered.informs.values()


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


MEANT = Frame("inform", {"moviename": "wonka", "numberofpeople": "2"})
SURE, UNSURE = Understood(MEANT, 0.9), Understood(MEANT, 0.5)
TWO = Unclear("moviename", "won", ("wonka", "wonka 2"))
UNCLEAR = Understood(Frame("inform", {"numberofpeople": "2"}), 0.9, (TWO,))


class Ears(Acts):
    """An understander of one thing after the other, which keeps what was asked."""

    lexicon = SimpleNamespace(key=lambda slot, value: value)

    def __init__(self, heard):
        self.heard, self.questions = list(heard), []

    def __call__(self, text, question=None):
        self.questions.append(str(question))
        return self.heard.pop(0)


@pytest.mark.parametrize("heard", list(product((SURE, UNSURE, UNCLEAR), repeat=3)))
@pytest.mark.parametrize("below", [None, 0, 0.95])
def test_the_level_of_text_hears_what_a_chat_hears(agents, mouth, spelling, below, heard):
    ears, other = Ears(heard), Ears(heard)
    partner = Partner(agents["bbqn"], ears, mouth, spelling, ask_below=below, rules=())
    answer = partner.reply(None, "hello", 0)
    while not answer.acted:
        answer = partner.reply(answer.memory, "hello", 0)
    domain = tensorize(spelling.domain)
    channel, active = TextChannel(domain, other, mouth, below), torch.ones(domain.n_slots).bool()
    informs = torch.tensor(channel.coding.ids(MEANT.informs))
    said = Utterance(torch.tensor(domain.act["inform"]), informs, ~active)
    draws = {"words": torch.tensor(0.0)}
    found = channel.transmit(said, None, said.act, torch.tensor(False), draws, active)
    assert other.questions == ears.questions
    assert int(found.repeats) == len(ears.questions) - 1
    frame = channel.coding.frame(int(found.act), found.informs.tolist(), found.requests.tolist())
    assert (frame.act, frame.informs) == (answer.understood.act, answer.understood.informs)
