"""People's goals, and the judge of whether a conversation met its goal.

A simulated user knows its questions and their answers. For a person, only the goal card and the
dialogue acts are known.
"""

from __future__ import annotations

import random
from collections import Counter, defaultdict
from typing import TYPE_CHECKING, Any

from bbq_torchrl.domains.values import AVAILABLE, DONT_CARE, NO_MATCH, RESERVED_TEXT, fold

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from bbq_torchrl.domains import Domain, Goal
    from bbq_torchrl.domains.frames import Frame

_NO_MATCH = fold(RESERVED_TEXT[NO_MATCH])
_AVAILABLE = fold(RESERVED_TEXT[AVAILABLE])
_DONT_CARE = fold(RESERVED_TEXT[DONT_CARE])


def card(goal: Goal, labels: Mapping[str, str]) -> dict[str, Any]:
    """Returns the content of a goal card.

    Args:
        goal: the person's goal.
        labels: people's names for the slots.

    Returns:
        ``wishes``, pairs of label and value, and ``questions``, labels.
    """
    return {
        "wishes": [
            (labels.get(slot, slot), "anything" if fold(value) == _DONT_CARE else value)
            for slot, value in goal.constraints.items()
        ],
        "questions": [labels.get(slot, slot) for slot in goal.requests],
    }


