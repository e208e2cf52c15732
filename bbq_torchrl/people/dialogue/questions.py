"""Answers to questions about the record that the agent proposes or offers."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise, product
from typing import TYPE_CHECKING, Any

from bbq_torchrl.domains.frames import NO_MATCH_TEXT
from bbq_torchrl.domains.values import RESERVED_TEXT, fold
from bbq_torchrl.people.dialogue import moves
from bbq_torchrl.people.dialogue.hearing import DOUBTFUL
from bbq_torchrl.people.dialogue.spelling import is_in
from bbq_torchrl.people.language import Frame
from bbq_torchrl.people.language.words import SMALL, tokenize

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from bbq_torchrl.people.dialogue.hearing import Hearing
    from bbq_torchrl.people.dialogue.spelling import Spelling
    from bbq_torchrl.people.language import EndpointGenerator, Generator, Unclear, Understood


@dataclass(frozen=True)
class Told:
    """The answers to the questions of a text.

    Attributes:
        text: the answers; empty without a question about the record.
        values: the values of the record that they tell, by slot.
        rest: what else the text says.
        is_yes: whether no answer is a "no".
        is_guess: whether it only owns up to not knowing what the text asks, as far as it is heard.
    """

    text: str
    values: Mapping[str, str]
    rest: str
    is_yes: bool = True
    is_guess: bool = False


class Questions:
    """Answers, sentence by sentence, whether a record has a value and what its values are.

    Args:
        spelling: the spelling of values.
        hear: the reading of texts.
        nlg: the nlg.
    """

    def __init__(
        self, spelling: Spelling, hear: Hearing, nlg: Generator | EndpointGenerator
    ) -> None:
        self._spelling, self._hear, self._nlg = spelling, hear, nlg
        domain = spelling.domain
        self._special = {*domain.special_slots}
        self._free = {*domain.free_slots} | self._special
        self._spoken_of = {action.slot for action in domain.actions}
        things = [spelling.lexicon.phrases.slots[slot].name for slot in domain.opening_slots]
        self._another = f"any other {things[0]} ?" if things else "anything else ?"

    def __call__(
        self,
        record: Mapping[str, str],
        text: str,
        words: dict[str, Any],
        near: Mapping[str, str] | None = None,
    ) -> Told:
        """Returns the answers to the questions of a text about a record.

        Args:
            record: the record's values by slot; empty if none is proposed or offered, when only
                what no record can answer is answered.
            text: the person's text.
            words: what determines the words.
            near: the values of the record that is nearest to the wishes, where none is proposed:
                "is that theater clean?" is about its theater.
        """
        said: list[str] = []
        rest: list[str] = []
        told: dict[str, str] = {}
        found: tuple[str, dict[str, str], bool] | None
        is_yes, is_refused, is_guess = True, False, True
        unknown = self._nlg.say("unknown_question", **words)
        full = sorted(map(fold, record.values()), key=len, reverse=True)
        short = {name.partition(" ")[0] for name in full if " " in name} - SMALL  # "the AMC"
        name = rf"(?:{'|'.join(map(re.escape, full)) or '_'})\b"
        called = rf"(?:{name}|(?:the )?(?:{'|'.join(map(re.escape, short)) or '_'})\b)"
        subject = re.compile(rf"\b(is|does) {called}(?= (?!right\b|correct\b)\w)")
        sentences = moves.sentences(text)
        for at, sentence in enumerate(sentences, 1):
            # "what time is the first matinee?" is no question about others
            is_others = bool(moves.others(re.sub(rf"\b{name}", "it", sentence)))
            about = subject.sub(r"\1 it", sentence)
            is_lighter = moves.says(sentence, "lighter")
            is_untold = is_lighter or moves.says(sentence, "untold")
            is_untold &= bool(record) or not moves.says(sentence, "nearest")
            if moves.says(sentence, "question") and is_untold:
                found = unknown, {}, True
            elif not is_others and (record or self._is_unheard(sentence, None)):
                found = self._answer(record or near or {}, about, words)
            else:
                found = None
            if self._is_refused(sentence, sentences[at:]):
                is_refused = True
                rest.append(f"not {sentence.rstrip(' ?')} .")
                continue
            if found is None or is_lighter:
                rest.append(self._another if is_lighter else sentence)
            if found is None:
                continue
            if not any(found[0] in one for one in said):
                yes = f"{self._nlg.say('yes', **words)} "
                is_again = any(one.startswith(yes) for one in said)
                said.append(found[0].removeprefix(yes) if is_again else found[0])
            told |= found[1]
            is_yes &= found[2]
            is_guess &= found[0] == unknown and not is_untold and not moves.says(sentence, "perk")
        if not said:
            return Told("", {}, " ".join(rest) if is_refused else text)
        return Told(" ".join(said), told, " ".join(rest), is_yes, is_guess)

    def _answer(
        self, record: Mapping[str, str], sentence: str, words: dict[str, Any]
    ) -> tuple[str, dict[str, str], bool] | None:
        """Returns an answer, its values, and whether it agrees; ``None`` if there is no answer."""
        is_whether = moves.says(sentence, "whether")
        is_about = is_whether or moves.says(sentence, "question", "perk")
        if not is_about or moves.accepts(sentence):
            return None
        reading = self._hear(sentence, None)
        kinds = self._spelling.lexicon.kinds
        if moves.says(sentence, "perk") and self._is_unheard(sentence, reading):
            return self._nlg.say("unknown_question", **words), {}, True
        if any(not one.candidates and kinds[one.slot] != "text" for one in reading.unclear):
            return self._nlg.say("unknown_question", **words), {}, True  # "Is the 14th a weekend?"
        meant = {slot: [value] for slot, value in reading.frame.informs.items()}
        names = self._names(reading)
        meant |= {one.slot: [*one.candidates] or [one.text] for one in names}
        if any(record.get(slot, v[0]) not in v for slot, v in meant.items() if slot in self._free):
            return None
        meant = {slot: v for slot, v in meant.items() if slot not in self._free}
        meant = {slot: v for slot, v in meant.items() if v[0] not in RESERVED_TEXT.values()}
        if is_whether and not meant:
            meant = self._named_in_part(record, sentence)
        if is_whether and meant and self._is_subject(sentence, meant):
            return self._nlg.say("unknown_question", **words), {}, True
        has = {slot: self._having(record, slot, values) for slot, values in meant.items()}
        dates = [
            slot for slot in meant if kinds[slot] == "date" and slot in record and not has[slot]
        ]
        if any(_is_numbered(record[slot]) != _is_numbered(meant[slot][0]) for slot in dates):
            return self._nlg.say("unknown_question", **words), {}, True  # "is the 14th a Saturday?"
        is_other = moves.says(sentence, "also") or self._is_of(sentence, meant)
        if is_other and not all(has.values()):
            return None
        is_guess = reading.confidence < DOUBTFUL
        is_detail = moves.says(sentence, "detail") and meant.keys().isdisjoint(self._spoken_of)
        is_detail &= is_guess or all(has[slot] or slot not in record for slot in meant)
        asked = {*reading.frame.requests} - (self._free - record.keys()) - self._special
        is_echo = bool(meant) and all(has.values())
        is_echo &= not (asked or moves.says(sentence.rstrip(" ?"), "question"))
        if is_detail or is_echo or (is_whether and meant):
            return self._whether(record, sentence, meant, has, words)
        if is_whether and not moves.says(sentence, "wh"):  # "is the theater far?" is about "far"
            named = self._spelling.named(moves.said_of(sentence), sorted(asked & {*record}))
            asked = {*named}
        elif not asked or self._hear.is_unsure(reading):
            named = self._spelling.named(sentence, sorted({*record} - self._free))
            asked = asked & {*named} or {*named[:1]}
        is_gone = moves.says(sentence, "gone")
        if moves.says(sentence, "available") and not (meant or (asked and not is_gone)):
            return self._nlg.say("no" if is_gone else "yes", **words), {}, True
        if asked and not meant:
            told = {slot: record.get(slot, NO_MATCH_TEXT) for slot in sorted(asked)}
            return self._nlg.agent(Frame("inform", told), record, **words), told, True
        if not (asked or reading.frame.informs) and (is_guess or not meant):
            return self._nlg.say("unknown_question", **words), {}, True
        return None

    def _named_in_part(self, record: Mapping[str, str], sentence: str) -> dict[str, list[str]]:
        """Returns the values that a sentence names in full, or else by a part of the record's.

        As in "is it rated great?", "is it at the grove?".
        """
        said = tokenize(sentence)
        spans = self._spelling.lexicon.full_names(said)
        own = self._free - record.keys()
        if full := {s: [" ".join(said[at:end])] for s, at, end in spans if s not in own}:
            return full
        parts = [f" {one} {other} " for one, other in pairwise(said) if other not in SMALL]
        parts += [f" {one} " for one in said if one in record.values()]
        known = product(record.keys() - self._free, parts)
        return {slot: [part.strip()] for slot, part in known if part in f" {record[slot]} "}

    def _whether(
        self,
        record: Mapping[str, str],
        sentence: str,
        meant: Mapping[str, Sequence[str]],
        has: Mapping[str, str | None],
        words: dict[str, Any],
    ) -> tuple[str, dict[str, str], bool]:
        """Returns a yes or no with the record's values, these, and whether it agrees.

        Args:
            record: the record's values by slot.
            sentence: the question.
            meant: the values that it means, by slot.
            has: the slot of the record that has one of them, by slot.
            words: what determines the words.
        """
        told = {
            own or slot: record[own or slot]
            for slot, own in has.items()
            if own or slot in record.keys() & self._spoken_of
        }
        if moves.says(sentence, "the_same"):
            same = moves.named_slots(moves.same(sentence), self._spelling.lexicon)
            told |= {slot: record[slot] for slot in same if slot in record}
        missing = [slot for slot, own in has.items() if not own]
        untold = {slot: meant[slot][0] for slot in missing if slot not in record}
        if not told:
            use = "no_promise" if untold else "unknown_question"
            return self._nlg.say(use, values=untold, **words), {}, False
        answer = self._nlg.agent(Frame("inform", told), record, **words)
        if " or " not in sentence:  # "each, or for both?" is no matter of yes or no
            lead = self._nlg.say("yes" if len(untold) == len(missing) else "no", **words)
            answer = f"{lead} {answer}"
        if untold:
            answer += f" {self._nlg.say('no_promise', values=untold, **words)}"
        return answer, told, not missing

    def _is_refused(self, sentence: str, following: Sequence[str]) -> bool:
        """Returns whether a sentence echoes a name to refuse it: "Seattle? No, in Reno"."""
        is_echo = sentence.endswith("?") and not moves.says(sentence.rstrip(" ?"), "question")
        is_else = any(moves.says(one, "something_else") for one in following)
        return is_echo and (is_else or moves.says("".join(following[:1]), "no_first"))

    def _is_unheard(self, sentence: str, reading: Understood | None) -> bool:
        """Returns whether a sentence asks whether, and it was not heard what.

        Args:
            sentence: the sentence.
            reading: its meaning; ``None`` to read it here.
        """
        if moves.says(sentence, "running") or not moves.says(sentence, "whether", "perk"):
            return False
        reading = reading or self._hear(sentence, None)
        if reading.frame.informs or self._names(reading):
            return False
        asked = {*reading.frame.requests} - self._free
        is_named = bool(asked) and asked <= {*self._spelling.named(sentence, asked)}
        is_guess = reading.frame.act == "confirm_question" or self._hear.is_unsure(reading)
        return is_guess and not is_named

    @staticmethod
    def _names(reading: Understood) -> list[Unclear]:
        """Returns the unclear names that may mean something, or all of a sure reading."""
        is_sure = reading.confidence >= DOUBTFUL
        return [one for one in reading.unclear if one.candidates or is_sure]

    def _is_subject(self, sentence: str, meant: Mapping[str, Sequence[str]]) -> bool:
        """Returns whether values are only what has something unheard: "the Regal has a bar?"."""
        said, lexicon = tokenize(sentence), self._spelling.lexicon
        verb = next((at for at, word in enumerate(said) if word in ("has", "have", "gives")), 0)
        subject = said[:verb]
        return bool(verb) and all(
            is_in(values[0], " ".join(subject))
            or lexicon.place(subject, slot, values[0]) is not None
            for slot, values in meant.items()
        )

    def _is_of(self, sentence: str, meant: Mapping[str, Sequence[str]]) -> bool:
        """Returns whether a question is of something named, as "is the 2:40 one left?"."""
        said, lexicon = tokenize(sentence), self._spelling.lexicon
        places = (lexicon.place(said, slot, values[0]) for slot, values in meant.items())
        before = (" ".join(said[: place.start]) for place in places if place is not None)
        return any(moves.says(words, "of") for words in before)

    def _having(self, record: Mapping[str, str], of: str, values: Sequence[str]) -> str | None:
        """Returns the slot of a record that has one of some values of a slot, or it in a name."""
        if f" {record.get(of)} " in f" {values[0]} ":  # "great according to"
            return of
        for slot, own in record.items():
            if any(is_in(v, own) or self._spelling.is_meant(slot, v, own) for v in values):
                return slot
        return None


def _is_numbered(date: str) -> bool:
    """Returns whether a date is in numbers, whose weekday is not known."""
    return any(map(str.isdigit, date))
