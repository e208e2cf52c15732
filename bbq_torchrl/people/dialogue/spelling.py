"""One spelling for each value, shared by people, agents, goals and records."""

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
    or a goal has one of them. A person who types another means the same.

    Args:
        domain: the domain, with its phrases in its folder; otherwise with the generic phrases.

    Attributes:
        domain: the domain, with its records and goals in their most frequent spelling.

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
        """Returns the values by slot in that spelling; unknown values are unchanged."""
        return {slot: self._lexicon.respell(slot, value) for slot, value in values.items()}

    def absent(self, values: Mapping[str, str]) -> dict[str, str]:
        """Returns the values that constrain a booking and that no record has."""
        return {
            slot: value
            for slot, value in values.items()
            if slot in self._recorded and fold(value) not in self._recorded[slot]
        }

    def named(
        self, text: str, slots: Iterable[str], asked: Collection[str] = ()
    ) -> tuple[str, ...]:
        """Returns the slots for which a text has a noun.

        Args:
            text: the person's text.
            slots: the slots that may be named.
            asked: the slots asked about: their nouns do not name another slot.
        """
        nouns = {slot: set(phrases.nouns) for slot, phrases in self._lexicon.phrases.slots.items()}
        spoken = set().union(*(nouns[slot] for slot in asked))
        words = set(tokenize(text))
        return tuple(
            slot for slot in slots if words & (nouns[slot] - (set() if slot in asked else spoken))
        )
