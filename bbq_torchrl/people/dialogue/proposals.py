"""Proposals of records that are near to what a person wishes."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from math import isnan
from typing import TYPE_CHECKING, Any

import torch

from bbq_torchrl.domains.frames import ANY
from bbq_torchrl.domains.values import FIRST_VALUE, NONE
from bbq_torchrl.people.dialogue import moves
from bbq_torchrl.people.dialogue.exchange import Answer, values_of
from bbq_torchrl.people.dialogue.spelling import is_in
from bbq_torchrl.people.dialogue.tracking import full
from bbq_torchrl.people.language import Frame
from bbq_torchrl.people.language.asking import Asking
from bbq_torchrl.people.language.quantities import about_minutes, day_at, is_on, minutes_of

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator, Mapping, Sequence

    from tensordict import TensorDict

    from bbq_torchrl.people.dialogue.exchange import Memory
    from bbq_torchrl.people.dialogue.records import Records
    from bbq_torchrl.people.dialogue.spelling import Spelling
    from bbq_torchrl.people.dialogue.tracking import Tracking
    from bbq_torchrl.people.language import EndpointGenerator, Generator, Understood

MAX_NAMED = 4
"""The number of slots that a sentence names."""
_NEARLY = 10  # minutes
MAX_PROPOSALS = 2
"""The number of refused proposals, or of times that one is made, before the agent asks what may
change."""


class Proposals:
    """Proposes records near to the wishes.

    A proposal names where and when the record is, for how many, and what differs from the wishes.
    Who takes it wishes all of that.

    Args:
        spelling: the spelling of values.
        tracking: the agent's knowledge.
        records: the domain's records.
        nlg: the nlg.
        place: bool ``[S]``, the slots that say where and when a record is.

    Attributes:
        spelling: the spelling of values.
        tracking: the agent's knowledge.
        records: the domain's records.
        nlg: the nlg.
        place: bool ``[S]``, the slots that say where and when a record is.
        thing: the slot that a dialogue is about.
        holder: the slot with the most values, as the theater.
    """

    def __init__(
        self,
        spelling: Spelling,
        tracking: Tracking,
        records: Records,
        nlg: Generator | EndpointGenerator,
        place: torch.Tensor,
    ) -> None:
        self.spelling, self.tracking = spelling, tracking
        self.records, self.nlg, self.place = records, nlg, place
        domain, kinds = spelling.domain, spelling.lexicon.kinds
        self._slots = domain.slots
        self._free = torch.tensor([slot in domain.free_slots for slot in domain.slots])
        self._own = {*domain.essential} & {*domain.free_slots} - {*domain.special_slots}
        index, asked = domain.slots.index, {action.slot for action in domain.actions}
        names = [slot for slot in kinds if slot in asked and kinds[slot] == "text"]
        self.holder = max(names, key=lambda slot: len(records.vocabulary[index(slot)]))
        self.thing = next(iter(domain.opening_slots), self.holder)

    def lacking(self, now: Memory) -> list[int]:
        """Returns the slots that were asked for and are not on file."""
        return [self._slots.index(slot) for slot in now.lacking]

    def alternative(
        self,
        now: Memory,
        reading: Understood,
        words: dict[str, Any],
        requests: Sequence[str] = (),
        *,
        is_refused: bool = True,
    ) -> Answer:
        """Returns the nearest proposal, or after too many refused ones what may change.

        Args:
            now: the memory, with the state after the person's act.
            reading: the meaning of the text.
            words: what determines the words.
            requests: the slots asked for; the proposal tells their values.
            is_refused: whether the proposal that stands is refused.
        """
        assert now.state is not None
        if now.proposal and is_refused:
            now = replace(now, refused=(*now.refused, now.proposal), proposal={})
        asked = [self._slots.index(slot) for slot in requests] + self.lacking(now)
        change = self.records.nearest(full(now.state), self.refused(now), asked=asked)
        if not (change or is_refused):  # who tells other wishes may mean one refused before
            now = replace(now, refused=(), times=0)
            change = self.records.nearest(full(now.state), asked=asked)
        return self.propose(now, reading, change, words, asked)

    def shown(self, memory: Memory) -> dict[str, str]:
        """Returns where and when the record is that is proposed or offered, if any."""
        if not (memory.proposal or memory.is_offered):
            return {}
        record, named = self.nearest(memory), (self.place & ~self._free).tolist()
        return {
            s: record[s]
            for s, is_named in zip(self._slots, named, strict=True)
            if is_named and s in record
        }

    def earlier(self, memory: Memory, told: Mapping[str, str]) -> Mapping[str, str]:
        """Returns the latest of the other records shown that has these values, if any."""
        now, ids = self.shown(memory), self.tracking.ids
        others = [one for one in reversed(memory.shown) if one != now]
        rows = [self.records.row(torch.tensor(ids(one)), {}) for one in others]
        wholes = [
            {**self.tracking.values(row), **one} for row, one in zip(rows, others, strict=True)
        ]
        placed = {slot: value for slot, value in told.items() if any(slot in one for one in others)}
        for wanted in (told, placed) if placed else (told,):
            for one, whole in zip(others, wholes, strict=True):
                if self._fits(whole, wanted):
                    return one
        return {}

    def _fits(self, record: Mapping[str, str], told: Mapping[str, str]) -> bool:
        """Returns whether a record has values, or has them in its own: "the Regal"."""
        wholes, is_meant = self.spelling.wholes, self.spelling.is_meant
        named = ((s, value, record.get(wholes.get(s, s), "")) for s, value in told.items())
        return all(is_in(value, own) or is_meant(slot, value, own) for slot, value, own in named)

    def back(
        self, now: Memory, reading: Understood, record: Mapping[str, str], words: dict[str, Any]
    ) -> Answer:
        """Returns the proposal of a record that was shown before.

        Args:
            now: the memory, with the state after the person's act.
            reading: the meaning of the text.
            record: the record's values.
            words: what determines the words.
        """
        assert now.state is not None
        ids, held = torch.tensor(self.tracking.ids(record)), full(now.state)
        now = replace(now, times=0, refused=())
        held = torch.where(ids != NONE, ids, torch.where(self._free, held, NONE))
        change = {slot: value for slot, value in enumerate(ids.tolist()) if value != NONE}
        return self.propose(now, reading, change, words, held=held)

    def refused(self, now: Memory) -> list[list[tuple[int, int]]]:
        """Returns the refused proposals as pairs of slot and value id."""
        refused = (self._pairs(one) for one in now.refused)
        return [pairs for pairs in refused if pairs]

    def nearest(self, memory: Memory) -> dict[str, str]:
        """Returns the record that is proposed or offered, or else nearest to the wishes, if any.

        What is told that no record has, such as the number of people, is among its values.
        """
        if memory.state is None:
            return {}
        change, refused = dict(self._pairs(memory.proposal)), self.refused(memory)
        held = full(memory.state)
        row = self.records.row(held, change, refused)
        return self.tracking.values(torch.where(self._free & (held >= FIRST_VALUE), held, row))

    def is_complete(self, memory: Memory, told: Mapping[str, str]) -> bool:
        """Returns whether nothing is missing to book a proposal, such as for how many.

        Args:
            memory: the memory with the proposal.
            told: what the reply to it tells.
        """
        known = self.tracking.kept(memory.state)
        own = {slot: value for slot, value in told.items() if slot in self._own}
        is_same = all(known.get(slot, value) == value for slot, value in own.items())
        return is_same and self._own <= {*values_of(known), *own}

    def lasting(self, values: Mapping[str, str]) -> dict[str, str]:
        """Returns what some values are about and where, as the city of a zip code."""
        held = torch.tensor(self.tracking.ids(values))
        return self.tracking.values(self.records.here(held, self.records.lasting))

    def implied(self, values: Mapping[str, str]) -> dict[str, str]:
        """Returns values with those that they determine, as a theater its city."""
        ids = torch.tensor(self.tracking.ids(values))
        here = self.records.here(ids, torch.ones_like(ids, dtype=torch.bool))
        return {**self.tracking.values(here), **values}

    def otherwise(self, state: TensorDict, understood: Frame) -> Iterator[dict[str, str]]:
        """Yields what else an act may wish after which no record has all that is held, by slot.

        What is asked for is no wish ("what is on at the other one?"), and what is told takes back
        what is elsewhere, as a city the theater and a theater the city.

        Args:
            state: the state after the act.
            understood: the act.
        """
        kept, told = self.tracking.kept(state), values_of(understood)
        free = {slot: ANY for slot in understood.requests if slot in kept and slot not in told}
        yield free
        both = (self._pairs(told), self._pairs({s: kept[s] for s in kept.keys() - told.keys()}))
        is_tied = self.records.determines | self.records.determines.T
        yield free | {
            self._slots[one[0]]: ANY
            for other, one in product(*both)
            if is_tied[one[0], other[0]] and not self.records.with_any([[one, other]]).any()
        }

    def within(self, state: TensorDict) -> dict[str, str]:
        """Returns the time or day nearest to what is held, in it and of a record with all else."""
        held = full(state)
        for number in self.records.parts(held):
            names = self.records.vocabulary[number]
            wish, choices = names[held[number]], self.records.choices(held, number)
            middle = about_minutes(wish)
            found = [names[value] for value in choices]
            if not isnan(middle):
                found.sort(key=lambda one: abs(minutes_of(one) - middle))
            else:
                found = [day for day in found if is_on(day, wish)]
            if found:
                return {self._slots[number]: found[0]}
        return {}

    def refuse(self, now: Memory) -> Memory:
        """Returns the memory after the offered record is refused."""
        offer = torch.tensor(self.tracking.ids(self.nearest(now)))
        return replace(now, refused=(*now.refused, self.tracking.values(self.place * offer)))

    def propose(
        self,
        now: Memory,
        reading: Understood,
        change: Mapping[int, int],
        words: dict[str, Any],
        asked: Sequence[int] = (),
        held: torch.Tensor | None = None,
        lead: str = "",
    ) -> Answer:
        """Returns the proposal of a record, or the question what may change.

        After it was made twice in a row it asks what may change.

        Args:
            now: the memory, with the state after the person's act.
            reading: the meaning of the text.
            change: the value id proposed for each slot that changes; may be empty.
            words: what determines the words.
            asked: the slots asked for; the proposal tells their values.
            held: long ``[S]``, the values that the record should have; ``None`` for all held.
            lead: the sentence to begin with, as "There is nothing later".
        """
        assert now.state is not None
        state, records = now.state, self.records
        held = full(state) if held is None else held
        now = replace(now, asking=Asking())
        row = records.row(held, change, self.refused(now))
        ids = torch.where(self.place & (row != held), row, 0)
        ids[[*change, *asked]] = row[[*change, *asked]]
        proposal = self.tracking.values(ids)
        missed = [n for n in records.conflict(held) if not records.minor[n]]
        conflict = {self._slots[n]: records.vocabulary[n][held[n]] for n in missed}
        own = self.tracking.values(row)
        fit = self.spelling.on_day(conflict, own)
        if all(self.spelling.is_meant(s, v, own.get(s, "")) for s, v in fit.items()):
            conflict = {}  # but for a detail, which is told beside it
        kinds = self.spelling.lexicon.kinds
        hours = [(v, own.get(s, "")) for s, v in conflict.items() if kinds.get(s) == "time"]
        if any(abs(minutes_of(wish) - minutes_of(time)) <= _NEARLY for wish, time in hours):
            conflict = {}  # 2:25 is about half past two
        odd = self._odd(self.tracking.values(held), own)
        conflict |= odd
        asks = bool(values_of(reading.frame) or reading.frame.requests)
        times = 1 if asks and proposal != now.proposal else now.times + 1
        if not change or times > MAX_PROPOSALS:
            told = self.tracking.values(torch.where(held >= FIRST_VALUE, held, self.place * row))
            names = [*conflict] or [*told][:MAX_NAMED]
            sentence = self.nlg.say("nothing", names, **words)
            now, sentence = replace(now, proposal={}, times=0), f"{lead} {sentence}".strip()
            return Answer(sentence, reading, reading.frame, Frame("not_sure"), now)
        is_near = not conflict or (records.is_same_day(held, change) and not odd)
        use = "another" if is_near else "way_out"
        shown = self.tracking.values(torch.where(self.place, row, ids))
        known = values_of(self.tracking.kept(now.state))
        shown |= {slot: value for slot, value in known.items() if slot in self._own}
        sentence = self.nlg.say(use, values=conflict, other=shown, **words)
        wished = (state.get("wished", held) > 0) & records.lasting & (held >= FIRST_VALUE)
        if (
            not (lead or conflict) and (wished & (row != held)).any()
        ):  # all that is there is refused
            there = self.tracking.values(torch.where(wished, held, NONE))
            lead = self.nlg.say("no_other", [self.thing], values=there, **words)
        if not lead and (lost := self._lost(now, reading, held, row, conflict)):
            lead = self.nlg.say("no_promise", values=lost, **words)
        sentence = f"{lead} {sentence}".strip()
        now = replace(now, proposal=proposal, times=times)
        return Answer(sentence, reading, reading.frame, Frame("not_sure", proposal), now)

    def _odd(self, wishes: Mapping[str, str], record: Mapping[str, str]) -> dict[str, str]:
        """Returns the days wished in whose part a record's time is not: "tonight" at 10:05 am."""
        kinds = self.spelling.lexicon.kinds
        times = [value for slot, value in record.items() if kinds.get(slot) == "time"]
        days = {slot: value for slot, value in wishes.items() if kinds.get(slot) == "date"}
        return {s: v for s, v in days.items() if any(day_at(v, time) != v for time in times)}

    def _lost(
        self,
        now: Memory,
        reading: Understood,
        held: torch.Tensor,
        row: torch.Tensor,
        conflict: Collection[str],
    ) -> dict[str, str]:
        """Returns the details that a record does not have, unlike the last one, or wished now."""
        lost = self.records.minor & (held >= FIRST_VALUE) & (row != held)
        has = self.nearest(now) if now.proposal or now.is_offered else None
        names = " ".join(self.tracking.values(row).values())
        return {
            slot: value
            for slot, value in self.tracking.values(torch.where(lost, held, NONE)).items()
            if not (slot in conflict or value in names or moves.is_passing(value))
            if not has or has.get(slot) == value or slot in reading.frame.informs
        }

    def _pairs(self, values: Mapping[str, str]) -> list[tuple[int, int]]:
        """Returns the values that the domain has as pairs of slot and value id."""
        return [(slot, value) for slot, value in enumerate(self.tracking.ids(values)) if value]
