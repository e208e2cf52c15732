"""What a person means by a text: the nlu's reading of it, mended by rules of the conversation."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import isnan
from typing import TYPE_CHECKING

from bbq_torchrl.domains.frames import ANY
from bbq_torchrl.people.dialogue import moves
from bbq_torchrl.people.dialogue.spelling import is_in
from bbq_torchrl.people.language import Frame, Understood
from bbq_torchrl.people.language.assembly import is_denied
from bbq_torchrl.people.language.quantities import about_minutes, minutes_of
from bbq_torchrl.people.language.words import SMALL, has_bye, is_farewell, is_no, tokenize

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from bbq_torchrl.people.dialogue.spelling import Spelling
    from bbq_torchrl.people.language import Nlu

DOUBTFUL = 0.5
"""The confidence below which a reading is more likely wrong than right, and its values checked."""
_SHORT = 3  # words that may be a number and nothing else: "for two please"
_NEARLY = 15  # minutes
_TINY = 2  # letters of "if" and the like, which are no names among other words


class Hearing:
    """Reads texts, with their values in the one spelling.

    Args:
        nlu: the nlu.
        spelling: the spelling of values.
        rules: the rules of the dialogue control.
        details: the slots that few goals constrain.
    """

    def __init__(
        self, nlu: Nlu, spelling: Spelling, rules: Collection[str], details: Collection[str] = ()
    ) -> None:
        self._nlu, self._spelling, self._rules = nlu, spelling, rules
        self._domain, self._details = spelling.domain, details
        phrases = spelling.lexicon.phrases.slots
        things = (slot for slot in spelling.domain.opening_slots if slot in phrases)
        self._things = {"one", "ones"}.union(*(phrases[slot].nouns for slot in things))
        texts = [slot for slot, kind in spelling.lexicon.kinds.items() if kind == "text"]
        names = (tokenize(name) for slot in texts for name in spelling.lexicon.values(slot))
        pairs = (pair for name in names for pair in pairwise(name))
        self._numbered = {
            (word, number) for word, number in pairs if word.isalpha() and number.isdigit()
        }

    def is_bare(self, frame: Frame, *acts: str) -> bool:
        """Returns whether a frame of one of some acts has no values, and asks for no slot."""
        is_empty = not frame.informs and {*frame.requests} <= {self._domain.ticket_slot}
        return is_empty and (not acts or frame.act in acts)

    def is_unsure(self, reading: Understood) -> bool:
        """Returns whether a text was understood too poorly to act on."""
        return self._nlu.asks(reading)

    def __call__(self, text: str, question: Frame | None) -> Understood:
        """Returns the meaning of a text, with its values in the one spelling."""
        reading = self._nlu(text, question)
        if question is not None and question.choices and self.is_bare(reading.frame):
            alone = self._nlu(text, Frame("request", {}, question.requests))
            if ANY in alone.frame.informs.values():  # none of the list: "I don't care"
                reading = alone
        rules = self._rules
        if "aside" in rules and question is not None:
            reading = self._aside(text, question.requests[:1], reading)
        if "answers_first" in rules:
            reading = self._all_questions(text, reading)
        asked = question.requests if question is not None and not question.choices else ()
        if "drop" in rules and asked and moves.is_nothing(text):
            free = Frame("inform", {asked[0]: ANY})
            reading = replace(reading, frame=free, confidence=1.0, unclear=())
        values = reading.frame.informs
        if "names" not in rules:
            frame = replace(reading.frame, informs=self._spelling.of(values))
            return replace(reading, frame=frame)
        informed = question.informs if question is not None else {}
        kinds = self._spelling.lexicon.kinds
        is_short = len(text.split()) <= _SHORT
        informs, unclear = self._spelling.understood(text, values, informed, reading.unclear)
        # "What is on now?", "I know it now"
        informs = {s: v for s, v in informs.items() if v != "now" or s in asked}
        # "Any day this week" is the date of a record, and no wish.
        informs = {s: ANY if v.startswith("any ") else v for s, v in informs.items()}
        informs |= self._details_in(text, informs)
        words = tokenize(text)
        informs = {s: v for s, v in informs.items() if not self._is_small(words, s, v)}
        counts = {slot for slot in informs if kinds.get(slot) == "count"}
        is_pronoun = moves.says(text, "the_one") and {informs[s] for s in counts} == {"1"}
        is_other = is_pronoun or self._is_in_names(words, {informs[s] for s in counts})
        is_other |= moves.says(text, "rest")  # "and the 3 others?"
        if is_other or (question and counts and not self._is_counted(text, question)):
            informs = {s: v for s, v in informs.items() if s not in counts}
        days = [value for slot, value in informs.items() if kinds.get(slot) == "date"]
        informs = {  # "tonight" is a day, and no time as well; "nope" is no film
            slot: value
            for slot, value in informs.items()
            if not (kinds.get(slot) == "time" and value in days)
            and not self._is_too(words, slot, value)
            and not (slot not in asked and is_no(value) and moves.begins_with(text, value))
        }
        unclear = tuple(
            one
            for one in unclear
            if one.is_denied or (one.candidates and is_short) or not self._is_tiny(one.text)
        )
        frame = replace(reading.frame, informs=informs)
        if "answers_first" in rules and {*frame.requests} - {self._domain.ticket_slot}:
            spoken_of = {action.slot for action in self._domain.actions}
            unclear = tuple(one for one in unclear if one.slot in spoken_of)  # others can wait
        return replace(reading, frame=frame, unclear=unclear)

    def _is_counted(self, text: str, question: Frame) -> bool:
        """Returns whether a number in a text may be a count: not in "what is it, five or six?"."""
        kinds = self._spelling.lexicon.kinds
        counts = {slot for slot in kinds if kinds[slot] == "count"}
        asks = all(moves.says(one, "wh") and one.endswith("?") for one in moves.sentences(text))
        named = {*question.requests, *self._spelling.named(text, counts)}
        return not asks or not counts.isdisjoint(named)

    def _is_in_names(self, words: list[str], numbers: Collection[str]) -> bool:
        """Returns whether numbers are said only as parts of names, as in "the Southgate 10"."""
        said = {pair for pair in pairwise(["", *words]) if pair[1] in numbers}
        return bool(said) and said <= self._numbered

    def _is_tiny(self, name: str) -> bool:
        """Returns whether a name has two letters, or only words such as "or"."""
        return len(name) <= _TINY or {*name.split()} <= SMALL

    def _is_small(self, words: list[str], slot: str, value: str) -> bool:
        """Returns whether a text has no more for a name than a word such as "or", in a sentence."""
        place = self._spelling.lexicon.place(words, slot, value)
        is_text = self._spelling.lexicon.kinds.get(slot) == "text" and len(words) > _SHORT
        return is_text and place is not None and {*words[place.start : place.stop]} <= SMALL

    def _is_too(self, words: list[str], slot: str, value: str) -> bool:
        """Returns whether a text complains of a detail, which is no wish: "too scary for her"."""
        place = self._spelling.lexicon.place(words, slot, value) if slot in self._details else None
        return place is not None and words[: place.start][-1:] == ["too"]

    def of_record(
        self, reading: Understood, record: Mapping[str, str], text: str = ""
    ) -> Understood:
        """Returns a reading whose unclear names are those of a record that have them in them.

        A time without am or pm is the record's: "is it still 10:05?"
        """
        kinds = self._spelling.lexicon.kinds
        meant = {
            one.slot: record[one.slot]
            for one in reading.unclear
            if not one.is_denied and one.slot in record
            if is_in(one.text, record[one.slot])
            or (kinds[one.slot] == "time" and _is_about(one.text, record[one.slot]))
        }
        unclear = tuple(one for one in reading.unclear if one.slot not in meant)
        informs = self._spelling.as_in(record, text, reading.frame.informs) | meant
        informs = self._spelling.hours_in(record, text, informs)
        fixed = {s: v for s, v in informs.items() if s not in self._domain.free_slots}
        is_meant = self._spelling.is_meant
        is_of_it = all(s in record and is_meant(s, v, record[s]) for s, v in fixed.items())
        if is_of_it and not moves.others(text):  # "Friday" of a show on Friday night
            informs |= {slot: record[slot] for slot in fixed}
        return replace(reading, frame=replace(reading.frame, informs=informs), unclear=unclear)

    def without_relative(
        self, reading: Understood, text: str, record: Mapping[str, str]
    ) -> Understood:
        """Returns the reading of a text that asks for others, without values that only say which.

        They are "the last show", "later than 9", and of a record "9:50 is a bit late".
        """
        is_moved, kinds = bool(moves.direction(text)), self._spelling.lexicon.kinds
        is_than = moves.says(text, "than")

        def is_which(slot: str, value: str) -> bool:
            is_own = slot in record and self._spelling.is_meant(slot, value, record[slot])
            is_time = is_moved and kinds.get(slot) == "time"
            is_vague = is_own or is_than or self._spelling.is_vague_time(slot, value)
            return moves.is_relative(value) or (is_time and is_vague)

        told = reading.frame.informs
        informs = {slot: value for slot, value in told.items() if not is_which(slot, value)}
        return replace(reading, frame=replace(reading.frame, informs=informs))

    def leaving(self, reading: Understood, text: str, is_offered: bool) -> Understood:
        """Returns a reading that ends the conversation only at words of farewell."""
        if "farewell" in self._rules:
            act = reading.frame.act
            is_refused = is_no(text) or self.is_bare(reading.frame, "deny", "not_sure")
            is_refused |= self.is_unsure(reading)
            leaves = (act == "thanks" and not is_offered) or (
                is_refused and moves.beside_yes(text) is None
            )
            if leaves and has_bye(text):
                return replace(reading, frame=Frame("closing"), confidence=1.0, unclear=())
            if act == "closing" and not is_farewell(text):
                return replace(reading, frame=Frame("not_sure"), confidence=0.0)
        return reading

    def refused(
        self,
        reading: Understood,
        text: str,
        held: Mapping[str, str],
        shown: Sequence[Mapping[str, str]],
    ) -> tuple[Understood, list[dict[str, str]]]:
        """Returns a reading without what it denies by name, and that, a value by slot each.

        Args:
            reading: the meaning of the text.
            text: the text, which may deny what is shown without a wish: "no Detroit, please".
            held: the values told before; those that are denied do not hold.
            shown: the values of the records that were proposed or offered.
        """
        denied, lexicon = [], self._spelling.lexicon
        for one in reading.unclear:
            if one.is_denied and (values := lexicon.link(one.slot, one.text).values):
                denied.append(self._spelling.of({one.slot: values[0]}))
        said, told = tokenize(text), reading.frame.informs
        for slot, start, end in lexicon.full_names(said):
            known = {of[slot] for of in (held, *shown) if slot in of} - {told.get(slot)}
            known.intersection_update(lexicon.link(slot, " ".join(said[start:end])).values)
            if is_denied(said, start, end):
                denied += [{slot: name} for name in known if {slot: name} not in denied]
        if not denied:
            return reading, []
        frame = reading.frame
        free = {slot: ANY for one in denied for slot in one if one.items() <= held.items()}
        informs = {**free, **frame.informs}
        act = "inform" if free else frame.act if informs or frame.requests else "deny"
        frame = replace(frame, act=act, informs=informs)
        unclear = tuple(one for one in reading.unclear if not one.is_denied)
        return replace(reading, frame=frame, unclear=unclear, confidence=1.0), denied

    def dropped(
        self, reading: Understood, text: str, question: Frame | None, held: Mapping[str, str]
    ) -> tuple[Understood, tuple[str, ...]]:
        """Returns a reading in which wishes are taken back, and their slots if that is news.

        Args:
            reading: the meaning of the text.
            text: the text.
            question: the agent's act that it answers.
            held: the values told before.
        """
        told, lexicon, gone = reading.frame.informs, self._spelling.lexicon, moves.taken_words(text)
        slots = tuple(
            slot
            for slot in moves.taken_back(text, held, lexicon)
            if (told.get(slot, ANY) == ANY and (slot in held or slot not in self._details))
            or (slot in held and told.get(slot) == held[slot])
            or lexicon.place(gone, slot, told.get(slot, "")) is not None
        )
        if not slots:
            is_free = bool(told) and set(told.values()) == {ANY}
            if is_free and "?" in text and not reading.frame.requests:  # "Any discounts?"
                return replace(reading, frame=Frame("not_sure"), confidence=0.0), ()
            return reading, ()
        informs = {slot: value for slot, value in told.items() if value != ANY}
        asking = " ".join(moves.questions(text))  # "any day is fine. which days are there?"
        asked_for = moves.named_slots(asking, lexicon)
        requests = tuple(s for s in reading.frame.requests if s not in slots or s in asked_for)
        informs |= dict.fromkeys(slots, ANY)
        frame = replace(reading.frame, informs=informs, requests=requests)
        if frame.act not in ("inform", "request"):
            frame = replace(frame, act="request" if frame.requests else "inform")
        unclear = tuple(one for one in reading.unclear if one.slot not in slots)
        asked = question.requests if question is not None else ()
        news = tuple(slot for slot in slots if slot in held or slot not in asked)
        return replace(reading, frame=frame, confidence=1.0, unclear=unclear), news

    def _all_questions(self, text: str, reading: Understood) -> Understood:
        """Returns a reading with the questions of each clause, which are read by themselves.

        "What time is the earliest show?" asks for the time: "earliest show" is no clock time.
        """
        asked, informs = dict.fromkeys(reading.frame.requests), {**reading.frame.informs}
        said = moves.sentences(text)
        others = [s for s in said if moves.says(s, "wh") or not moves.says(s, "whether")]
        if informs and len(others) < len(said):  # "is it Barbie?" asks for no price
            rest = self._nlu(" ".join(others), None).frame.requests if others else ()
            kept = {*rest, *self._spelling.named(text, asked), self._domain.ticket_slot}
            asked = {slot: None for slot in asked if slot in kept}
        asking = " ".join(one for one in said if moves.says(one, "question"))
        for slot in self._spelling.named(asking, informs):
            if informs[slot] != ANY and self._spelling.is_vague_time(slot, informs[slot]):
                if self._spelling.lexicon.place(asking.split(), slot, informs[slot]) is None:
                    continue
                asked[slot] = None
                if moves.is_relative(informs[slot]) or isnan(about_minutes(informs[slot])):
                    del informs[slot]  # no part of the day
        if moves.says(text, "how_much"):  # "how much are two tickets?"
            asked |= dict.fromkeys(self._spelling.named("much", self._spelling.lexicon.slots))
        for clause in moves.questions(text):
            # "When" names two, "is showing" none.
            named = set(self._spelling.named(moves.without_verbs(clause), self._domain.slots))
            if named.isdisjoint(asked) and not moves.others(clause):
                alone = self._nlu(clause, None)
                is_sure = not named and not self.is_unsure(alone)  # "what is on"
                found = (slot for slot in alone.frame.requests if slot in named or is_sure)
                asked |= dict.fromkeys(found)
        act = reading.frame.act if {*asked} == {*reading.frame.requests} else "request"
        return replace(reading, frame=Frame(act, informs, tuple(asked)))

    def _details_in(self, text: str, told: Mapping[str, str]) -> dict[str, str]:
        """Returns the details that a text names in full as such: "3D movies", "in 3D".

        Args:
            text: the text.
            told: the values that are heard.
        """
        lexicon, sentences = self._spelling.lexicon, moves.sentences(text)
        # "Is it a horror movie?" is no wish.
        said = tokenize(" ".join(one for one in sentences if not moves.says(one, "is_it")))
        found = {}
        for slot, start, end in lexicon.full_names(said):
            before, after = said[:start][-2:], said[end : end + 1]
            is_beside = "in" in before[-1:] or "whatever" in before
            is_beside |= not self._things.isdisjoint(after)
            is_beside |= slot in self._spelling.wholes and before[-1:] == ["the"]  # "the AMC"
            is_told = slot in told or is_denied(said, start, end)
            if slot in self._details and is_beside and not is_told:
                found[slot] = lexicon.link(slot, " ".join(said[start:end])).values[0]
        return self._spelling.of(found)

    def _with_named(self, text: str, alone: Understood, reading: Understood) -> Understood:
        """Returns the reading of a reply with what it names in full: "two", "at the AMC"."""
        told = reading.frame.informs
        added = {slot: v for slot, v in alone.frame.informs.items() if slot not in told}
        is_number = len(alone.frame.informs) == 1 and len(text.split()) <= _SHORT
        if told or "?" in text or not is_number:  # "the late one" is no number of people
            added = {slot: v for slot, v in added.items() if slot not in self._domain.free_slots}
        if not (added and self._spelling.is_named(text, added)):
            return reading
        act = "inform" if reading.frame.act == "thanks" else reading.frame.act
        return replace(reading, frame=replace(reading.frame, act=act, informs={**added, **told}))

    def _aside(self, text: str, asked: tuple[str, ...], reading: Understood) -> Understood:
        """Returns the meaning of a text that may say or ask something instead of answering."""
        alone = self._nlu(text, None)
        if not asked:
            reading = self._with_named(text, alone, reading)
        named = self._spelling.named(text, alone.frame.requests, asked)
        is_echo = not set(asked) <= set(named) and set(asked) <= set(reading.frame.requests)
        is_better = alone.confidence > reading.confidence
        is_silent = self.is_bare(reading.frame) and not (reading.unclear or moves.accepts(text))
        if is_silent and is_better and not self.is_bare(alone.frame) and not named:
            return replace(alone, takes=reading.takes)
        if not named or not (is_better or (asked and is_echo)):
            requests = (*reading.frame.requests, *named) if moves.says(text, "wh") else ()
            if {*requests} <= {*reading.frame.requests}:
                return reading
            asks = Frame("request", reading.frame.informs, tuple(dict.fromkeys(requests)))
            return replace(reading, frame=asks)
        free = self._domain.free_slots
        told = {s: v for s, v in alone.frame.informs.items() if is_better and s not in free}
        frame = Frame("request", {**told, **reading.frame.informs}, named)
        return replace(reading, frame=frame, confidence=alone.confidence)


def _is_about(said: str, time: str) -> bool:
    """Returns whether a time by the clock is nearly another: "10 am" of a show at 10:05 am."""
    return abs(minutes_of(said) - minutes_of(time)) < _NEARLY
