"""A study with simulated users, who are enrolled, answered, judged and stored like people."""

from __future__ import annotations

import hashlib
from contextlib import closing
from random import Random
from types import SimpleNamespace
from typing import TYPE_CHECKING, Protocol

from bbq_torchrl.people.study.conversations import Conversations, seed_of
from bbq_torchrl.people.study.database import HIGHEST, LOWEST, SCALES, current
from bbq_torchrl.people.study.storage import Store

if TYPE_CHECKING:
    from collections.abc import Callable

    from bbq_torchrl.domains.frames import Frame
    from bbq_torchrl.people.dialogue import Talker
    from bbq_torchrl.people.study.plan import Study

_DAY, _HOUR, _PAUSE = 86_400.0, 3_600.0, 10.0


class User(Protocol):
    """A simulated user in one conversation.

    Attributes:
        satisfied: whether it got what it wanted, as far as it knows.
    """

    satisfied: bool

    def say(self, said: Frame | None) -> str:
        """Returns its reply to the agent's act; ``None`` begins the conversation."""


def simulate(
    study: Study,
    talker: Talker,
    users: Callable[[int, int], User],
    *,
    seed: int,
    tell: Callable[[str], None] = lambda _: None,
) -> None:
    """Plays a study with simulated users, one after the other.

    They take the same steps as people (consent, conversation, rating) through the same code and
    store. Stored exchanges are not repeated, so an interrupted simulation continues.

    Args:
        study: the study; its data file is next to the study file.
        talker: the agents.
        users: makes a user from the number of its goal, from 1, and a seed.
        seed: seed of the plan, the users and their ratings.
        tell: called with progress messages.

    Raises:
        StoreError: the study's data cannot be used, or comes from people or another seed.
        ValueError: an agent cannot be loaded.
    """
    clock = SimpleNamespace(now=0.0)  # set by hand: a replayed study has the same times
    secret = f"simulated {seed}"
    with closing(
        Store(study, talker, simulated=True, secret=secret, clock=lambda: clock.now)
    ) as store:
        conversations = Conversations(study, store, talker)
        wanted = study.terms.participants
        for place in range(wanted):
            clock.now = begin = place * _DAY
            token = conversations.enroll({"nonce": _nonce(seed, place), "consent": "yes"})
            user = None
            while (session := current(store.sessions(token))) is not None:
                form = {"session": str(session.position)}
                drawn = seed_of(seed, place, session.position)
                if user is None:
                    clock.now = begin + session.position * _HOUR
                    user, said, number = users(session.goal, drawn), None, 0
                if not session.is_ended or number < session.messages:
                    number += 1
                    clock.now += _PAUSE
                    form |= {"nonce": _nonce(session.id, number), "turn": str(number)}
                    conversations.say(token, {**form, "text": user.say(said)})
                    said = store.exchanges(session.id)[number - 1].answered
                else:
                    ratings = drawn_ratings(user.satisfied, number, drawn)
                    form |= {name: str(rating) for name, rating in ratings.items()}
                    form["verdict"] = "yes" if user.satisfied else "no"
                    conversations.rate(token, {**form, "nonce": _nonce(drawn, "rating")})
                    user = None
            if (place + 1) % 10 == 0 or place + 1 == wanted:
                tell(f"{place + 1} of {wanted} simulated users have taken part")


def _nonce(*parts: object) -> str:
    return hashlib.sha256(" ".join(map(str, parts)).encode()).hexdigest()[:32]


RATING_RULE = (
    "Their own verdict is whether they have got what they wanted, as far as they know. Their "
    "ratings are drawn, each scale by itself: 4.5 after a yes and 2 after a no, less 0.1 for every "
    "message beyond the fifth, plus normal noise of standard deviation 0.75, rounded, from 1 to 5. "
    "So ratings say nothing that verdict and length do not."
)
"""The rule of :func:`drawn_ratings`, as reports state it."""


def drawn_ratings(satisfied: bool, messages: int, seed: int) -> dict[str, int]:
    """Returns a simulated user's ratings, by scale.

    Args:
        satisfied: the user's verdict.
        messages: the number of messages that it has sent.
        seed: seed of the noise.
    """
    rng, middle = Random(seed), (4.5 if satisfied else 2.0) - 0.1 * max(0, messages - 5)
    return {name: min(HIGHEST, max(LOWEST, round(rng.gauss(middle, 0.75)))) for name in SCALES}
