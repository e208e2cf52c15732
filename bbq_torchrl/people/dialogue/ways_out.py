"""Proposals where no record has all wishes, or where a person asks for others."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import torch

from bbq_torchrl.domains.values import FIRST_VALUE, NONE
from bbq_torchrl.people.dialogue import moves
from bbq_torchrl.people.dialogue.exchange import Answer
from bbq_torchrl.people.dialogue.tracking import full
from bbq_torchrl.people.language import Frame
from bbq_torchrl.people.language.asking import Asking

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bbq_torchrl.people.dialogue.exchange import Memory
    from bbq_torchrl.people.dialogue.records import Records
    from bbq_torchrl.people.dialogue.spelling import Spelling
    from bbq_torchrl.people.dialogue.tracking import Tracking
    from bbq_torchrl.people.language import EndpointGenerator, Generator, Understood

_MAX_CHOICES, _MAX_NAMED = 5, 4
_MAX_PROPOSALS = 2
"""The number of refused proposals, or of times that one is made, before the agent asks what may
change."""


class WaysOut:
    """Proposes records near to the wishes.

    A proposal names what differs from the wishes and where and when the record is. Who takes it
    wishes all of that.

    Args:
        spelling: the spelling of values.
        tracking: the agent's knowledge.
        records: the domain's records.
        nlg: the nlg.
        place: bool ``[S]``, the slots that say where and when a record is.
    """

    def __init__(
        self,
        spelling: Spelling,
        tracking: Tracking,
        records: Records,
        nlg: Generator | EndpointGenerator,
        place: torch.Tensor,
    ) -> None:
        self._lexicon, self._slots = spelling.lexicon, spelling.domain.slots
        self._tracking, self._records, self._nlg = tracking, records, nlg
        self._place, self._opening = place, spelling.domain.opening_slots

    def others(
        self,
        now: Memory,
        reading: Understood,
        text: str,
        question: Frame | None,
        words: dict[str, Any],
    ) -> Answer | None:
        """Returns the alternatives that a text asks for; ``None`` if it is about something else.

        Args:
            now: the memory, with the state after the person's act.
            reading: the meaning of the text.
            text: the person's text.
            question: the agent's act that it answers.
            words: what determines the words.
        """
        assert now.state is not None
        asked, way = moves.others(text), moves.direction(text)
        wanted, *other = moves.besides(asked)
        told, lexicon = {**self._tracking.kept(now.state), **now.proposal}, self._lexicon
        stays = moves.named_slots(moves.same(wanted), lexicon)
        slots = [slot for slot in moves.named_slots(wanted, lexicon) if slot not in stays]
        slots = slots or moves.named_values(" ".join(other), told, lexicon)
        stays += moves.named_values(wanted, told, lexicon)
        # Another of a chain is another theater, whose name begins with the chain's.
        begins = tuple(f"{told.get(slot)} " for slot in stays)
        slots = slots or [slot for slot, name in told.items() if name.startswith(begins)]
        if not slots and way:
            slots = [slot for slot in lexicon.slots if lexicon.kinds[slot] == "time"]
        slots = slots or [*self._opening][: len(stays)]
        if not slots and question is not None and question.requests and not now.proposal:
            slots = [question.requests[0]]
        numbers = [self._slots.index(slot) for slot in slots]
        number = next((one for one in numbers if self._records.is_listed(one)), None)
        held = full(now.state)
        if now.proposal and (way or stays):  # later than what is proposed
            proposed = torch.tensor(self._tracking.ids(now.proposal))
            held = torch.where(proposed != NONE, proposed, held)
        if number is None:
            is_stuck = bool(self._records.best(held)[2])
            if not (now.proposal or is_stuck or now.is_offered):
                return None
            return self.alternative(now, reading, words)
        fixed = [n for n in map(self._slots.index, stays) if n != number and held[n] >= FIRST_VALUE]
        found = self._records.choices(held, number, way)
        if len(found) < 2 and not way and "wished" in now.state:  # leave out what the agent chose
            wished = torch.where(now.state["wished"] > 0, held, NONE)
            wished[[number, *fixed]] = held[[number, *fixed]]
            found = self._records.choices(wished, number) or found
        if len(found) < 2:
            refused = self.refused(now)
            change = {number: found[0]} if found else {}
            nearest, is_met = self._records.nearest, not self._records.best(held)[2]
            change = change or nearest(held, refused, slot=number, direction=way, is_here=True)
            if (self._records.row(held, change) != held)[fixed].any():
                change = {}
            if is_met and not change:
                use = {1: "nothing_later", -1: "nothing_earlier"}.get(way, "no_other")
                here = torch.where(self._place, self._records.here(held), NONE)
                here[fixed] = held[fixed]
                place = self._tracking.values(here)
                sentence = self._nlg.say(use, [self._slots[number]], values=place, **words)
                if now.proposal or now.is_offered:
                    sentence += f" {self._nlg.say('stands', **words)}"
                now = replace(now, asking=Asking())
                return Answer(sentence, reading, reading.frame, Frame("not_sure"), now)
            change = change or nearest(held, refused, slot=number, direction=way)
            change = change or nearest(held, refused, asked=[number])
            return self.propose(now, reading, change, words)
        slot = self._slots[number]
        values = [self._records.vocabulary[number][value] for value in found[:_MAX_CHOICES]]
        sentence = self._nlg.say("several", [slot], choices=values, **words)
        asking = Asking(slot=slot, choices=tuple(values))
        answered = Frame("multiple_choice", {}, (slot,), asking.choices)
        now = replace(now, asking=asking, proposal={})
        return Answer(sentence, reading, reading.frame, answered, now)

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
        asked = [self._slots.index(slot) for slot in requests]
        change = self._records.nearest(full(now.state), self.refused(now), asked=asked)
        return self.propose(now, reading, change, words, asked)

    def narrowed(self, reading: Understood, held: Mapping[str, str]) -> Understood:
        """Returns a reading whose unclear names mean only what is left with the other values.

        Args:
            reading: the meaning of the text.
            held: the values told before.
        """
        informs, unclear = {**reading.frame.informs}, []
        wishes = torch.tensor(self._tracking.ids({**held, **informs}))
        for one in reading.unclear:
            number = self._slots.index(one.slot)
            names = self._records.vocabulary[number]
            left: tuple[str, ...] = ()
            for known in (wishes.clone(), self._records.here(wishes)):
                known[number] = NONE
                fit = {names[value] for value in self._records.choices(known, number)}
                left = left or tuple(value for value in one.candidates if value in fit)
            if self._lexicon.kinds[one.slot] == "time":  # the nearest time, if none fits
                left = left or one.candidates[:1]
            if len(left) == 1:
                informs[one.slot] = left[0]
            else:
                unclear.append(replace(one, candidates=left))
        frame = replace(reading.frame, informs=informs)
        return replace(reading, frame=frame, unclear=tuple(unclear))

    def refused(self, now: Memory) -> list[list[tuple[int, int]]]:
        """Returns the refused proposals as pairs of slot and value id."""
        refused = (self._pairs(one) for one in now.refused)
        return [pairs for pairs in refused if pairs]

    def nearest(self, memory: Memory) -> dict[str, str]:
        """Returns the record that is proposed or offered, or else nearest to the wishes, if any."""
        if memory.state is None:
            return {}
        change, refused = dict(self._pairs(memory.proposal)), self.refused(memory)
        return self._tracking.values(self._records.row(full(memory.state), change, refused))

    def refuse(self, now: Memory) -> Memory:
        """Returns the memory after the offered record is refused."""
        offer = torch.tensor(self._tracking.ids(self.nearest(now)))
        return replace(now, refused=(*now.refused, self._tracking.values(self._place * offer)))

    def propose(
        self,
        now: Memory,
        reading: Understood,
        change: Mapping[int, int],
        words: dict[str, Any],
        asked: Sequence[int] = (),
    ) -> Answer:
        """Returns the proposal of a record, or the question what may change.

        The second time in a row it names the whole record, and then asks what may change.

        Args:
            now: the memory, with the state after the person's act.
            reading: the meaning of the text.
            change: the value id proposed for each slot that changes; may be empty.
            words: what determines the words.
            asked: the slots asked for; the proposal tells their values.
        """
        assert now.state is not None
        held, records = full(now.state), self._records
        now = replace(now, asking=Asking())
        row = records.row(held, change, self.refused(now))
        ids = torch.where(self._place & (row != held), row, 0)
        ids[[*change, *asked]] = row[[*change, *asked]]
        proposal = self._tracking.values(ids)
        conflict = {self._slots[n]: records.vocabulary[n][held[n]] for n in records.conflict(held)}
        times = now.times + 1
        if not change or times > _MAX_PROPOSALS:
            told = self._tracking.values(torch.where(held >= FIRST_VALUE, held, self._place * row))
            names = [*conflict] or [*told][:_MAX_NAMED]
            sentence = self._nlg.say("nothing", names, **words)
            now = replace(now, proposal={}, times=0)
            return Answer(sentence, reading, reading.frame, Frame("not_sure"), now)
        is_near = not conflict or records.is_same_day(held, change)
        use, named = "another" if is_near else "way_out", proposal
        if proposal == now.proposal:
            use, named = "whole", self._tracking.values(torch.where(self._place, row, ids))
        sentence = self._nlg.say(use, values=conflict, other=named, **words)
        now = replace(now, proposal=proposal, times=times)
        return Answer(sentence, reading, reading.frame, Frame("not_sure", proposal), now)

    def _pairs(self, values: Mapping[str, str]) -> list[tuple[int, int]]:
        """Returns the values that the domain has as pairs of slot and value id."""
        return [(slot, value) for slot, value in enumerate(self._tracking.ids(values)) if value]
