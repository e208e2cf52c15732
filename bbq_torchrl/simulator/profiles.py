"""Kinds of users, their mixes, and the traits that each dialogue's user draws from a mix."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from bbq_torchrl.domains import DomainTensors
from bbq_torchrl.domains.tensors import Movable, index_below, rows
from bbq_torchrl.domains.values import DONT_CARE, NONE
from bbq_torchrl.settings import (
    ABOVE_ZERO_TO_ONE,
    PROBABILITY,
    USERS,
    Allowed,
    check,
    check_values,
    filled,
    one_of,
    optional,
    setting,
)

HABITS = ("insists", "asks_late", "confirms", "changes_mind", "withholds", "explains")
"""The keys of a :class:`Profile` that are probabilities."""

CHANGES_AT = (2, 8)
"""The first and the last turn of the agent after which a user changes its mind."""

_RANGE = optional(
    Allowed(
        "two integers [least, most] from 1 to 1000",
        lambda value: (
            isinstance(value, (list, tuple))
            and len(value) == 2
            and all(type(number) is int for number in value)
            and 1 <= value[0] <= value[1] <= 1_000
        ),
    ),
    "as in the paper",
)
_KEYS = Allowed("a mapping of keys", lambda value: isinstance(value, Mapping))
_RATES = Allowed(
    "a mapping from slots to probabilities",
    lambda value: isinstance(value, Mapping) and all(map(PROBABILITY.test, value.values())),
)


@dataclass(frozen=True)
class Profile:
    """A kind of user. Everything is drawn once for each dialogue; defaults are the paper's user.

    Args:
        share: the share of the mix's dialogues.
        patience: fewest and most turns of the agent after which the user leaves, a failure.
        bears: fewest and most times that the agent may ignore its questions, by any act but the
            answer or a request; after the last it leaves, a failure.
        tells: fewest and most constraints told in a turn in which the user tells any value.
        insists: probability that it asks one question at a time, in every turn until it is
            answered, even while it answers the agent.
        asks_late: probability that it asks its questions only after an offer of a booking that
            meets its constraints, and gives thanks only after the answers.
        confirms: probability that it says yes (``confirm_answer``) when the agent tells or asks a
            constraint that it has told before.
        changes_mind: probability that it replaces a constraint that it has told, by a value with
            which some record meets all constraints and has values for all requests.
        withholds: probability that it only denies a wrong value, without telling the right one.
        explains: probability that it tells the right values when it denies an offer.
        slot_error_prob: probability of an error by slot, instead of the channel's.

    Raises:
        ValueError: if a value is not allowed.
    """

    share: float = setting(1.0, ABOVE_ZERO_TO_ONE, "share of the dialogues")
    patience: Sequence[int] | None = setting(None, _RANGE, "turns after which it leaves")
    bears: Sequence[int] | None = setting(None, _RANGE, "ignored questions after which it leaves")
    tells: Sequence[int] | None = setting(None, _RANGE, "constraints told in a turn")
    insists: float = setting(0.0, PROBABILITY, "repeats a question until it is answered")
    asks_late: float = setting(0.0, PROBABILITY, "asks after the offer")
    confirms: float = setting(0.0, PROBABILITY, "says yes to what it has told")
    changes_mind: float = setting(0.0, PROBABILITY, "replaces a constraint")
    withholds: float = setting(0.0, PROBABILITY, "denies without the right value")
    explains: float = setting(0.0, PROBABILITY, "tells the right values when it denies an offer")
    slot_error_prob: Mapping[str, float] = setting({}, _RATES, "errors by slot")

    def __post_init__(self) -> None:
        check_values(self)


_PERSON = Profile(
    patience=(12, 20),
    bears=(2, 4),
    insists=0.8,
    asks_late=0.5,
    confirms=0.5,
    changes_mind=0.1,
    withholds=0.2,
    explains=0.7,
)
_PEOPLE = (
    replace(_PERSON, share=0.35, tells=(1, 1)),  # one thing at a time
    replace(_PERSON, share=0.4, tells=(1, 3)),
    replace(_PERSON, share=0.25, tells=(4, 8), patience=(8, 16)),  # all at once
)
MIXES: dict[str, tuple[Profile, ...]] = {
    "paper": (),
    "people": _PEOPLE,
    "mixed": (Profile(0.5), *(replace(kind, share=kind.share / 2) for kind in _PEOPLE)),
}
"""The mixes by name; without a profile every user is the paper's."""

