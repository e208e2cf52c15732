"""Lists the values that there are, and proposes alternatives to what is spoken of."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import compress, pairwise
from typing import TYPE_CHECKING, Any

import torch

from bbq_torchrl.domains.frames import NO_MATCH_TEXT
from bbq_torchrl.domains.values import FIRST_VALUE, NONE
from bbq_torchrl.people.dialogue import moves
from bbq_torchrl.people.dialogue.exchange import Answer
from bbq_torchrl.people.dialogue.hearing import DOUBTFUL
from bbq_torchrl.people.dialogue.proposals import MAX_PROPOSALS
from bbq_torchrl.people.dialogue.spelling import is_in
from bbq_torchrl.people.dialogue.tracking import full
from bbq_torchrl.people.language import Frame
from bbq_torchrl.people.language.asking import Asking
from bbq_torchrl.people.language.generator import MAX_CHOICES
from bbq_torchrl.people.language.words import tokenize

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from bbq_torchrl.people.dialogue.exchange import Memory
    from bbq_torchrl.people.dialogue.proposals import Proposals
    from bbq_torchrl.people.language import Understood

_FEW = 20  # records: more are asked about


class WaysOut:
    """Lists what a person asks for, and proposes others than what is spoken of.

    Args:
        proposals: the proposals of records.
    """

    def __init__(self, proposals: Proposals) -> None:
        self._proposals, self._spelling = proposals, proposals.spelling
        self._lexicon, domain = self._spelling.lexicon, self._spelling.domain
        self._slots, self._tracking = domain.slots, proposals.tracking
        self._records, self._nlg, self._place = proposals.records, proposals.nlg, proposals.place
        self._thing, self._holder = proposals.thing, proposals.holder
        self._wider = self._records.determines[self._slots.index(self._holder)] & self._place
        self._parts = {
            slot: {part for name in self._lexicon.values(slot) for part in _parts(tokenize(name))}
            for slot in self._spelling.wholes.values()
        }
        kinds, is_listed = self._lexicon.kinds, self._records.is_listed
        index, asked = domain.slots.index, {action.slot for action in domain.actions}
        self._listed = {slot for slot in kinds if slot in asked and is_listed(index(slot))}

    def others(
        self,
        now: Memory,
        reading: Understood,
        text: str,
        question: Frame | None,
        words: dict[str, Any],
        news: Collection[str] = (),
    ) -> Answer | None:
        """Returns the alternatives that a text asks for; ``None`` if it is about something else.

        Args:
            now: the memory, with the state after the person's act.
            reading: the meaning of the text.
            text: the person's text.
            question: the agent's act that it answers.
            words: what determines the words.
            news: the slots whose values are told by the text.
        """
        assert now.state is not None
        informs = reading.frame.informs
        if question is not None and not informs.keys().isdisjoint(question.requests):
            question = Frame(question.act)  # it is answered
        left = question.choices[MAX_CHOICES:] if question is not None else ()
        if question is not None and left and moves.says(text, "rest"):
            return self._several(now, reading, question.requests[0], left, words)
        way = moves.direction(text)
        end = 0 if way else moves.direction(moves.others(text), "latest", "earliest")
        is_wish = now.state.get("wished", full(now.state)) > 0
        # Who wished that movie means "the only theater".
        only = self._holder if is_wish[self._slots.index(self._thing)] else self._thing
        slots, stays = self._meant(now, text, question, informs, only)
        records = self._records
        number = next((n for n in map(self._slots.index, slots) if records.is_listed(n)), None)
        held = self._widened(full(now.state), informs, slots)
        is_met = records.is_met(held)
        if number is None:
            if is_met and not (now.proposal or now.is_offered):
                return None
            return self._proposals.alternative(now, reading, words)
        slot = self._slots[number]
        if slot in news and self._names_another(text, slot, informs.get(slot, "")):
            return None
        named = self._flags({slot, *stays})
        proposed = torch.tensor(self._tracking.ids(now.proposal))
        # Other than what is proposed, unless the text names another one itself.
        itself = informs.get(slot, now.proposal.get(slot))
        is_named = bool((proposed[named] != NONE).any()) and itself == now.proposal.get(slot)
        is_beside = bool(now.proposal) if way or end else is_named
        if is_beside:
            takes = proposed if not is_met else torch.where(named, proposed, NONE)
            takes = torch.where(self._flags(informs), NONE, takes)
            held = torch.where(takes != NONE, takes, held)
        is_wish = (is_wish | named | records.opening) & ~records.determines[:, number]
        is_other = bool(way) or moves.says(text, "else")
        # "Would another theater have a later one?"
        is_time = self._flags([s for s, kind in self._lexicon.kinds.items() if kind == "time"])
        is_moved = bool(way) and not is_time[number]
        base, found = held, []
        if not is_moved:
            found = self._choices(now, held, number, way, end, is_other=is_other)
        if len(found) < 2 and not (way or end):  # leave out what the agent chose
            base = torch.where(is_wish, held, NONE)
            found = self._choices(now, base, number, is_other=is_other) or found
        if len(found) < 2 and not (is_met or way or end):  # what there is at all
            is_place = slot != self._thing and records.lasting[number]
            stays_so = (records.opening if is_place else records.lasting) | self._flags(informs)
            at_all = torch.where(is_wish & stays_so, full(now.state), NONE)
            found = self._choices(now, at_all, number, is_other=is_other) or found
        if len(found) > 1 and not (is_time[number] and len(found) > _FEW):
            return self._where(now, reading, slot, found, words)
        # The wishes stay, unless none has them all.
        fixed = records.lasting | (is_wish & (is_met | records.determines.any(0))) | named
        fixed &= ~(is_time & is_moved)
        fixed[number] = False
        as_told = base.clone()
        as_told[number] = full(now.state)[number]
        propose = partial(self._proposals.propose, now, reading, words=words, held=as_told)
        refused = self._proposals.refused(now)
        nearest = partial(
            records.nearest,
            base,
            refused,
            asked=self._proposals.lacking(now),
            slot=number,
            direction=way,
        )
        change = {number: found[0]} if found else {} if end else nearest(stays=fixed)
        if change:
            return propose(change)
        if not (is_met or is_beside):
            change = records.nearest(held, refused, slot=number, direction=way)
            change = change or records.nearest(held, refused, asked=[number])
            return self._proposals.propose(now, reading, change, words)
        own = self._proposals.nearest(now).get(slot)
        if is_met and not (is_other or end or "only" in text):  # "which theaters have it?"
            told = Frame("inform", {slot: own or NO_MATCH_TEXT})
            stands = self._nlg.say("stands", **words) if now.proposal or now.is_offered else ""
            sentence = f"{self._nlg.agent(told, **words)} {stands}".strip()
            return Answer(sentence, reading, reading.frame, told, replace(now, asking=Asking()))
        use = {1: "nothing_later", -1: "nothing_earlier"}.get(way or end, "no_other")
        place = self._tracking.values(records.here(base, fixed & (is_wish | self._place)))
        sentence = self._nlg.say(use if place else "only", [slot], values=place, **words)
        is_free = not (end or "only" in text) and now.times < MAX_PROPOSALS
        if is_free and (change := nearest(stays=fixed & (records.lasting | named))):
            return propose(change, lead=sentence)
        if is_met and not (now.proposal or now.is_offered or refused):  # the one that there is
            row = records.row(full(now.state), {})
            rest = torch.where(self._place & (row != full(now.state)), row, NONE)
            now = replace(now, proposal=self._tracking.values(rest))
        if now.proposal or now.is_offered:
            shown = self._proposals.nearest(now).items()
            if moves.says(text, "no_first") or any(one.items() <= shown for one in now.refused):
                now = self._proposals.refuse(now)
                now = replace(now, refused=(*now.refused, *([{slot: own}] if own else [])))
                if change := records.nearest(full(now.state), self._proposals.refused(now)):
                    return self._proposals.propose(now, reading, change, words, lead=sentence)
            sentence += f" {self._nlg.say('stands', **words)}"
        now = replace(now, asking=Asking())
        return Answer(sentence, reading, reading.frame, Frame("not_sure"), now)

    def _widened(
        self, held: torch.Tensor, informs: Collection[str], slots: Sequence[str]
    ) -> torch.Tensor:
        """Returns the values held, without what a text that asks for others leaves open.

        Args:
            held: long ``[S]``, the values held.
            informs: the slots that the text tells: "in Detroit" is not at the one theater there.
            slots: those of which it asks for others: "another time, maybe at another theater?"
        """
        is_told, records = self._flags(informs), self._records
        is_within = records.determines[:, is_told].any(1) & ~is_told & ~records.lasting
        is_free = (is_within & ~self._flags(slots)) | (self._flags(slots[1:]) & ~is_told)
        return torch.where(is_free & ~self._flags(slots[:1]), NONE, held)

    def _flags(self, slots: Collection[str]) -> torch.Tensor:
        """Returns which slots are among some, bool ``[S]``."""
        return torch.tensor([slot in slots for slot in self._slots])

    def _several(
        self,
        now: Memory,
        reading: Understood,
        slot: str,
        choices: tuple[str, ...],
        words: dict[str, Any],
    ) -> Answer:
        """Returns the list of some values of a slot, with what else is asked where it is one.

        What all of them have is said first.
        """
        held, index = full(now.state), self._slots.index
        kinds, spoken_of = self._lexicon.kinds, {*self._tracking.open(now.state), *now.lacking}
        if kinds[slot] in ("time", "date"):  # at 5 pm, but on which day, what and where?
            spoken_of |= {self._thing, *compress(self._slots, self._wider.tolist())}
        if kinds[slot] == "time":
            spoken_of |= {other for other, kind in kinds.items() if kind == "date"}
        spoken_of = spoken_of & self._listed - {slot}
        asked = [one for one in self._slots if one in spoken_of and held[index(one)] < FIRST_VALUE]
        beside = []
        for value in choices[:MAX_CHOICES]:
            held = held.clone()
            held[index(slot)] = self._tracking.ids({slot: value})[index(slot)]
            found = {one: self._choices(now, held, index(one), is_other=False) for one in asked}
            beside.append(
                {
                    one: self._records.vocabulary[index(one)][of[0]]
                    for one, of in found.items()
                    if len(of) == 1
                }
            )
        same = {s: v for s, v in beside[0].items() if all(one.get(s) == v for one in beside)}
        beside = [{s: v for s, v in one.items() if s not in same} for one in beside]
        sentence = self._nlg.say("several", [slot], choices=choices, beside=beside, **words)
        if same:
            sentence = f"{self._nlg.agent(Frame('inform', same), **words)} {sentence}"
        answered = Frame("multiple_choice", {}, (slot,), choices)
        lacking = tuple(dict.fromkeys((*now.lacking, slot)))  # "what cinema is each of those at?"
        now = replace(now, asking=Asking(slot=slot, choices=choices), proposal={}, lacking=lacking)
        return Answer(sentence, reading, reading.frame, answered, now)

    def _names_another(self, text: str, slot: str, value: str) -> bool:
        """Returns whether a text that asks for others then names one: "others? Dune?"."""
        asking, said = moves.others(text), " ".join(tokenize(text))
        after = said[said.find(asking) :]
        is_named = self._lexicon.place(after.split(), slot, value) is not None
        return is_named and len(moves.besides(asking)) == 1

    def _choices(
        self,
        now: Memory,
        held: torch.Tensor,
        number: int,
        way: int = 0,
        end: int = 0,
        *,
        is_other: bool,
    ) -> list[int]:
        """Returns the values of a slot, or the one at an end; none if it is the one held."""
        free = held.clone()
        free[number] = held[number] if is_other else NONE
        found = self._records.choices(free, number, way, self._proposals.lacking(now))
        found = found[-1 if end > 0 else 0 :][:1] if end else found
        return [] if found == [int(held[number])] else found

    def _meant(
        self,
        now: Memory,
        text: str,
        question: Frame | None,
        informs: Mapping[str, str],
        only: str,
    ) -> tuple[list[str], list[str]]:
        """Returns the slots of which a text asks for others, and those that stay as they are.

        They are named, or else that which the agent listed or asked for last.
        """
        told = {**self._tracking.kept(now.state), **now.proposal, **informs}
        wanted, *other = moves.besides(moves.others(text))
        lexicon, named_values = self._lexicon, moves.named_values
        stays = moves.named_slots(moves.same(wanted), lexicon)
        stays += [self._holder] * moves.says(wanted, "there")
        who = [self._holder] * moves.says(wanted, "holder")
        if question is not None and moves.says(wanted, "listed"):
            return [*question.requests], []
        first = " ".join(moves.after_other(wanted))
        names = [*moves.named_slots(first, lexicon), *moves.named_slots(wanted, lexicon)]
        slots = who or [s for s in names if s in self._listed and s not in stays]
        if moves.says(wanted, "other_day"):
            slots = slots or [s for s in lexicon.slots if lexicon.kinds[s] == "date"]
        if moves.says(wanted, "something_else"):  # "something else with good reviews"
            slots = [slot for slot in slots if slot not in informs]
        # "Anything other than Oppenheimer in 3D?"
        excluded = named_values(" ".join(other), told, lexicon)
        slots = slots or [slot for slot in excluded if slot not in informs]
        slots = slots or [self._thing] * (bool(other) and not moves.direction(text))
        stays += named_values(wanted, told, lexicon)
        if moves.says(wanted, "other_day"):  # another evening is at any time
            stays = [slot for slot in stays if lexicon.kinds[slot] != "time"]
        # Another of a chain is another theater, whose name begins with the chain's.
        begins = tuple(f"{told.get(slot)} " for slot in stays)
        slots = slots or [slot for slot, name in told.items() if name.startswith(begins)]
        if " only" in wanted:  # "is 7 pm the only one?", "is it only on Friday?"
            of_it = wanted.partition(" the only")[0] if " the only" in wanted else wanted
            slots = slots or named_values(of_it, told, lexicon)
        slots = slots or [only] * moves.says(wanted, "other_one")
        is_time = moves.says(moves.others(text), "time", "latest", "earliest")
        if not slots and (is_time or moves.says(text, "later", "earlier")):
            slots = [slot for slot in lexicon.slots if lexicon.kinds[slot] == "time"]
        if not slots and question is not None:
            is_thing = moves.says(wanted, "thing") and not question.choices
            is_thing &= not now.proposal or only == self._thing
            asked = [] if now.proposal else [*question.requests][:1]
            slots = [self._thing] if is_thing else asked
        return slots or [self._thing] * bool(stays), stays

    def unasked(
        self,
        now: Memory,
        reading: Understood,
        words: dict[str, Any],
        slot: str,
        requests: Sequence[str],
    ) -> Answer | None:
        """Returns what is said instead of asking for a slot, if there is little to choose from.

        It is the proposal of the one record left, or of one that has a wish which few records have
        ("near my hotel" is in a city), or the few values that are left.

        Args:
            now: the memory, with the state after the person's act.
            reading: the meaning of the text.
            words: what determines the words.
            slot: the slot.
            requests: the slots asked for; the proposal tells their values.
        """
        assert now.state is not None
        held, number = full(now.state), self._slots.index(slot)
        names = self._records.vocabulary[number]
        choices = tuple(names[value] for value in self._choices(now, held, number, is_other=False))
        details = self._records.minor & (held >= FIRST_VALUE) & (now.state["wished"] > 0)
        differs, lacks = self._records.compare(held)
        count = int((~(differs | lacks).any(-1)).sum())
        is_rare = bool(details.any()) and 0 < count <= _FEW
        refused = self._proposals.refused(now)
        row = self._records.row(held, {}, refused)
        is_new = not any(all(int(row[n]) == value for n, value in one) for one in refused)
        is_known = slot == self._thing or held[self._slots.index(self._thing)] >= FIRST_VALUE
        is_open = self._place & (held < FIRST_VALUE) & (row != NONE)
        if is_new and is_open.any() and (is_rare or (is_known and len(choices) == 1)):
            told = (is_open | details).nonzero().flatten().tolist()
            asked = [self._slots.index(one) for one in requests]
            return self._proposals.propose(
                now, reading, {n: int(row[n]) for n in told}, words, asked
            )
        if is_known and not requests and 1 < len(choices) < MAX_CHOICES:
            return self._several(now, reading, slot, choices, words)
        return None

    def listed(
        self, now: Memory, reading: Understood, words: dict[str, Any], requests: Sequence[str]
    ) -> Answer | None:
        """Returns the list of what a person asks for, if there are several values of it.

        Of many it is the list of where they are.

        Args:
            now: the memory, with the state after the person's act.
            reading: the meaning of the text.
            words: what determines the words.
            requests: the slots asked for.
        """
        assert now.state is not None
        held, index = full(now.state), self._slots.index
        open_ = [one for one in requests if one in self._listed and held[index(one)] < FIRST_VALUE]
        if not open_:
            return None
        found = self._choices(now, held, index(open_[0]), is_other=False)
        return self._where(now, reading, open_[0], found, words) if len(found) > 1 else None

    def _where(
        self, now: Memory, reading: Understood, slot: str, found: list[int], words: dict[str, Any]
    ) -> Answer:
        """Returns the list of some values, or of many theaters or times that of where they are."""
        held, number = full(now.state), self._slots.index(slot)
        wider = self._wider & (held == NONE)
        is_of_place = slot == self._holder or self._lexicon.kinds[slot] == "time"
        if len(found) > MAX_CHOICES and is_of_place and wider.any():
            where = int(wider.nonzero()[0])
            places = self._choices(now, held, where, is_other=False)
            if len(places) > 1:
                slot, number, found = self._slots[where], where, places
        values = tuple(self._records.vocabulary[number][value] for value in found)
        return self._several(now, reading, slot, values, words)

    def beside(
        self, now: Memory, reading: Understood, question: Frame | None, words: dict[str, Any]
    ) -> Answer | None:
        """Returns a list again, with what a text asks of its values, if it picks none of them.

        Args:
            now: the memory, with the state after the person's act.
            reading: the meaning of the text.
            question: the agent's act that the text answers, which may be a list.
            words: what determines the words.
        """
        assert now.state is not None
        if question is None or not question.choices:
            return None
        slot, asked = question.requests[0], {*reading.frame.requests} & self._listed
        held, number = full(now.state), self._slots.index(slot)
        many = [
            one
            for one in map(self._slots.index, asked)
            if len(self._choices(now, held, one, is_other=False)) > 1
        ]
        if slot in {*asked, *reading.frame.informs} or not many:
            return None
        found = self._choices(now, held, number, is_other=False)
        names = {self._records.vocabulary[number][value] for value in found}
        left = tuple(value for value in question.choices if value in names)
        return self._several(now, reading, slot, left, words) if len(left) > 1 else None

    def on_file(
        self, now: Memory, reading: Understood, words: dict[str, Any], told: Mapping[str, str]
    ) -> Answer | None:
        """Returns the proposal of a record here that has what is not on file for another, if any.

        Args:
            now: the memory, with the state after the person's act.
            reading: the meaning of the text.
            words: what determines the words.
            told: the answers to the text, by slot.
        """
        needed = self._spelling.domain.essential
        asked = [self._slots.index(slot) for slot in needed if told.get(slot) == NO_MATCH_TEXT]
        if now.state is None or not asked:
            return None
        held, wished = full(now.state), now.state["wished"] > 0
        here = self._records.lasting & (wished | ~self._records.opening)
        change = self._records.nearest(held, self._proposals.refused(now), has=asked, stays=here)
        lead = self._nlg.say("has_it", **words)
        found = self._proposals.propose(now, reading, change, words, asked, lead=lead)
        return found if found.memory.proposal not in ({}, now.proposal) else None

    def narrowed(
        self, reading: Understood, text: str, held: Mapping[str, str], record: Mapping[str, str]
    ) -> Understood:
        """Returns a reading whose unclear names mean only what is left with the other values.

        Args:
            reading: the meaning of the text.
            text: the person's text.
            held: the values told before.
            record: the values of the record that is proposed or offered, if any.
        """
        informs, unclear, sure = {**reading.frame.informs}, [], reading.confidence
        index, determines = self._slots.index, self._records.determines
        changed = [index(s) for s, value in informs.items() if record.get(s, value) != value]
        is_tied = (determines | determines.T)[:, changed].any(-1)
        # "Burbank is in California. Anything in Texas?" wishes no Burbank.
        informs = {
            s: v for s, v in informs.items() if not (is_tied[index(s)] and record.get(s) == v)
        }
        wishes = torch.tensor(self._tracking.ids({**held, **informs}))
        for one in reading.unclear:
            number = self._slots.index(one.slot)
            names = self._records.vocabulary[number]
            left: tuple[str, ...] = ()
            for known in (wishes.clone(), self._records.here(wishes)):
                known[number] = NONE
                fit = {names[value] for value in self._records.choices(known, number)}
                left = left or tuple(value for value in one.candidates if value in fit)
            said = [value for value in one.candidates if f" {value} " in f" {one.text} "]
            if said:  # "the day after tomorrow"
                left = (max(said, key=len),)
            if self._lexicon.kinds[one.slot] == "time":  # the nearest time, if none fits
                left = left or one.candidates[:1]
            elif len(one.candidates) > 1 or self._records.minor[number]:  # though none fits
                left = left or one.candidates
            if len(left) == 1:
                informs[one.slot] = left[0]
            else:
                unclear.append(replace(one, candidates=left))
        for slot, whole in self._spelling.wholes.items():
            if whole in informs or any(one.is_denied for one in unclear):
                continue
            place = self._proposals.lasting({**held, **record}) | informs
            name = next((one.text for one in unclear if one.slot == slot), informs.get(slot, ""))
            if found := self._whole(whole, name, text, place):
                informs[whole], sure = found, max(sure, DOUBTFUL)
                informs.pop(slot, None)
        told = informs.values()  # "Old Town" is in the theater's name
        unclear = [u for u in unclear if u.is_denied or not any(is_in(u.text, v) for v in told)]
        frame = replace(reading.frame, informs=informs)
        return replace(reading, frame=frame, confidence=sure, unclear=tuple(unclear))

    def _whole(self, slot: str, name: str, text: str, place: Mapping[str, str]) -> str:
        """Returns the one value of a slot here that a text means by a part; empty if none is.

        Args:
            slot: the slot, as the theater.
            name: the name that is heard with which it may begin, as a chain.
            text: the text, which may have two words of it: "the grove 8".
            place: what the record is about and where it is.
        """
        number, said = self._slots.index(slot), tokenize(text)
        parts = [name] if name else [part for part in _parts(said) if part in self._parts[slot]]
        if not parts:
            return ""
        if not name:  # "New York" is a city
            lasts = dict(zip(self._slots, self._records.lasting.tolist(), strict=True))
            spans = [span for span in self._lexicon.full_names(said) if lasts[span.slot]]
            other = {word for span in spans for word in said[span.start : span.end]}
            parts = [part for part in parts if other.isdisjoint(part.split())]
        names = self._records.vocabulary[number]
        held = torch.tensor(self._tracking.ids(place))
        for known in (held, self._records.here(held)):  # of this movie, or here at all
            known[number] = NONE
            found = {names[value] for value in self._records.choices(known, number)}
            fit = [one for one in found if any(is_in(part, one) for part in parts)]
            # Of several the one with most of the words: "the AMC, Northgate I think".
            shared = [len({*said} & {*one.split()}) for one in fit]
            best = [one for one, count in zip(fit, shared, strict=True) if count == max(shared)]
            if best:
                return best[0] if len(best) == 1 else ""
        return ""


def _parts(words: Sequence[str]) -> list[str]:
    """Returns each two words that stand beside each other."""
    return [" ".join(pair) for pair in pairwise(words)]
