"""The study file: a study's domain, agents, tasks and address, all checked."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from os.path import expanduser
from pathlib import Path
from typing import Any

from bbq_torchrl.domains import Domain
from bbq_torchrl.domains.folder import SHIPPED, named_domain
from bbq_torchrl.people.dialogue.judge import Judge
from bbq_torchrl.settings import (
    PROBABILITY,
    REQUIRED,
    TEXT,
    TEXTS,
    WORDS,
    Allowed,
    faults,
    integers,
    optional,
    or_text,
    setting,
)
from bbq_torchrl.utils.files import read_yaml
from bbq_torchrl.utils.text import FaultsError, sentence, shown

_ATTAINABLE = "attainable"
_QUOTED = "both text (yes, no, numbers and dates in quotes)"  # YAML reads others as something else

_RECRUITING = ("join_parameters", "completion_code", "completion_url")
MAY_CHANGE = ("participants", "contact", "url", *_RECRUITING)
"""Keys that may change after the first participant joins; the others are fixed by then."""


class StudyError(FaultsError):
    """A study file or study data that cannot be used."""


_PATTERN = re.compile(
    r"(https?://(?:\[[0-9a-f:.]+\]|[\w.-]+)(?::\d{1,5})?)((?:/[\w.~-]+)*)/?",
    re.ASCII | re.IGNORECASE,
)


@dataclass(frozen=True)
class Address:
    """The address at which people reach a study.

    Attributes:
        origin: scheme, host and port, as browsers send them: ``https://lab.example``; empty if
            it comes from the ``Host`` of a request.
        prefix: path prefix of all pages, without a trailing slash: ``/study``.
    """

    origin: str = ""
    prefix: str = ""

    @classmethod
    def of(cls, url: str) -> Address:
        """Returns the address that a URL of :data:`ADDRESS` names.

        Examples:
            >>> Address.of("https://Lab.example/study/")
            Address(origin='https://lab.example', prefix='/study')
        """
        found = _PATTERN.fullmatch(url)
        return cls(found[1].lower(), found[2]) if found else cls()

    def link(self, path: str) -> str:
        """Returns the link to a page."""
        return f"{self.origin}{self.prefix}{path}"

    def inner(self, path: str) -> str:
        """Returns the page's path from a request's path, with or without the prefix.

        Examples:
            >>> address = Address.of("https://lab.example/study")
            >>> address.inner("/study/p/x/"), address.inner("/p/x")
            ('/p/x', '/p/x')
        """
        if path.startswith(f"{self.prefix}/"):
            path = path.removeprefix(self.prefix)
        return path.rstrip("/") or "/"


ADDRESS = Allowed(
    "an address such as https://lab.example/study/",
    lambda value: isinstance(value, str) and (value == "" or bool(_PATTERN.fullmatch(value))),
)
"""The values of a study's ``url``."""


def _is_pair(value: Any) -> bool:
    return isinstance(value, list) and all(map(WORDS.test, value)) and len(set(value)) == 2


def _by_agent(text: str, test: Callable[[Any], bool]) -> Allowed:
    return Allowed(
        f"a mapping of agents of the study to {text}",
        lambda value: isinstance(value, dict) and all(map(test, value.values())),
    )


_AGENTS = Allowed(
    f"a mapping of one name or more to where the agent is, {_QUOTED}",
    lambda value: (
        isinstance(value, dict)
        and value != {}
        and all(map(WORDS.test, chain(value, value.values())))
    ),
)
_PAIRS = Allowed(
    f"a list of pairs of two different agents, {_QUOTED}, [] for none",
    lambda value: isinstance(value, list) and all(map(_is_pair, value)),
)
_NUMBERS = Allowed(
    "a list of goal numbers, from 1",
    lambda value: isinstance(value, list) and all(map(integers(1).test, value)),
)
_LINK = Allowed(
    "a link that begins with https://",
    lambda value: value == "" or (isinstance(value, str) and value.startswith("https://")),
)