Users = str | Mapping[str, Any] | Sequence[Mapping[str, Any] | Profile]
"""The name of a mix, or the keys of its profiles."""


def profiles_of(users: Users) -> tuple[Profile, ...]:
    """Returns the profiles of a mix; empty if every user is the paper's.

    Args:
        users: the name of a mix, the keys of one profile, or a list of profiles.

    Raises:
        ValueError: one sentence about the first key, value or share that is not allowed.

    Examples:
        >>> profiles_of({"patience": [3, 8]})
        (Profile(share=1.0, patience=[3, 8], ...),)
        >>> profiles_of([{"share": 0.5, "insists": 1}])
        Traceback (most recent call last):
        ...
        ValueError: users must have shares that add up to 1, got 0.5
    """
    check("users", users, USERS)
    if isinstance(users, str):
        return MIXES[users]
    kinds = [users] if isinstance(users, Mapping) else users
    made = tuple(
        kind
        if isinstance(kind, Profile)
        else filled(Profile, check(f"users[{number}]", kind, _KEYS), f"users[{number}].")
        for number, kind in enumerate(kinds)
    )
    total = sum(kind.share for kind in made)
    if made and not math.isclose(total, 1.0, abs_tol=0.005):  # three of .333
        raise ValueError(f"users must have shares that add up to 1, got {total:g}")
    is_plain = all(kind == Profile(kind.share) for kind in made)
    return () if is_plain else made


