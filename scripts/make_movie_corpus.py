"""Writes the movie corpus that comes with the package: records, goals and values.

The corpus is ours. Its statistics are those of the public corpus that the reference setting is
calibrated on (how sparse the records are, what goals constrain and request, how many goals no
record meets); its content is made from the public facts in ``movie_facts.yaml``. A record is a
showing that somebody spoke of, so the records come in *sessions*: a few showings in one city, on
one day, of one film or two, with the same slots known. A session is also where a goal comes from.

Run ``python scripts/make_movie_corpus.py`` after a change; the same script and facts always give
the same bytes.
"""

from __future__ import annotations

import argparse
import math
import random
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import yaml

from bbq_torchrl.domains.domain import Goal
from bbq_torchrl.domains.folder import MOVIE_FOLDER, save_data

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

SEED = 2021
ROWS = 1000
SESSIONS = 220

# Share of the records that have the slot.
SHARES = {
    "moviename": 0.97,
    "theater": 0.93,
    "date": 0.92,
    "starttime": 0.91,
    "city": 0.89,
    "state": 0.62,
    "zip": 0.33,
    "other": 0.32,
    "genre": 0.30,
    "distanceconstraints": 0.24,
    "critic_rating": 0.16,
    "video_format": 0.15,
    "theater_chain": 0.10,
    "mpaa_rating": 0.07,
    "numberofkids": 0.04,
    "actor": 0.023,
    "price": 0.016,
    "actress": 0.01,
}

# A session's records share its slots, but each keeps those outside ALWAYS_KEPT with this
# probability only; a few records are thin: one to three slots are all that is known.
# How much more some sessions tell than others: 0 would deal the slots without regard to that.
KEEP = 0.75
TALK = 0.8
THIN = 0.03
MOST_SLOTS = 11
ALWAYS_KEPT = ("moviename", "theater", "date", "starttime", "city")

# What goals request besides the ticket, and how many goals request just that. Of moviename,
# theater, starttime and date each goal constrains those that it does not request.
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

Record = dict[str, str]
T = TypeVar("T")


class Dice:
    """Random choices that are the same in every version of Python.

    Of the standard generator only ``random()`` is promised never to change, so all is built on it.
    """

    def __init__(self, seed: int) -> None:
        self.uniform = random.Random(seed).random

    def chance(self, probability: float) -> bool:
        """Returns True with the probability given."""
        return self.uniform() < probability

    def pick(self, items: Sequence[T]) -> T:
        """Returns one of the items, all equally likely."""
        return items[int(self.uniform() * len(items))]

    def pick_early(self, items: Sequence[T], exponent: float = 1.0) -> T:
        """Returns one of the items, the i-th with a weight of ``i ** -exponent`` (Zipf's law)."""
        weights = [(index + 1) ** -exponent for index in range(len(items))]
        rest = self.uniform() * math.fsum(weights)
        for item, weight in zip(items, weights, strict=True):
            rest -= weight
            if rest < 0:
                return item
        return items[-1]

    def shuffle(self, items: Sequence[T]) -> list[T]:
        """Returns the items in a random order."""
        keyed = [(self.uniform(), index) for index in range(len(items))]
        return [items[index] for _, index in sorted(keyed)]

    def sample(self, items: Sequence[T], count: int) -> list[T]:
        """Returns up to ``count`` different items in a random order."""
        return self.shuffle(items)[:count]


@dataclass
class Session:
    """A few showings that were spoken of together."""

    size: int
    reticence: float
    slots: set[str] = field(default_factory=set)
    city: str = ""
    spelling: str = ""


