"""Dialogue state, policy, control, success and beliefs: the parts that chat and study share.

This module defines the protocol of an agent in a study: text in; text, acts and beliefs out.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.domains.frames import Frame


RULES = {
    "yes_ends": "Only a yes to an offer or a proposal ends the dialogue.",
    "asks_first": "What only the person can say is asked for before an offer, twice at most.",
    "answers_first": "A question is answered before anything else.",
    "no_asking_back": "The agent does not ask for what is known, asked for, or matters to few.",
    "implied": "The agent does not ask for what another value determines, as a city its state.",
    "news": "The agent tells only what the person asks for, and says something.",
    "no_repeat": "No act is repeated unchanged.",
    "take_back": "An answer that does not fit what the person says later is taken back.",
    "on_file": "A wish for what the fitting records do not say, or for a detail, excludes nothing.",
    "way_out": "If no record has all wishes, or others are asked for, the nearest are offered.",
    "drop": "A wish that the person takes back is dropped, and the agent says so.",
    "confirm": "What was understood with some doubt is said back.",
    "book": '"Book it" makes the agent offer, and after an offer it is a yes.',
    "names": "A name that no record has is asked about.",
    "farewell": "Only words of farewell let a person end the conversation.",
    "help": "Questions about the agent itself are answered.",
    "aside": "A question in place of an answer is read by itself.",
}
"""The rules of :mod:`~bbq_torchrl.people.dialogue.control`, in the order in which they apply."""


@dataclass(frozen=True)
class Belief:
    """An agent's belief about one action.

    Attributes:
        action: the action's name.
        mean: the mean of its Q-value.
        band50: lower and upper end of the middle half of its posterior.
        band90: the same for the middle 90 %.
        p_best: probability that no other action has a higher Q-value.
    """

    action: str
    mean: float
    band50: tuple[float, float]
    band90: tuple[float, float]
    p_best: float


@dataclass(frozen=True)
class Beliefs:
    """An agent's beliefs before its act.

    Attributes:
        actions: the legal actions, or the best of them.
        entropy: the entropy of the distribution of the best action, in nats.
    """

    actions: tuple[Belief, ...]
    entropy: float


@dataclass(frozen=True)
class Reply:
    """An agent's answer to a person's text, with everything that is stored about it.

    Attributes:
        text: the agent's text.
        understood: the act understood from the person's text.
        answered: the agent's act, with its values filled in. A booking informs the domain's
            complete slot (``ticket available`` or ``no match``) and all values in the tracker.
        confidence: the nlu's confidence, in [0, 1]; ``None`` without one.
        ended: whether the agent ends the conversation.
        state: everything the talker needs to answer the next text; the study stores it and passes
            it back, so that a conversation continues after any crash.
        beliefs: the agent's beliefs; ``None`` for an agent without a posterior.
    """

    text: str
    understood: Frame
    answered: Frame
    confidence: float | None = None
    ended: bool = False
    state: str = ""
    beliefs: Beliefs | None = None


class Talker(Protocol):
    """The agents of a study, as a function from a conversation's state and a text to an answer.

    :meth:`reply` is called from several threads, but never twice at once for a conversation.

    Attributes:
        domain: the study's domain, where needed with one spelling for each value. Goal cards use
            its spelling, and acts are judged by it.
        labels: people's names for the domain's slots; a slot without a label is shown by its name.
    """

    domain: Domain
    labels: Mapping[str, str]

    def fingerprint(self, agent: str) -> str:
        """Returns a hash of the agent's weights and of everything else that determines its replies.

        Raises:
            ValueError: the agent cannot be loaded, or is of another domain; in one sentence.
        """

    def reply(self, agent: str, state: str | None, text: str, seed: int) -> Reply:
        """Answers a text.

        Args:
            agent: the agent's name in the study.
            state: the state in the agent's last answer; ``None`` at the start.
            text: the person's text: one line, not blank, at most 1,000 characters.
            seed: the seed of everything random in the answer; the same for a text sent again.
        """
