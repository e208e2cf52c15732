"""The simulator: users, a tracker and a knowledge base as batched tensor functions."""

from __future__ import annotations

from bbq_torchrl.simulator.error_model import Channel, ErrorModel, SlotErrorMode
from bbq_torchrl.simulator.features import FeatureLayout, Rewards
from bbq_torchrl.simulator.knowledge_base import KnowledgeBase
from bbq_torchrl.simulator.measured_errors import MeasuredErrors
from bbq_torchrl.simulator.profiles import Profile
from bbq_torchrl.simulator.simulator import Simulator, Transcript
from bbq_torchrl.simulator.tracker import Utterance

__all__ = [
    "Channel",
    "ErrorModel",
    "FeatureLayout",
    "KnowledgeBase",
    "MeasuredErrors",
    "Profile",
    "Rewards",
    "Simulator",
    "SlotErrorMode",
    "Transcript",
    "Utterance",
]
