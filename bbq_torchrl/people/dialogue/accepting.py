"""Replies to a proposal or an offer: a yes, alone or with other content."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from bbq_torchrl.domains.frames import ANY
from bbq_torchrl.domains.values import fold
from bbq_torchrl.people.dialogue import moves
from bbq_torchrl.people.dialogue.exchange import values_of
from bbq_torchrl.people.dialogue.hearing import DOUBTFUL
from bbq_torchrl.people.language import Frame, Understood
from bbq_torchrl.people.language.asking import YES
from bbq_torchrl.people.language.words import is_no

if TYPE_CHECKING:
    from collections.abc import Mapping

    from bbq_torchrl.people.dialogue.control import Control
    from bbq_torchrl.people.dialogue.exchange import Memory
    from bbq_torchrl.people.dialogue.hearing import Hearing
    from bbq_torchrl.people.dialogue.spelling import Spelling
    from bbq_torchrl.people.dialogue.tracking import Acting, Tracking


SURE = 0.95
"""The probability from which a text without words that doubt is a yes."""


class Accepting:
    """Reads the replies to what the agent proposes or offers.

    Args:
        spelling: the spelling of values.
        hear: the reading of texts.
        tracking: the agent's knowledge.
        acting: the agent's acts.
        control: the rules of the dialogue control.
    """

    def __init__(
        self,
        spelling: Spelling,
        hear: Hearing,
        tracking: Tracking,
        acting: Acting,
        control: Control,
    ) -> None:
        self._spelling, self._hear, self._tracking = spelling, hear, tracking
        self._acting, self._control = acting, control
        domain = spelling.domain
        self._ticket, self._free = domain.ticket_slot, {*domain.free_slots}
        self._fixed = {*domain.essential} - self._free

    def proposed(
        self,
        before: Memory,
        record: Mapping[str, str],
        reading: Understood,
        text: str,
        asks: bool,
    ) -> tuple[Understood, bool] | None:
        """Returns the meaning of a text that takes a proposal, by a yes or by what fits it.

        What else the text says is told, or asked of that record. ``None`` if it does not take it.
        The second is whether it is a yes that says nothing but what is known, and for how many.

        Args:
            before: the memory before the text.
            record: the values of the proposed record by slot.
            reading: the meaning of the text.
            text: the person's text.
            asks: whether the whole text asks something.
        """
        proposal, takes = before.proposal, self._takes(reading, text, asks)
        beside = self._beside_yes(before, text, proposal)
        said = self._hear.of_record(beside or reading, record, text)
        if takes:
            said = _without_unknown(said)
        # "tonight" is a date, or a time.
        own = {fold(value): slot for slot, value in proposal.items()}
        told = {own.get(fold(value), slot): value for slot, value in values_of(said.frame).items()}
        free = {s: v for s, v in values_of(reading.frame).items() if s in self._free}
        is_certain = takes and self._is_certain(reading, text)
        is_yes = takes or beside is not None
        told = self._of_show({**free, **told}, record, text, is_yes, is_certain)
        requests = tuple(slot for slot in said.frame.requests if slot != self._ticket)
        is_meant = self._spelling.is_meant
        told |= {s: own for s, own in proposal.items() if s in told and is_meant(s, told[s], own)}
        fixed = {**{s: own for s, own in record.items() if s in self._fixed}, **proposal}
        is_other = self._spelling.is_other(told, record)
        if is_other or any(fixed.get(slot, value) != value for slot, value in told.items()):
            return None
        if beside is None:
            is_named = bool(told) and not said.unclear
            is_bare = self._hear.is_bare(reading.frame, *YES)
            is_named |= is_bare and not moves.says(text, "hesitates")
            if not (takes or (is_named and not moves.says(text, "no", "doubts", "must"))):
                return None
        frame = Frame("request" if requests else "inform", {**proposal, **told}, requests)
        known = {**record, **proposal}
        is_known = all(known.get(s) == value for s, value in told.items() if s not in self._free)
        is_yes = beside is not None and not (asks or moves.says(text, "hesitates", "but"))
        is_yes = (takes or is_yes) and is_known and not (requests or said.unclear)
        is_yes &= not self._asks_more(reading, text, known)
        # "Ok, forget the evening. Any time tomorrow" takes a wish back, and nothing else.
        takes_back = moves.taken_words(text) or ANY in reading.frame.informs.values()
        is_yes &= moves.ends_in_yes(text) or not takes_back
        taken = replace(said, frame=frame, confidence=max(said.confidence, DOUBTFUL))
        return taken, is_yes

    def offered(
        self,
        before: Memory,
        record: Mapping[str, str],
        reading: Understood,
        text: str,
        asks: bool,
    ) -> tuple[Understood, bool]:
        """Returns the meaning of a reply to an offer, and whether it is a yes that adds values.

        It is "thanks" if it accepts and says nothing else, and "not sure" if it neither accepts nor
        says anything that can be acted on.

        Args:
            before: the memory before the text.
            record: the values of the offered record by slot.
            reading: the meaning of the text.
            text: the person's text.
            asks: whether the whole text asks something.
        """
        frame = reading.frame
        assert before.state is not None
        offer = {**record, **self._tracking.kept(before.state)}
        takes = self._takes(reading, text, asks)
        if takes:  # "We bring cushions. Book it"
            reading = _without_unknown(reading)
        rest = moves.beside_yes(text)
        free = {s: v for s, v in values_of(frame).items() if s in self._free and s not in offer}
        if rest == "" and not free:
            return Understood(Frame("thanks"), 1.0, source=reading.source), False
        beside = None if rest == "" else self._beside_yes(before, text, offer)
        is_plain = frame.act != "deny" and ANY not in frame.informs.values()
        is_plain |= moves.ends_in_yes(text)
        if beside is None and (rest == "" or (takes and is_plain)):  # "just one for me, thanks"
            beside = replace(reading, confidence=1.0)
        is_sure = takes or not (asks or moves.says(rest or text, "hesitates", "but"))
        if beside is not None and is_sure:
            beside = _without_unknown(beside) if takes else beside
            is_meant = self._spelling.is_meant
            unclear = tuple(  # "we'll make a morning of it": the show is in the morning
                one
                for one in beside.unclear
                if not any(is_meant(one.slot, v, offer.get(one.slot, "")) for v in one.candidates)
            )
            beside = replace(beside, unclear=unclear)
            beside = self._hear.of_record(beside, offer, text)  # "today" is tonight's day
            is_certain = takes and self._is_certain(reading, text)
            told = self._of_show(values_of(beside.frame), offer, text, True, is_certain)
            if self._asks_more(reading, text, offer):
                return replace(reading, frame=Frame("not_sure")), False
            is_repeated = told.items() <= offer.items() and not beside.unclear
            # "sonds good, yes"
            says_yes = takes or beside.frame.act in YES or beside.confidence == 1.0
            if is_repeated and (told or says_yes):
                return Understood(Frame("thanks"), 1.0, source=reading.source), False
            fits = all(offer.get(slot, value) == value for slot, value in told.items())
            fits &= not self._spelling.is_other(told, offer)
            asked = {*beside.frame.requests} - {self._ticket}
            is_sure = not (asked or self._hear.is_unsure(beside)) and beside.frame.act != "deny"
            if told and fits and is_sure:
                added = replace(beside, frame=Frame("inform", told))
                stuck = self._control.is_stuck(self._acting.hear(before.state, added.frame))
                return added, not stuck
        if is_no(text):
            return replace(reading, frame=Frame("deny"), confidence=1.0, unclear=()), False
        is_bare = self._hear.is_bare
        is_vague = is_bare(frame) and frame.act not in ("deny", "closing")
        is_vague = is_vague or (
            is_bare(frame, "deny") and (asks or moves.says(text, "hesitates", "but"))
        )
        if not is_vague:
            # Thanks beside a value or a question end nothing.
            act = "request" if frame.requests else "inform"
            frame = replace(frame, act=act) if frame.act == "thanks" else frame
            return replace(reading, frame=frame), False
        return replace(reading, frame=Frame("not_sure")), False

    def _of_show(
        self,
        values: Mapping[str, str],
        record: Mapping[str, str],
        text: str,
        is_yes: bool,
        is_certain: bool,
    ) -> dict[str, str]:
        """Returns what a reply tells beside a show, of which a yes takes "Saturday night".

        A certain yes wishes no other detail, and nothing else of what it names: "I'll get an aisle
        seat. Yes, do it", "Sunday works, I fly on Monday. Go for it".
        """
        told = self._spelling.besides(values, record)
        if is_certain:
            own, named = self._fixed | self._free, self._spelling.is_named
            told = {s: v for s, v in told.items() if s in own or record.get(s) == v}
            told |= {s: record[s] for s in told.keys() & record if named(text, {s: record[s]})}
        return self._spelling.on_day(told, record) if is_yes else told

    @staticmethod
    def _is_certain(reading: Understood, text: str) -> bool:
        """Returns whether a text is likely a yes, and ends in one."""
        return reading.takes >= SURE and moves.ends_in_yes(text)

    def _takes(self, reading: Understood, text: str, asks: bool) -> bool:
        """Returns whether a text takes what is offered, whatever else it says."""
        is_end = moves.ends_in_yes(text)
        is_sure = reading.takes >= SURE and not moves.is_filler(text)  # "oh dear"
        doubts = ["hesitates"] if is_end else ["no", "hesitates", "but", "must"]
        is_yes = (is_end and is_sure) or not moves.says(text, *doubts)
        asked = {*reading.frame.requests} - {self._ticket}  # "the only one is when I'm at work"
        return not asks and (is_end or (is_sure and not asked)) and is_yes

    def _asks_more(self, reading: Understood, text: str, offer: Mapping[str, str]) -> bool:
        """Returns whether a text has a condition that is not of an offer's values."""
        if self._is_certain(reading, text):  # "If I hurry I make it. Yes"
            return False
        words, lexicon = moves.given(text), self._spelling.lexicon
        known = [(slot, value) for slot, value in offer.items() if slot in lexicon.slots]
        for slot, value in known if words else ():
            if (at := lexicon.place(words, slot, value)) is not None:
                del words[at.start : at.stop]
        return not all(
            any(value in lexicon.link(slot, word).values for slot, value in known) for word in words
        )

    def _beside_yes(
        self, before: Memory, text: str, values: Mapping[str, str]
    ) -> Understood | None:
        """Returns the meaning of what a text says beside a yes; ``None`` without a yes.

        Args:
            before: the memory before the text.
            text: the person's text.
            values: what the yes is about; to name one of them again adds nothing.
        """
        rest, lexicon = moves.beside_yes(text), self._spelling.lexicon
        if rest is None:
            return None
        name = rest.strip(" .,!")
        if not name or any(
            value in (link := lexicon.link(slot, name)).values and link.score > 0.8
            for slot, value in values.items()
            if slot in lexicon.slots
        ):
            return Understood(Frame("inform"), 1.0)
        said = None if before.state is None else self._tracking.answered(before.state)
        return self._hear(rest, said)


def _without_unknown(reading: Understood) -> Understood:
    """Returns a reading without the names that the domain lacks."""
    known = tuple(one for one in reading.unclear if one.candidates or one.is_denied)
    return replace(reading, unclear=known)