class Mix(Movable):
    """A mix of profiles as tables, from which dialogues draw the traits of their users.

    Args:
        domain: the domain's tensors, on the CPU.
        profiles: at least one.

    Attributes:
        slot_draws: names of the uniform numbers ``[*B, S]`` that :meth:`traits` needs.
        draws: names of the uniform numbers ``[*B]`` that it needs.
        has_rates: whether any profile has error rates by slot.

    Raises:
        ValueError: if a profile has an error rate of a slot that the domain lacks.
    """

    slot_draws = ("order", "other")
    draws = ("profile", "patience", "bears", "tells", "changes_at", *HABITS)

    def __init__(self, domain: DomainTensors, profiles: Sequence[Profile]) -> None:
        allowed = one_of(*domain.slot)
        for number, kind in enumerate(profiles):
            for slot in kind.slot_error_prob:
                check(f"a slot of users[{number}].slot_error_prob", slot, allowed)
        shares = torch.tensor([float(kind.share) for kind in profiles])
        self._below = shares.cumsum(0)[:-1]
        # A user without a limit stays longer than any dialogue, and tells 0 means the paper's rule.
        self._patience = torch.tensor([kind.patience or (10**6, 10**6) for kind in profiles])
        self._bears = torch.tensor([kind.bears or (10**6, 10**6) for kind in profiles])
        self._tells = torch.tensor([kind.tells or (0, 0) for kind in profiles])
        self._habits = torch.tensor(
            [[float(getattr(kind, habit)) for habit in HABITS] for kind in profiles]
        )
        rates = [kind.slot_error_prob for kind in profiles]
        self.has_rates = any(rates)
        self._rates = torch.tensor([[by.get(slot, -1.0) for slot in domain.slot] for by in rates])
        changes = any(kind.changes_mind for kind in profiles)
        self._first, self._count, self._values = _alternatives(domain, changes)

    def traits(self, draws: TensorDictBase, goal: Tensor, active: Tensor) -> TensorDict:
        """Returns the traits of dialogues' users, ``[*B]``.

        ==============  =====  ========  ===========================================================
        key             dtype  shape     meaning
        ==============  =====  ========  ===========================================================
        ``limit``       long   ``*B``    acts of both sides after which the user leaves
        ``bears``       long   ``*B``    times that the agent may still ignore a question
        ``tells``       long   ``*B``    constraints told in a turn; 0: as in the paper
        ``order``       long   ``*B, S``  rank of each slot; the user prefers higher ones
        ``other``       long   ``*B, S``  the value that would replace a constraint; 0: none
        ``changes_at``  long   ``*B``    acts after which it changes its mind
        ``error_prob``  float  ``*B, S``  probability of an error; negative: the channel's
        ==============  =====  ========  ===========================================================

        ``insists``, ``asks_late``, ``confirms``, ``withholds`` and ``explains`` are bool ``*B``.

        Args:
            draws: the uniform numbers named by :attr:`slot_draws` and :attr:`draws`.
            goal: long ``[*B]``, indices of the goals.
            active: bool ``[S]``, the slots of the goals.
        """
        profile = (draws["profile"][..., None] >= self._below).sum(-1)
        habits = rows(self._habits, profile).unbind(-1)
        has = {name: draws[name] < prob for name, prob in zip(HABITS, habits, strict=True)}
        count = rows(self._count, goal)
        place = rows(self._first, goal) + index_below(draws["other"], count)
        other = self._values.take(place.clamp(max=self._values.numel() - 1))
        may_change = (count > 0) & active & has.pop("changes_mind")[..., None]
        first, last = CHANGES_AT
        return TensorDict(
            {
                "limit": 2 * _within(rows(self._patience, profile), draws["patience"]),
                "bears": _within(rows(self._bears, profile), draws["bears"]),
                "tells": _within(rows(self._tells, profile), draws["tells"]),
                "order": draws["order"].argsort(stable=True, dim=-1).argsort(-1),
                "other": torch.where(may_change, other, NONE),
                "changes_at": 2 * (first + index_below(draws["changes_at"], last - first + 1)),
                "error_prob": rows(self._rates, profile),
                **has,
            },
            batch_size=goal.shape,
            device=goal.device,
        )


def _within(bounds: Tensor, uniform: Tensor) -> Tensor:
    """Returns integers from least to most, long ``[*B]``, for bounds ``[*B, 2]``."""
    least, most = bounds.unbind(-1)
    return least + index_below(uniform, most - least + 1)


def _alternatives(domain: DomainTensors, changes: bool) -> tuple[Tensor, Tensor, Tensor]:
    """Returns the values that could replace each constraint of each goal.

    With each of them a record meets all constraints and has values for all requests. A free slot
    gets its values in other goals.

    Returns:
        The position of the first value and the number of values, each long ``[G, S]``, and the
        values, long ``[n]``.
    """
    goals, records = domain.goal_constraints, domain.records
    first, count = torch.zeros_like(goals), torch.zeros_like(goals)
    found = [torch.zeros(1, dtype=torch.long)]
    total = 1
    for number, goal in enumerate(goals if changes else ()):
        asked = domain.goal_requests[number].clone()
        asked[domain.ticket] = False
        misses = domain.constrains & (goal > DONT_CARE) & (records != goal)
        fits = (records[:, asked] != NONE).all(-1)
        for slot in (goal != NONE).nonzero().flatten().tolist():
            others = misses.clone()
            others[:, slot] = False
            meets = fits & ~others.any(-1)
            pool = records[meets, slot]
            if not domain.constrains[slot]:
                pool = goals[:, slot] if bool(meets.any()) else pool[:0]
            values = pool.unique()
            values = values[(values > DONT_CARE) & (values != goal[slot])]
            first[number, slot], count[number, slot] = total, values.numel()
            total += values.numel()
            found.append(values)
    return first, count, torch.cat(found)