class RecordWriter:
    """Makes the sessions and their records."""

    def __init__(self, facts: Mapping[str, Any], dice: Dice) -> None:
        self.facts = facts
        self.dice = dice
        self.starttimes = self._make_starttimes()
        self.theaters = self._make_theaters()
        self.films = dice.shuffle(list(facts["films"]))

    def _make_starttimes(self) -> list[str]:
        clock = [
            f"{hour}:{minute:02d}{space}{half}"
            for hour, half in [(h, "am") for h in (10, 11)] + [(12, "pm")]
            + [(h, "pm") for h in range(1, 12)]
            for minute in range(0, 60, 5)
            for space in ("", " ")
        ]  # fmt: skip
        vague = [f"{word} {hour}pm" for word in ("around", "after") for hour in range(1, 11)]
        vague += [f"before {hour}" for hour in range(5, 11)] + [
            f"{hour}pm" for hour in range(1, 11)
        ]
        words = list(self.facts["starttime_words"])
        return self.dice.shuffle(words + vague + self.dice.sample(clock, 287))

    def _make_theaters(self) -> dict[str, list[tuple[str, str]]]:
        """Returns city to theaters, each a name and its chain; no name is given twice."""
        theaters: dict[str, list[tuple[str, str]]] = {}
        for city in self.facts["cities"]:
            places = [city, *self.dice.sample(self.facts["places"], 3)]
            theaters[city] = []
            for place in places[: 4 if self.dice.chance(0.05) else 3]:
                chain = self.dice.pick_early(self.facts["chains"], 0.8)
                where = place if place == city else f"{city} {place}"
                screens = self.dice.pick([8, 10, 12, 14, 16, 18, 20])
                theaters[city].append((f"{chain} {where} {screens}", chain))
        return theaters

    def _deal_slots(self, sessions: list[Session]) -> None:
        """Gives each slot to sessions until its share of the records is reached.

        Records drop some of their session's slots again, so that more is dealt than is to stay.
        """
        for slot, share in SHARES.items():
            kept = (1 if slot in ALWAYS_KEPT else KEEP) * (1 - THIN * 0.7)
            missing = round(min(1.0, share / kept) * ROWS)
            order = self.dice.shuffle(sessions)
            if slot not in ALWAYS_KEPT:
                order.sort(key=lambda session: session.reticence + self.dice.uniform() / TALK)
            for session in order:
                if session.size <= missing:
                    session.slots.add(slot)
                    missing -= session.size

    def _deal_cities(self, sessions: list[Session]) -> None:
        """Gives each session a city and its spelling; all of them occur."""
        cities = self.facts["cities"]
        spellings = [(city, word) for city, entry in cities.items() for word in (city, *entry[2])]
        queues = {
            has_zip: self.dice.shuffle([s for s in spellings if bool(cities[s[0]][1]) == has_zip])
            for has_zip in (False, True)
        }
        for session in sessions:
            wants_zip = "zip" in session.slots
            usual = [s for s in spellings if cities[s[0]][1] or not wants_zip]
            queue = queues[wants_zip] or queues[True]
            new = "city" in session.slots and queue
            session.city, session.spelling = queue.pop() if new else self.dice.pick(usual)

    def _make_session(self, session: Session) -> list[Record]:
        dice, facts = self.dice, self.facts
        state, zip_code, _ = facts["cities"][session.city]
        distinct = max(min(2, session.size), 1 + dice.pick(range(session.size)))
        theaters = self._next_theaters(session.city, min(distinct, dice.pick([2, 3, 4])))
        films = [self.films.pop() if self.films else dice.pick_early(list(facts["films"]), 1.05)]
        films += [dice.pick_early(list(facts["films"]))] if dice.chance(0.25) else []
        times = [dice.pick_early(self.starttimes, 0.85) for _ in range(distinct)]
        wishes = dice.sample(facts["other_wishes"], 2)
        genre, rating = dice.chance(0.5), dice.pick([0, 1])
        common = {
            "city": session.spelling,
            "state": state if dice.chance(0.8) else facts["states"][state],
            "zip": zip_code,
            "date": dice.pick_early(facts["dates"], 0.9),
            "distanceconstraints": dice.pick_early(facts["distances"], 0.6),
            "video_format": dice.pick_early(facts["formats"], 0.6),
            "price": dice.pick(facts["prices"]),
            "numberofkids": dice.pick(facts["kids"]),
        }
        records = []
        for index in range(session.size):
            showing = index % distinct
            film = films[showing % len(films)]
            genres, mpaa, critics, actor, actress = facts["films"][film]
            theater, chain = theaters[showing % len(theaters)]
            known = common | {
                "moviename": film,
                "genre": genres[-1 if genre else 0],
                "mpaa_rating": facts["ratings"][mpaa][rating],
                "critic_rating": critics,
                "actor": actor,
                "actress": actress,
                "theater": theater,
                "theater_chain": chain,
                "starttime": times[showing],
                "other": dice.pick(wishes),
            }
            records.append({slot: known[slot] for slot in self._kept(session) if known[slot]})
        return records

    def _kept(self, session: Session) -> list[str]:
        """Returns the slots that one record of the session has, in their usual order."""
        dealt = [slot for slot in SHARES if slot in session.slots]
        kept = [s for s in dealt if s in ALWAYS_KEPT or self.dice.chance(KEEP)]
        if self.dice.chance(THIN):
            few = self.dice.sample(kept, self.dice.pick([1, 2, 3]))
            kept = [slot for slot in kept if slot in few]
        return kept[:MOST_SLOTS]

    def _next_theaters(self, city: str, count: int) -> list[tuple[str, str]]:
        """Returns theaters of the city in turn, so that none stays unnamed for long."""
        turn = self.theaters[city]
        self.theaters[city] = turn[count:] + turn[:count]
        return turn[:count]

    def sessions(self) -> list[list[Record]]:
        """Returns the records, session by session; ``ROWS`` in all."""
        sizes = [1 + int(self.dice.pick_early(range(12), 0.12)) for _ in range(SESSIONS)]
        while (difference := ROWS - sum(sizes)) != 0:
            index = self.dice.pick(range(SESSIONS))
            sizes[index] = max(1, sizes[index] + (1 if difference > 0 else -1))
        sessions = [Session(size, self.dice.uniform()) for size in sizes]
        self._deal_slots(sessions)
        self._deal_cities(sessions)
        return [self._make_session(session) for session in sessions]


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
        """Returns a record of each session that holds all the slots, in a random order."""
        held = [[r for r in records if set(slots) <= set(r)] for records in self.sessions]
        return self.dice.shuffle([self.dice.pick(records) for records in held if records])

    def met(self, slots: Sequence[str], requests: Sequence[str]) -> Goal:
        """Returns a goal that one record meets and answers."""
        record = self._candidates([*slots, *requests])[0]
        return Goal(self._constraints(record, slots), tuple(requests))

    def unanswerable(self, slots: Sequence[str], requests: Sequence[str]) -> Goal | None:
        """Returns a goal that records meet, none of which holds all that is requested."""
        for record in self._candidates(slots):
            constraints = self._constraints(record, slots)
            if not self._answerable(constraints, requests):
                return Goal(constraints, tuple(requests))
        return None

    def unmet(self, slots: Sequence[str], requests: Sequence[str]) -> Goal:
        """Returns a goal in which one value keeps every record from meeting it."""
        constraints = self._constraints(self._candidates(slots)[0], slots)
        while self._matching(constraints):
            slot = self.dice.pick([slot for slot in slots if slot in self.values])
            constraints[slot] = self.dice.pick(self.values[slot])
        return Goal(constraints, tuple(requests))

    def _deal_extras(
        self, patterns: Sequence[tuple[str, ...]], extras: Mapping[str, int]
    ) -> list[set[str]]:
        """Returns each goal's further constraints, dealt out as evenly as their number allows."""
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


