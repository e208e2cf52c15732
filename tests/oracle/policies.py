"""Scripted agents for one dialogue, as functions from the dialogue to an action name."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .dialogue import Dialogue

Policy = Callable[["Dialogue"], str]


def follow(script: Sequence[str]) -> Policy:
    """Returns an agent that says its script whatever the user says."""
    return lambda dialogue: script[min(dialogue.turn_count // 2, len(script) - 1)]


def careful(asked: Sequence[str]) -> Policy:
    """Returns an agent that asks for what is unfilled, answers requests, offers, and thanks."""

    def act(dialogue: Dialogue) -> str:
        tracker = dialogue.tracker
        if tracker.agent_act is None or tracker.agent_act == "request":
            requested = [asked.index(slot) for slot in tracker.agent_requests if slot in asked]
            already = max(requested, default=-1)
            for slot in asked[already + 1 :]:
                if slot not in tracker.held:
                    return f"request({slot})"
        if dialogue.world.domain.complete_slot in tracker.agent_informs:
            return "thanks"
        for slot in dialogue.world.slots:
            is_open = slot in tracker.user_requests and slot != dialogue.world.domain.ticket_slot
            if is_open and f"inform({slot})" in dialogue.world.action_names:
                return f"inform({slot})"
        return f"inform({dialogue.world.domain.complete_slot})"

    return act