@dataclass(frozen=True)
class Terms:
    """The terms of a study, declared before its first participant: the keys of its file."""

    name: str = setting(REQUIRED, WORDS, "heading of every page")
    consent: str = setting(REQUIRED, WORDS, "the text participants agree to, in paragraphs")
    contact: str = setting(REQUIRED, WORDS, "whom participants ask, such as a mail address")
    agents: Mapping[str, str] = setting(REQUIRED, _AGENTS, "name to source, for the talker")
    pairs: Sequence[Sequence[str]] = setting(
        REQUIRED, _PAIRS, "the comparisons to test; the first is expected to be better"
    )
    participants: int = setting(REQUIRED, integers(1, 10_000), "target number of participants")
    domain: str = setting("movie", WORDS, "a shipped domain, or a domain's folder")
    sessions: int = setting(
        None,
        optional(integers(1, 100), "one with each agent"),
        "conversations per participant, a multiple of the number of agents",
    )
    goals: Sequence[int] = setting(
        _ATTAINABLE, or_text(_NUMBERS, _ATTAINABLE), "the goals that cards are drawn from"
    )
    max_turns: int = setting(20, integers(1, 500), "a participant's messages per conversation")
    idle_minutes: int = setting(
        60, integers(1, 10_080), "silence after which an unfinished place goes to somebody else"
    )
    retention: str = setting("", TEXT, "until when the data are kept, for the consent page")
    url: str = setting("", ADDRESS, "the public address; the server's own if empty")
    join_parameters: Sequence[str] = setting(
        [], TEXTS, "parameters of the join link to store; the first is the participant's id"
    )
    completion_code: str = setting("", TEXT, "code shown at the end")
    completion_url: str = setting("", _LINK, "link shown at the end")
    ask_below: Mapping[str, float] = setting(
        {},
        _by_agent("numbers between 0 and 1", PROBABILITY.test),
        "name to the confidence below which this agent says back what it heard",
    )
    control: Mapping[str, Sequence[str]] = setting(
        {},
        _by_agent("lists of rules", TEXTS.test),
        "name to this agent's rules of the dialogue control; all rules for others",
    )


@dataclass(frozen=True)
class Study:
    """A checked study file.

    Attributes:
        path: the study file.
        terms: the study's terms.
        domain: the domain of the conversations.
    """

    path: Path
    terms: Terms
    domain: Domain

    @property
    def data(self) -> Path:
        """The file of the study's data."""
        return data_of(self.path)


def data_of(path: Path) -> Path:
    """Returns the data file of the study file ``path``, in the same folder."""
    return path.with_suffix(".sqlite")


def load_study(path: str | Path) -> Study:
    """Returns the study that the file ``path`` describes.

    Args:
        path: a YAML file.

    Raises:
        OSError: the file cannot be read.
        StudyError: if the file has faults; it lists each with key, value and what is allowed.
    """
    file = Path(expanduser(path))
    try:
        content = read_yaml(file.read_text(encoding="utf-8-sig"))
    except ValueError as error:
        raise StudyError(str(file), [f"it cannot be read: {error}"]) from error
    if not isinstance(content, dict):
        raise StudyError(str(file), ["it must be a mapping of keys"])
    if found := faults(Terms, content):
        raise StudyError(str(file), list(found.values()))
    terms = Terms(**content)
    try:
        domain = named_domain(terms.domain, file.parent)
    except (FileNotFoundError, ValueError) as error:
        text = f"domain must be {', '.join(SHIPPED)}, or a domain's folder: {sentence(error)}"
        raise StudyError(str(file), [text]) from error
    judge, goals = Judge(domain), enumerate(domain.goals, start=1)
    attainable = [number for number, goal in goals if judge.is_attainable(goal)]
    terms = replace(
        terms,
        sessions=terms.sessions or len(terms.agents),
        goals=attainable if isinstance(terms.goals, str) else terms.goals,
    )
    if combined := list(_combination_faults(terms, attainable)):
        raise StudyError(str(file), combined)
    return Study(file, terms, domain)


def _combination_faults(terms: Terms, attainable: Sequence[int]) -> Iterator[str]:
    """Yields a sentence for each key that does not go with the others or with the domain."""
    agents = ", ".join(terms.agents)
    named = {"pairs": chain(*terms.pairs), "ask_below": terms.ask_below, "control": terms.control}
    for key, names in named.items():
        if unknown := [name for name in names if name not in terms.agents]:
            yield f"{key} must name agents of the study ({agents}), got {shown(unknown)}"
    if terms.sessions % len(terms.agents):
        yield (
            f"sessions must be a multiple of the number of agents ({len(terms.agents)}), so that "
            f"everybody meets all agents equally often, got {terms.sessions}"
        )
    if hopeless := sorted(set(terms.goals) - set(attainable)):
        yield f"goals must be ones of the domain that some record can meet, got {shown(hopeless)}"
    if len(set(terms.goals)) < max(len(terms.goals), terms.sessions):
        yield (
            f"goals must be distinct and at least as many as sessions ({terms.sessions}), "
            f"got {shown(terms.goals)}"
        )