class Judge:
    """Judges conversations in a domain.

    A conversation is a success if

    1. the last offer of a booking has every wish of the goal card, or all records that it may book
       have it; a time has a vague one that it is in, as "after 6 pm",
    2. that offer says that there is a ticket,
    3. every question of the card was answered at some time, by itself or in an offer, and one
       record of the knowledge base has all wishes and, for every question, one of the answers,
    4. it ended before it ran out of turns.

    The simulator also requires that no slot remains without a match: either side must give each
    such slot another value afterwards, and a refused offer counts until the agent informs the
    ticket itself. A person who got everything on the card does not fail because of it; for other
    conversations it is one more reason. With ``as_simulated`` it is a condition, only the words of
    the offer and each question's last answer count, and in dialogues without errors that the agent
    ends, the rule is the simulator's.

    Args:
        domain: the domain of the conversations.
        as_simulated: whether to judge as the simulator does.
    """

    def __init__(self, domain: Domain, *, as_simulated: bool = False) -> None:
        self._as_simulated = as_simulated
        self._ticket, self._complete = domain.ticket_slot, domain.complete_slot
        self._free = frozenset((*domain.free_slots, *domain.special_slots))
        self._records, self._all = domain.records, frozenset(range(len(domain.records)))
        self._rows: dict[tuple[str, str], set[int]] = defaultdict(set)
        self._has: dict[str, set[int]] = defaultdict(set)
        self._known: dict[tuple[str, str], set[int]] = {}
        for row, record in enumerate(domain.records):
            for slot, value in record.items():
                self._rows[slot, fold(value)].add(row)
                self._has[slot].add(row)

    def is_attainable(self, goal: Goal) -> bool:
        """Returns whether some record has all wishes and all requested slots."""
        has_all = (self._has.get(slot, ()) for slot in goal.requests)
        return bool(self._matching(goal.constraints).intersection(*has_all))

    def reasons(
        self, goal: Goal, exchanges: Iterable[tuple[Frame, Frame]], *, in_time: bool = True
    ) -> tuple[str, ...]:
        """Returns the reasons why a conversation was not a success; empty for a success.

        Args:
            goal: the person's goal card.
            exchanges: the person's act as understood and the agent's act, first to last.
            in_time: whether it ended before it ran out of turns.
        """
        offer: dict[str, str] = {}
        answers: dict[str, set[str]] = defaultdict(set)
        latest: dict[str, str] = {}
        listed: dict[str, set[str]] = {}
        for understood, answered in exchanges:
            told = _folded(understood.informs)
            latest |= told
            for slot in () if self._as_simulated else told.keys() & listed.keys():
                answers[slot] |= {told[slot]} & listed[slot]  # who picks one of a list knows it
            listed = {slot: {*map(fold, answered.choices)} for slot in answered.requests}
            informed = _folded(answered.informs)
            is_offer = self._complete in informed
            if is_offer:
                offer = informed
                if informed[self._complete] == _NO_MATCH:
                    latest[self._ticket] = _NO_MATCH
            elif answered.act in ("inform", "request"):  # or answers, followed by a question
                latest |= informed
            else:
                continue
            for slot, value in informed.items():
                if not self._as_simulated:
                    answers[slot].add(value)
                elif not is_offer:
                    answers[slot] = {value}
        wishes = _folded(goal.constraints)
        right = self._matching(wishes)
        for slot in goal.requests:
            right = right & self._having(slot, answers[slot])
        faults = {
            "no offer": not offer,
            "wishes": bool(offer) and not self._has_wishes(offer, answers, wishes),
            "no ticket": bool(offer) and offer[self._complete] != _AVAILABLE,
            "questions": not right,
        }
        is_strict = self._as_simulated or any(faults.values())
        faults["no match left"] = is_strict and _NO_MATCH in latest.values()
        faults["out of turns"] = not in_time
        return tuple(reason for reason, holds in faults.items() if holds)

    def _matching(self, values: Mapping[str, str]) -> frozenset[int]:
        """Returns the records that have all values; free slots and "do not care" match any."""
        wanted = (
            self._having(slot, [value])
            for slot, value in _folded(values).items()
            if slot not in self._free and value != _DONT_CARE
        )
        return self._all.intersection(*wanted)

    def _having(self, slot: str, values: Iterable[str]) -> set[int]:
        """Returns the records that have one of the values, or a time or a day in it.

        Today at 8 pm is tonight.
        """
        found: set[int] = set()
        for value in values:
            if (slot, value) not in self._known:
                self._known[slot, value] = self._find(slot, value)
            found |= self._known[slot, value]
        return found

    def _find(self, slot: str, value: str) -> set[int]:
        """Returns the records that have a value, or a time or a day in it."""
        # Imported here: the language loads torch, which a study's report needs not.
        from bbq_torchrl.people.language.quantities import (
            day_of,
            is_at,
            is_on,
            minutes_of,
            of_evening,
            read_date,
            span_of,
        )

        found = set(self._rows.get((slot, value), ()))
        span, is_day = span_of(value), read_date(value) is not None
        is_vague = not self._as_simulated and (span is not None or is_day)
        for (own, other), rows in self._rows.items() if is_vague else ():
            if own != slot:
                continue
            if span is not None and span[0] <= of_evening(minutes_of(other)) <= span[1]:
                found |= rows
            if is_day and is_on(other, value):
                found |= rows
            elif is_day and day_of(other) == day_of(value):
                found |= {row for row in rows if is_at(value, self._records[row].values())}
        return found

    def _has_wishes(
        self,
        offer: Mapping[str, str],
        answers: Mapping[str, set[str]],
        wishes: Mapping[str, str],
    ) -> bool:
        """Returns whether an offer says each wish, or all records that it may book have it.

        One is enough if the agent said so: "It has a senior discount." It may book those with the
        most of its values: what is not on file is in no record.
        """
        offered = {} if self._as_simulated else offer
        counts = Counter(
            row for slot, told in offered.items() for row in self._having(slot, [told])
        )
        most = max(counts.values(), default=0)
        booked = {row for row, count in counts.items() if count == most}

        def is_had(slot: str, value: str) -> bool:
            having = booked & self._having(slot, [value])
            is_said = value in (offer.get(slot), _DONT_CARE)
            return is_said or bool(having and (having == booked or value in answers.get(slot, ())))

        return all(is_had(slot, value) for slot, value in wishes.items())


def _folded(values: Mapping[str, str]) -> dict[str, str]:
    return {slot: fold(value) for slot, value in values.items()}


REASONS = {
    "no offer": "no booking was offered",
    "wishes": "the last offer did not hold all of your wishes",
    "no ticket": "the last offer was not available",
    "questions": "not every question was answered with what the booking has",
    "no match left": "something was said to be without a match, and left so",
    "out of turns": "it ran out of turns",
}
"""Each reason of the judge, as a clause."""


def choose_goal(domain: Domain, number: int | None, seed: int) -> Goal:
    """Returns a goal of the domain.

    Args:
        domain: the domain of the goal.
        number: the goal's number, from 1; ``None`` draws one that some record can meet.
        seed: the seed of the draw.

    Raises:
        ValueError: there is no such goal, or none that can be met.
    """
    goals = domain.goals
    if number is not None:
        if not 1 <= number <= len(goals):
            raise ValueError(f"--goal must be between 1 and {len(goals)}, got {number}")
        return goals[number - 1]
    judge = Judge(domain)
    attainable = [goal for goal in goals if judge.is_attainable(goal)]
    if not attainable:
        raise ValueError(f"no goal of the domain {domain.name} can be met: use --free")
    return random.Random(seed).choice(attainable)
