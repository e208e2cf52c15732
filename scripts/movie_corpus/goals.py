"""Makes the goals of the movie corpus: most from a record, a few that no record meets."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bbq_torchrl.domains import Goal

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from scripts.movie_corpus.dice import Dice
    from scripts.movie_corpus.records import Record

# Requests besides the ticket, and the number of goals with exactly these. Of moviename, theater,
# starttime and date each goal constrains those that it does not request.
REQUESTS = {
    (): 62,
    ("theater",): 11,
    ("starttime",): 4,
    ("date",): 3,
    ("moviename",): 2,
    ("theater", "starttime"): 18,
    ("theater", "date"): 6,
    ("theater", "moviename"): 5,
    ("date", "moviename"): 2,
    ("theater", "starttime", "date"): 29,
    ("theater", "starttime", "moviename"): 21,
    ("theater", "date", "moviename"): 6,
    ("starttime", "date", "moviename"): 1,
    ("theater", "starttime", "date", "moviename"): 30,
}
CORE = ("moviename", "theater", "starttime", "date")

# How many goals constrain the slot besides: those that request nothing, and the others.
EXTRAS_OF_COMPLETE = {"city": 61, "state": 7, "distanceconstraints": 1}
EXTRAS_OF_OPEN = {
    "city": 63,
    "state": 27,
    "genre": 22,
    "other": 21,
    "distanceconstraints": 17,
    "critic_rating": 7,
    "zip": 7,
    "mpaa_rating": 4,
    "video_format": 3,
    "theater_chain": 2,
}
UNMET_COMPLETE = 3  # goals without requests that no record meets
UNMET_OPEN = 9  # goals with requests that no record meets
UNANSWERABLE = 20  # goals whose requests no record that meets them can answer


class GoalWriter:
    """Makes goals that the records meet, and a few that they do not."""

    def __init__(
        self,
        facts: Mapping[str, Any],
        dice: Dice,
        sessions: list[list[Record]],
        values: Mapping[str, Sequence[str]],
    ) -> None:
        self.facts = facts
        self.dice = dice
        self.sessions = sessions
        self.values = values
        self.records = [record for records in sessions for record in records]

    def _matching(self, constraints: Mapping[str, str]) -> list[Record]:
        wanted = {(s, v.casefold()) for s, v in constraints.items() if s != "numberofpeople"}
        return [r for r in self.records if wanted <= {(s, v.casefold()) for s, v in r.items()}]

    def _answerable(self, constraints: Mapping[str, str], requests: Sequence[str]) -> bool:
        return any(set(requests) <= set(record) for record in self._matching(constraints))

    def _constraints(self, record: Record, slots: Sequence[str]) -> dict[str, str]:
        people = self.dice.pick_early(self.facts["people"], 0.9)
        return {"numberofpeople": people} | {slot: record[slot] for slot in slots}

    def _candidates(self, slots: Sequence[str]) -> list[Record]:
        """Returns a record of each session that has all the slots, in a random order."""
        held = [[r for r in records if set(slots) <= set(r)] for records in self.sessions]
        return self.dice.shuffle([self.dice.pick(records) for records in held if records])

    def met(self, slots: Sequence[str], requests: Sequence[str]) -> Goal:
        """Returns a goal that one record meets and answers."""
        record = self._candidates([*slots, *requests])[0]
        return Goal(self._constraints(record, slots), tuple(requests))

    def unanswerable(self, slots: Sequence[str], requests: Sequence[str]) -> Goal | None:
        """Returns a goal that records meet, but that none of them answers completely."""
        for record in self._candidates(slots):
            constraints = self._constraints(record, slots)
            if not self._answerable(constraints, requests):
                return Goal(constraints, tuple(requests))
        return None

    def unmet(self, slots: Sequence[str], requests: Sequence[str]) -> Goal:
        """Returns a goal that no record meets because of one value."""
        constraints = self._constraints(self._candidates(slots)[0], slots)
        while self._matching(constraints):
            slot = self.dice.pick([slot for slot in slots if slot in self.values])
            constraints[slot] = self.dice.pick(self.values[slot])
        return Goal(constraints, tuple(requests))

    def _deal_extras(
        self, patterns: Sequence[tuple[str, ...]], extras: Mapping[str, int]
    ) -> list[set[str]]:
        """Returns each goal's further constraints, distributed as evenly as possible."""
        dealt: list[set[str]] = [set() for _ in patterns]
        tokens = self.dice.shuffle([slot for slot, count in extras.items() for _ in range(count)])
        for token in tokens:
            lacking = self.dice.shuffle([goal for goal in dealt if token not in goal])
            min(lacking, key=len).add(token)
        return dealt

    def goals(self) -> list[Goal]:
        """Returns all goals, in a random order."""
        complete: list[tuple[str, ...]] = [()] * REQUESTS[()]
        opened = self.dice.shuffle([p for p, count in REQUESTS.items() if p for _ in range(count)])
        goals = []
        for patterns, extras, unmet in (
            (complete, EXTRAS_OF_COMPLETE, UNMET_COMPLETE),
            (opened, EXTRAS_OF_OPEN, UNMET_OPEN),
        ):
            unanswerable = UNANSWERABLE if patterns is opened else 0
            for index, (requests, more) in enumerate(
                zip(patterns, self._deal_extras(patterns, extras), strict=True)
            ):
                slots = [slot for slot in CORE if slot not in requests] + sorted(more)
                goal = None
                if index < unmet:
                    goal = self.unmet(slots, requests)
                elif unanswerable:
                    goal = self.unanswerable(slots, requests)
                    unanswerable -= goal is not None
                goals.append(goal or self.met(slots, requests))
        return self._with_oddities(self.dice.shuffle(goals))

    def _with_oddities(self, goals: list[Goal]) -> list[Goal]:
        """Lets a user who cannot be answered ask for the price, and two describe a film in words.

        No record has a description, as in the public corpus: nothing can meet those two.
        """
        answerable = [self._answerable(g.constraints, g.requests) for g in goals]
        matched = [bool(self._matching(g.constraints)) for g in goals]
        price = next(i for i, ok in enumerate(answerable) if matched[i] and not ok)
        goals[price] = Goal(goals[price].constraints, (*goals[price].requests, "price"))
        for index in [i for i, found in enumerate(matched) if not found and goals[i].requests][:2]:
            described = {"description": self.dice.pick(self.facts["descriptions"])}
            goals[index] = Goal({**goals[index].constraints, **described}, goals[index].requests)
        return goals
