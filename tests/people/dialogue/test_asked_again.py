"""Asking again in a chat, and at the simulator's level of text: one rule."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from acts import Acts

pytest.importorskip("pycrfsuite", reason="needs the extra language")

from bbq_torchrl.domains import tensorize
from bbq_torchrl.envs.text_channel import TextChannel
from bbq_torchrl.people.chat import Partner
from bbq_torchrl.people.language import Frame, Unclear, Understood
from bbq_torchrl.people.language.asking import MAX_ASKS, Asking
from bbq_torchrl.people.study.players import SimulatedUser
from bbq_torchrl.simulator import Simulator


class Speaker:
    """Says frames as transcripts write them, and how often it was asked again."""

    def __init__(self, first=0):
        self.first = first

    def user(self, frame, question=None, *, session=0, turn=0):
        return f"{session} {turn - self.first} {frame}"


class Ears(Acts):
    """An understander sure of some texts and not of others, and of two readings of one value."""

    def __init__(self):
        self.lexicon = SimpleNamespace(key=lambda slot, value: value)
        self.questions = []

    def __call__(self, text, question=None):
        self.questions.append(str(question))
        session, turn, frame = text.split(" ", 2)
        kind = (int(session) + int(turn)) % 4
        frame = Frame.parse(frame)
        if kind == 1 and frame.informs:
            slot, value = next(iter(frame.informs.items()))
            rest = {other: known for other, known in frame.informs.items() if other != slot}
            unclear = Unclear(slot, value[:3], (value, f"{value} 2"))
            return Understood(Frame(frame.act, rest, frame.requests), 0.9, (unclear,))
        return Understood(frame, (0.8, 0.9, 0.5, 0.9)[kind])


@pytest.mark.parametrize("below", [None, 0, 0.85])
def test_the_level_of_text_hears_what_a_chat_hears(movie, agents, mouth, spelling, below):
    simulator = Simulator(tensorize(spelling.domain))
    ears, choices = Ears(), 0
    partner = Partner(agents["bbqn"], ears, mouth, spelling, ask_below=below, rules=())
    channel = TextChannel(simulator.domain, ears, Speaker(), below)
    asked = set()
    for goal in range(1, 13):
        user = SimulatedUser(simulator, Speaker(first=1), goal, goal)
        meant = user._meant()
        answer, asks = partner.reply(None, user.say(None), 0), 0
        while not answer.acted:
            answer = partner.reply(answer.memory, user.say(answer.answered), 0)
            asks += 1
        in_chat = list(ears.questions)
        ears.questions.clear()

        times, act, *rest = channel._hear(meant, None, goal).tolist()
        heard = channel.coding.frame(act, rest[: len(rest) // 2], rest[len(rest) // 2 :])
        assert ears.questions == in_chat
        assert (times, heard.informs) == (asks, answer.understood.informs)
        assert set(heard.requests) == set(answer.understood.requests)
        asked.add(asks)
        choices += any("multiple_choice" in question for question in in_chat)
        ears.questions.clear()
    assert asked == ({0} if below == 0 else {0, 1, MAX_ASKS})
    assert (choices > 0) == (below != 0)


def test_what_was_told_beside_a_name_is_kept_however_often_that_is_asked_about():
    unclear = Unclear("moviename", "godzilla", ("godzilla minus one", "godzilla x kong"))
    asking = Asking().again(Understood(Frame("inform", {"numberofpeople": "2"}), 0.9, (unclear,)))
    name_alone = Understood(Frame("inform"), 0.9, (unclear,))
    asking = asking.again(name_alone)
    chosen = Frame("inform", {"moviename": "godzilla x kong"})
    assert asking.joined(chosen).informs == {"numberofpeople": "2", **chosen.informs}
    # As where it was asked too often, and the name stays unknown.
    assert asking.joined(name_alone.frame).informs == {"numberofpeople": "2"}
    assert asking.joined(Frame("closing")) == Frame("closing")
