"""The study file: what a study is about, who is compared and what people do; all checked."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, fields
from functools import partial
from os.path import expanduser
from pathlib import Path
from typing import TYPE_CHECKING, Any

import yaml

from bbq_torchrl.text import FaultsError, shown

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from bbq_torchrl.domains import Domain

__all__ = ["Study", "StudyError", "Terms", "load_study"]

MAX_PARTICIPANTS = 10_000
MAX_SESSIONS = 100

_MOVIE = "movie"
_ATTAINABLE = "attainable"
_REQUIRED = ("name", "consent", "agents", "pairs", "participants")
_COUNTS = {
    "participants": (1, MAX_PARTICIPANTS),
    "sessions": (1, MAX_SESSIONS),
    "max_turns": (1, 500),
    "idle_minutes": (1, 10_080),
}


class StudyError(FaultsError):
    """A study file, or a study's data, that cannot be used."""


@dataclass(frozen=True)
class Terms:
    """What a study was declared to be before its first person.

    Attributes:
        name: of the study, shown as the pages' heading.
        consent: what people agree to, paragraphs separated by blank lines.
        agents: name to source: whatever the talker loads the agent from.
        pairs: the comparisons declared: the first agent is the one expected to be better.
        participants: how many people are wanted.
        domain: ``movie``, or a domain's folder.
        sessions: of each person, a multiple of the number of agents.
        goals: numbers of the domain's goals, from 1, that goal cards are drawn from.
        max_turns: messages of a person in a conversation.
        idle_minutes: after which an unfinished place is given to somebody else.
        ask_below: name to the confidence below which this agent asks people again, between 0
            (never) and 1; the others as their language layer does.
    """

    name: str
    consent: str
    agents: Mapping[str, str]
    pairs: tuple[tuple[str, str], ...]
    participants: int
    domain: str
    sessions: int
    goals: tuple[int, ...]
    max_turns: int
    idle_minutes: int
    ask_below: Mapping[str, float] = field(default_factory=dict)

    def text(self) -> str:
        """Returns the terms as JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def of(cls, text: str) -> Terms:
        """Returns the terms that :meth:`text` wrote."""
        content = json.loads(text)
        content["pairs"] = tuple((better, worse) for better, worse in content["pairs"])
        return cls(**{**content, "goals": tuple(content["goals"])})


@dataclass(frozen=True)
class Study:
    """A study file that has been checked.

    Attributes:
        path: of the file.
        terms: what it says.
        domain: what the conversations are about.
    """

    path: Path
    terms: Terms
    domain: Domain

    @property
    def data(self) -> Path:
        """The file that holds the study's data."""
        return data_of(self.path)


def data_of(path: Path) -> Path:
    """Returns the file that holds the data of the study file ``path``, beside it."""
    return path.with_suffix(".sqlite")


def load_study(path: str | Path) -> Study:
    """Returns the study that the file ``path`` describes.

    Args:
        path: a YAML file.

    Raises:
        OSError: the file cannot be read.
        StudyError: with every fault: key, value and what is allowed.
    """
    file = Path(expanduser(path))
    try:
        content = _content(file)
    except RecursionError:
        raise StudyError(str(file), ["it is nested too deeply"]) from None
    except (ValueError, yaml.YAMLError) as error:
        raise StudyError(str(file), [f"it cannot be read: {error}"]) from error
    reader = _Reader(file, content)
    terms = reader.terms()
    if reader.faults:
        raise StudyError(str(file), reader.faults)
    return Study(file, terms, reader.domain)


def _content(file: Path) -> dict[str, Any]:
    from bbq_torchrl.domains.specification import UniqueKeyLoader

    content = yaml.load(file.read_text(encoding="utf-8-sig"), Loader=UniqueKeyLoader)
    if not isinstance(content, dict):
        raise ValueError(f"it must be a mapping of keys to values, got {shown(content)}")
    return content


