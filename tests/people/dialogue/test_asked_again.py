"""Asking again in a chat, and at the simulator's level of text: one rule."""

from __future__ import annotations

from itertools import product
from types import SimpleNamespace

import pytest
from acts import Acts

pytest.importorskip("pycrfsuite", reason="needs the extra language")

from bbq_torchrl.domains import tensorize
from bbq_torchrl.envs.text_channel import TextChannel
from bbq_torchrl.people.chat import Partner
from bbq_torchrl.people.language import Frame, Unclear, Understood
from bbq_torchrl.people.language.asking import Asking

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
    channel = TextChannel(tensorize(spelling.domain), other, mouth, below)
    times, act, *rest = channel._hear(MEANT, None, 0).tolist()
    frame = channel.coding.frame(act, rest[: len(rest) // 2], rest[len(rest) // 2 :])
    assert other.questions == ears.questions
    assert times == len(ears.questions) - 1
    assert (frame.act, frame.informs) == (answer.understood.act, answer.understood.informs)


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
