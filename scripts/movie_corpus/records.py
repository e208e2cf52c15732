"""Makes the records of the movie corpus, and the values that a slot may have besides.

A record is a showing that somebody spoke of, so the records come in *sessions*: a few showings in
one city, on one day, of one film or two, with much the same slots known.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Mapping

    from scripts.movie_corpus.dice import Dice

Record = dict[str, str]

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

# A session's records have its slots, but each record keeps those outside ALWAYS_KEPT only with
# probability KEEP.
ALWAYS_KEPT = ("moviename", "theater", "date", "starttime", "city")
KEEP = 0.75

# The variation of the number of slots between sessions; at 0 all sessions would have equally many.
TALK = 0.8

# Share of the records of which only one to three slots are known, and what share of their slots
# such records lose.
THIN = 0.03
THIN_LOSS = 0.7

MAX_SLOTS = 11


@dataclass
class Session:
    """A few showings that belong to one conversation.

    Args:
        size: number of records.
        reticence: from 0, tells much, to 1, tells little.
        slots: the slots that its records may have.
        city: the city as the facts name it.
        spelling: the city as it was said.
    """

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
        vague += [f"before {hour}" for hour in range(5, 11)]
        vague += [f"{hour}pm" for hour in range(1, 11)]
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
            kept = (1 if slot in ALWAYS_KEPT else KEEP) * (1 - THIN * THIN_LOSS)
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
        return kept[:MAX_SLOTS]

    def _next_theaters(self, city: str, count: int) -> list[tuple[str, str]]:
        """Returns theaters of the city in turn, so that all are used."""
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


def make_values(writer: RecordWriter) -> dict[str, list[str]]:
    """Returns, for each slot, the values that people and machines may hear instead."""
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
