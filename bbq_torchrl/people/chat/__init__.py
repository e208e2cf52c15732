"""Chat with a trained agent: the person's text becomes an act, and the agent's act a sentence.

``bbq chat <run folder>`` is the command line (extra ``chat``). :class:`Partner` is the same without
a terminal, and :func:`~bbq_torchrl.people.study.players.make_talker` makes the agents of a study.
"""

from __future__ import annotations

from bbq_torchrl.people.dialogue.exchange import Answer
from bbq_torchrl.people.dialogue.partner import Partner
from bbq_torchrl.people.dialogue.tracking import Tracking
from bbq_torchrl.people.dialogue.trained_agent import TrainedAgent

__all__ = ["Answer", "Partner", "Tracking", "TrainedAgent"]