def make_values(writer: RecordWriter) -> dict[str, list[str]]:
    """Returns slot to the values that people and machines may hear in its place."""
    facts = writer.facts
    films = facts["films"].values()
    cities = facts["cities"].items()
    states = facts["states"].items()
    values: dict[str, list[str]] = {
        "moviename": [*facts["films"], *facts["other_films"]],
        "theater": [name for theaters in writer.theaters.values() for name, _ in theaters],
        "date": facts["dates"],
        "starttime": writer.starttimes,
        "city": [word for city, entry in cities for word in (city, *entry[2])]
        + facts["other_cities"],
        "state": [word for state in states for word in state],
        "zip": [entry[1] for _, entry in cities if entry[1]],
        "other": facts["other_wishes"],
        "genre": [genre for film in films for genre in film[0]] + facts["other_genres"],
        "distanceconstraints": facts["distances"],
        "critic_rating": [film[2] for film in films] + facts["other_critics"],
        "video_format": facts["formats"] + facts["other_formats"],
        "theater_chain": facts["chains"],
        "mpaa_rating": [word for words in facts["ratings"].values() for word in words]
        + facts["other_ratings"],
        "numberofpeople": facts["people"],
        "numberofkids": facts["kids"],
        "actor": [film[3] for film in films if film[3]],
        "actress": [film[4] for film in films if film[4]],
        "price": facts["prices"],
        "description": facts["descriptions"],
    }
    return {slot: list(dict.fromkeys(words)) for slot, words in values.items()}


def main() -> None:
    """Writes the three data files of the movie domain."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--folder", type=Path, default=MOVIE_FOLDER, help="where the files go")
    write_corpus(parser.parse_args().folder)


def write_corpus(folder: Path) -> None:
    """Writes ``knowledge_base.csv``, ``goals.jsonl`` and ``values.json`` into ``folder``."""
    facts = yaml.safe_load(Path(__file__).with_name("movie_facts.yaml").read_text("utf-8"))
    dice = Dice(SEED)
    writer = RecordWriter(facts, dice)
    sessions = writer.sessions()
    values = make_values(writer)
    goals = GoalWriter(facts, dice, sessions, values).goals()
    records = [record for session in sessions for record in session]
    save_data(folder, list(SHARES), records, goals, values)


if __name__ == "__main__":
    main()
