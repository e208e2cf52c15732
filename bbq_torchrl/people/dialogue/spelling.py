"""One spelling for each value, in which people and agents, goals and records agree."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from bbq_torchrl.domains.values import RESERVED_TEXT, fold
from bbq_torchrl.people.language.lexicon import Lexicon
from bbq_torchrl.people.language.words import tokenize

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

    from bbq_torchrl.domains import Domain


_RESERVED = frozenset(fold(text) for text in RESERVED_TEXT.values())


class Spelling:
    """The one spelling that each value of a domain has in a conversation.

    Corpora spell some values in several ways ("7:30pm" and "7:30 pm", "2" and "two"), and a record
    or a goal has one of them. Whoever types the other means the same.

    Args:
        domain: what is spoken of, with its phrases in its folder; of none, the generic ones.

    Attributes:
        domain: the same, its records and goals in that spelling: the one that most of them have.

    Examples:
        >>> from bbq_torchrl.domains import movie_domain
        >>> domain = movie_domain()
        >>> spelling = Spelling(domain)
        >>> spelling.of({"numberofpeople": "two", "starttime": "2:15pm", "city": "nowhere"})
        {'numberofpeople': '2', 'starttime': '2:15 pm', 'city': 'nowhere'}
    """

    def __init__(self, domain: Domain) -> None:
        self._lexicon = Lexicon(domain)
        self.domain = replace(
            domain,
            records=tuple(map(self.of, domain.records)),
            goals=tuple(
                replace(goal, constraints=self.of(goal.constraints)) for goal in domain.goals
            ),
        )
        self._recorded: dict[str, set[str]] = {}
        for record in self.domain.records:
            for slot in record.keys() - set(domain.free_slots):
                self._recorded.setdefault(slot, set(_RESERVED)).add(fold(record[slot]))

    def of(self, values: Mapping[str, str]) -> dict[str, str]:
        """Returns slot to value in that spelling; values that the domain has not, as they are."""
        return {slot: self._lexicon.respell(slot, value) for slot, value in values.items()}

    def absent(self, values: Mapping[str, str]) -> dict[str, str]:
        """Returns those of some values that constrain a booking, and that no record has."""
        return {
            slot: value
            for slot, value in values.items()
            if slot in self._recorded and fold(value) not in self._recorded[slot]
        }

    def named(
        self, text: str, slots: Iterable[str], asked: Collection[str] = ()
    ) -> tuple[str, ...]:
        """Returns those of some slots that a text has a noun of.

        Args:
            text: what a person typed.
            slots: that may be named.
            asked: slots that were spoken of: their nouns do not name another slot.
        """
        nouns = {slot: set(phrases.nouns) for slot, phrases in self._lexicon.phrases.slots.items()}
        spoken = set().union(*(nouns[slot] for slot in asked))
        words = set(tokenize(text))
        return tuple(
            slot for slot in slots if words & (nouns[slot] - (set() if slot in asked else spoken))
        )
