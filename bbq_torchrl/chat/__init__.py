"""Talking with a trained agent: what a person types becomes an act, and an act a sentence.

``bbq chat <run folder>`` is the command line (extra ``chat``). :class:`Partner` is the same without
a terminal, and :func:`~bbq_torchrl.chat.talker.make_talker` is what a human study talks with.
"""

from __future__ import annotations

from bbq_torchrl.chat.agent import TrainedAgent
from bbq_torchrl.chat.partner import Answer, Partner
from bbq_torchrl.chat.tracking import Tracking

__all__ = ["Answer", "Partner", "Tracking", "TrainedAgent"]