class _Reader:
    """Takes the terms out of a mapping, and notes what is wrong with each key."""

    def __init__(self, file: Path, content: Mapping[str, Any]) -> None:
        self._file, self._given = file, content
        self.faults: list[str] = []

    def terms(self) -> Terms:
        """Returns the terms, with ``None`` for what could not be read."""
        keys = [item.name for item in fields(Terms)]
        self.faults += [
            f"{shown(key)} is not a key of a study; allowed are {', '.join(keys)}"
            for key in self._given
            if key not in keys
        ]
        if missing := [key for key in _REQUIRED if key not in self._given]:
            self.faults.append(f"it lacks the keys {', '.join(missing)}")
        self._agents = self._read("agents", _agents) or {}
        self.domain = self._read("domain", self._domain, _MOVIE)
        sessions = self._read("sessions", self._sessions, max(1, len(self._agents)))
        return Terms(
            name=self._read("name", _words),
            consent=self._read("consent", _words),
            agents=self._agents,
            pairs=self._read("pairs", self._pairs),
            participants=self._read("participants", _count),
            domain=self._given.get("domain", _MOVIE),
            sessions=sessions,
            goals=self._read("goals", partial(self._goals, sessions or 1), _ATTAINABLE),
            max_turns=self._read("max_turns", _count, 20),
            idle_minutes=self._read("idle_minutes", _count, 60),
            ask_below=self._read("ask_below", self._ask_below, {}),
        )

    def _read(self, key: str, take: Callable[[str, Any], Any], default: Any = None) -> Any:
        if key in self._given or key not in _REQUIRED:
            try:
                return take(key, self._given.get(key, default))
            except FaultsError as error:
                self.faults += error.faults
            except ValueError as error:
                self.faults.append(str(error))
        return None

    def _domain(self, key: str, name: Any) -> Domain:
        from bbq_torchrl.domains import load_domain, movie_domain

        allowed = f"{key} must be {_MOVIE} or a domain's folder"
        _expect(_is_text(name), allowed, name)
        folder = self._file.parent / Path(expanduser(name))
        try:
            return movie_domain() if name == _MOVIE else load_domain(folder)
        except FileNotFoundError as error:
            raise ValueError(f"{allowed}: {error}") from error
        except FaultsError as error:
            faults = [f"{key} {shown(name)}: {fault}" for fault in error.faults]
            raise FaultsError(key, faults) from error

    def _sessions(self, key: str, value: Any) -> int:
        sessions, agents = _count(key, value), len(self._agents)
        if agents and sessions % agents:
            raise ValueError(
                f"{key} must be a multiple of the number of agents ({agents}), so that "
                f"everybody meets all agents equally often, got {sessions}"
            )
        return sessions

    def _pairs(self, key: str, value: Any) -> tuple[tuple[str, str], ...]:
        is_list = isinstance(value, list)
        _expect(is_list, f"{key} must be a list of pairs of agents, [] for none", value)
        if faults := list(_pair_faults(value, self._agents)):
            raise FaultsError(key, faults)
        return tuple((better, worse) for better, worse in value)

    def _ask_below(self, key: str, value: Any) -> dict[str, float]:
        is_known = isinstance(value, dict) and set(value) <= set(self._agents or value)
        holds = is_known and all(map(_is_probability, value.values()))
        _expect(holds, f"{key} must map agents of the study to numbers between 0 and 1", value)
        return {name: float(below) for name, below in value.items()}

    def _goals(self, sessions: int, key: str, value: Any) -> tuple[int, ...]:
        from bbq_torchrl.study.outcome import Judge

        if self.domain is None:
            return ()
        judge, goals = Judge(self.domain), self.domain.goals
        attainable = [
            number for number, goal in enumerate(goals, start=1) if judge.is_attainable(goal)
        ]
        chosen = attainable if value == _ATTAINABLE else value
        holds = isinstance(chosen, list) and all(_is_whole(n, 1, len(goals)) for n in chosen)
        allowed = f"{_ATTAINABLE} or a list of numbers between 1 and {len(goals)}"
        _expect(holds, f"{key} must be {allowed}", value)
        faults = []
        if hopeless := sorted(set(chosen) - set(attainable)):
            faults.append(
                f"{key} must be ones that some record of the domain can meet, which holds not of "
                f"{shown(hopeless)}"
            )
        if len(set(chosen)) < max(len(chosen), sessions):
            faults.append(
                f"{key} must be distinct and at least as many as sessions ({sessions}), "
                f"got {shown(chosen)}"
            )
        if faults:
            raise FaultsError(key, faults)
        return tuple(chosen)


def _expect(holds: bool, sentence: str, value: Any) -> None:
    """Refuses a value with a sentence that says what is allowed."""
    if not holds:
        raise ValueError(f"{sentence}, got {shown(value)}")


def _words(key: str, value: Any) -> str:
    _expect(_is_text(value), f"{key} must be text, not blank", value)
    return str(value.strip())


def _count(key: str, value: Any) -> int:
    low, high = _COUNTS[key]
    holds = _is_whole(value, low, high)
    _expect(holds, f"{key} must be a whole number between {low} and {high}", value)
    return int(value)


def _agents(key: str, value: Any) -> dict[str, str]:
    holds = isinstance(value, dict) and bool(value)
    holds = holds and all(map(_is_text, [*value, *value.values()]))
    _expect(holds, f"{key} must map one name or more to where the agent is, both text", value)
    return dict(value)


def _is_text(value: object) -> bool:
    return isinstance(value, str) and bool(value.strip())


def _is_whole(value: object, low: int, high: int) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and low <= value <= high


def _is_probability(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and 0 <= value <= 1


def _pair_faults(pairs: list[Any], agents: Mapping[str, str]) -> Iterator[str]:
    seen: list[set[str]] = []
    for pair in pairs:
        if not isinstance(pair, list) or len(pair) != 2 or not all(map(_is_text, pair)):
            yield f"pairs must hold pairs of two agents, got {shown(pair)}"
            continue
        if pair[0] == pair[1]:
            yield f"pairs must be of two different agents, got {shown(pair)}"
        elif set(pair) in seen:
            yield f"pairs must be declared once, got {shown(pair)} again"
        seen.append(set(pair))
        for agent in pair:
            if agents and agent not in agents:
                yield (
                    f"pairs must name agents of the study ({', '.join(agents)}), "
                    f"got {shown(agent)} in {shown(pair)}"
                )
