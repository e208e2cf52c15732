"""The study file: a study's domain, agents and tasks, all checked."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass, field, fields
from os.path import expanduser
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bbq_torchrl.people.dialogue import RULE_NAMES
from bbq_torchrl.people.study.address import ALLOWED, Address
from bbq_torchrl.settings import PROBABILITY, TEXT, WORDS, Allowed, integers
from bbq_torchrl.utils.files import read_yaml
from bbq_torchrl.utils.text import FaultsError, shown

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from bbq_torchrl.domains import Domain

_MOVIE = "movie"
_DOMAIN = f"{_MOVIE} or a domain's folder"
_ATTAINABLE = "attainable"
_DEFAULTS: dict[str, Any] = {
    "domain": _MOVIE,
    "goals": _ATTAINABLE,
    "max_turns": 20,
    "idle_minutes": 60,
    "joins_per_minute": 5,
    "retention": "",
    "url": "",
    "join_parameters": [],
    "completion_code": "",
    "completion_url": "",
    "ask_below": {},
    "control": {},
}
"""The default of ``sessions``, one with each agent, is not among them."""
_QUOTED = "yes, no, numbers and dates in quotes"
"""Without quotes, YAML reads them as something else."""
_RECRUITING = ("join_parameters", "completion_code", "completion_url")
MAY_CHANGE = ("participants", "joins_per_minute", "url", *_RECRUITING)
"""Keys that may change after the first participant joins; the others are fixed by then."""
_PARAMETER = re.compile(r"[A-Za-z_][\w-]{0,63}", re.ASCII)
_LONGEST_CODE = 200
_HTTPS = re.compile(r"https://[\w.-]+(:\d{1,5})?([/?#][!-~]*)?", re.ASCII)
_REQUIRED = ("name", "consent", "agents", "pairs", "participants")


class StudyError(FaultsError):
    """A study file or study data that cannot be used."""


@dataclass(frozen=True)
class Terms:
    """The terms of a study, declared before its first participant.

    Attributes:
        name: the study's name, shown as the pages' heading.
        consent: the consent text, with paragraphs separated by blank lines.
        agents: name to source, from which the talker loads the agent.
        pairs: the declared comparisons; the first agent of each is expected to be better.
        participants: the number of participants wanted.
        domain: ``movie``, or a domain's folder.
        sessions: the number of each participant's sessions, a multiple of the number of agents.
        goals: numbers of the domain's goals, from 1, from which goal cards are drawn.
        max_turns: the maximum number of a participant's messages in a conversation.
        idle_minutes: minutes of silence after which an unfinished place goes to somebody else.
        joins_per_minute: the number of people who may join in a minute.
        retention: the retention period of the data, for the consent page; empty to omit it.
        url: the address at which participants reach the study; empty for the server's address.
        join_parameters: names of parameters of the join link that are stored with a participant;
            the first one identifies them.
        completion_code: code that participants get at the end, or empty.
        completion_url: link that participants get at the end, or empty.
        ask_below: name to the confidence below which the agent asks again, between 0 (never) and
            1; the other agents use the threshold of their language layer.
        control: name to the agent's rules of the dialogue control; the other agents have all rules.
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
    joins_per_minute: int = _DEFAULTS["joins_per_minute"]
    retention: str = ""
    url: str = ""
    join_parameters: tuple[str, ...] = ()
    completion_code: str = ""
    completion_url: str = ""
    ask_below: Mapping[str, float] = field(default_factory=dict)
    control: Mapping[str, list[str]] = field(default_factory=dict)

    def text(self) -> str:
        """Returns the terms as JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def of(cls, text: str) -> Terms:
        """Returns the terms in the JSON of :meth:`text`."""
        content = json.loads(text)
        content["pairs"] = tuple((better, worse) for better, worse in content["pairs"])
        for key in ("goals", "join_parameters"):
            content[key] = tuple(content.get(key, ()))
        return cls(**content)


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
        content = _content(file)
    except ValueError as error:
        raise StudyError(str(file), [f"it cannot be read: {error}"]) from error
    given = {**_DEFAULTS, **content}
    agents = given["agents"] if _are_sources(given.get("agents")) else {}
    given.setdefault("sessions", max(1, len(agents)))
    wrong = _wrong_values(given, agents)
    faults = [*_key_faults(content), *wrong.values()]
    if "url" not in wrong and given["url"]:
        try:
            Address.of(given["url"])
        except ValueError as error:
            faults.append(f"url must {error}, got {shown(given['url'])}")
    if "sessions" not in wrong and agents and given["sessions"] % len(agents):
        faults.append(
            f"sessions must be a multiple of the number of agents ({len(agents)}), so that "
            f"everybody meets all agents equally often, got {given['sessions']}"
        )
    if "pairs" in content and "pairs" not in wrong:
        faults += _pair_faults(given["pairs"], agents)
    domain = None
    if "domain" not in wrong:
        try:
            domain = _domain(file, given["domain"])
        except FileNotFoundError as error:
            faults.append(f"domain must be {_DOMAIN}: {error}")
        except FaultsError as error:
            faults += [f"domain {shown(given['domain'])}: {fault}" for fault in error.faults]
    if domain is not None:
        from bbq_torchrl.people.dialogue.judge import Judge

        judge, goals = Judge(domain), enumerate(domain.goals, start=1)
        attainable = [number for number, goal in goals if judge.is_attainable(goal)]
        if given["goals"] == _ATTAINABLE:
            given["goals"] = attainable
        sessions = 1 if "sessions" in wrong else given["sessions"]
        faults += _goal_faults(given["goals"], attainable, len(domain.goals), sessions)
    if faults or domain is None:
        raise StudyError(str(file), faults)
    for key in ("name", "consent", "retention", "completion_code"):
        given[key] = given[key].strip()
    given["ask_below"] = {name: float(below) for name, below in given["ask_below"].items()}
    given |= {key: tuple(given[key]) for key in ("goals", "join_parameters")}
    given["pairs"] = tuple(map(tuple, given["pairs"]))
    return Study(file, Terms(**given), domain)


def _content(file: Path) -> dict[str, Any]:
    content = read_yaml(file.read_text(encoding="utf-8-sig"))
    if not isinstance(content, dict):
        raise ValueError(f"it must be a mapping of keys to values, got {shown(content)}")
    return content


def _key_faults(content: Mapping[str, Any]) -> Iterator[str]:
    keys = [item.name for item in fields(Terms)]
    for key in content:
        if key not in keys:
            yield f"{shown(key)} is not a key of a study; allowed are {', '.join(keys)}"
    if missing := [key for key in _REQUIRED if key not in content]:
        yield f"it lacks the keys {', '.join(missing)}"


def _wrong_values(given: Mapping[str, Any], agents: Mapping[str, str]) -> dict[str, str]:
    """Returns, by key, a sentence for each value that the key does not allow."""
    allowed = {
        **_ALLOWED,
        "ask_below": _by_agent(agents, PROBABILITY.test, "numbers between 0 and 1"),
        "control": _by_agent(agents, _are_rules, f"lists of {', '.join(RULE_NAMES)}"),
    }
    faults = {key: allowed[key].fault(key, given[key]) for key in allowed if key in given}
    return {key: fault for key, fault in faults.items() if fault is not None}


def _by_agent(agents: Mapping[str, str], holds: Callable[[Any], bool], values: str) -> Allowed:
    def test(value: Any) -> bool:
        is_known = isinstance(value, dict) and set(value) <= set(agents or value)
        return is_known and all(map(holds, value.values()))

    return Allowed(f"a mapping of agents of the study to {values}", test)


def _are_rules(value: Any) -> bool:
    return isinstance(value, list) and all(name in RULE_NAMES for name in value)


def _domain(file: Path, name: str) -> Domain:
    from bbq_torchrl.domains import load_domain, movie_domain

    return movie_domain() if name == _MOVIE else load_domain(file.parent / expanduser(name))


def _goal_faults(chosen: Any, attainable: list[int], count: int, sessions: int) -> Iterator[str]:
    if not (isinstance(chosen, list) and all(map(integers(1, count).test, chosen))):
        allowed = f"{_ATTAINABLE} or a list of numbers between 1 and {count}"
        yield f"goals must be {allowed}, got {shown(chosen)}"
        return
    if hopeless := sorted(set(chosen) - set(attainable)):
        yield (
            f"goals must be ones that some record of the domain can meet, which holds not of "
            f"{shown(hopeless)}"
        )
    if len(set(chosen)) < max(len(chosen), sessions):
        yield (
            f"goals must be distinct and at least as many as sessions ({sessions}), "
            f"got {shown(chosen)}"
        )


def _are_sources(value: Any) -> bool:
    is_map = isinstance(value, dict) and value != {}
    return is_map and all(map(WORDS.test, [*value, *value.values()]))


def _are_parameters(value: Any) -> bool:
    return (
        isinstance(value, list)
        and all(isinstance(name, str) and _PARAMETER.fullmatch(name) for name in value)
        and len(set(value)) == len(value) <= 20
    )


def _pair_faults(pairs: list[Any], agents: Mapping[str, str]) -> Iterator[str]:
    seen: list[set[str]] = []
    for pair in pairs:
        if not isinstance(pair, list) or len(pair) != 2 or not all(map(WORDS.test, pair)):
            yield f"pairs must hold pairs of two agents, both text ({_QUOTED}), got {shown(pair)}"
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


_ALLOWED = {
    "name": WORDS,
    "consent": WORDS,
    "agents": Allowed(
        f"a mapping of one name or more to where the agent is, both text ({_QUOTED})", _are_sources
    ),
    "pairs": Allowed(
        "a list of pairs of agents, [] for none", lambda value: isinstance(value, list)
    ),
    "domain": Allowed(_DOMAIN, WORDS.test),
    "participants": integers(1, 10_000),
    "sessions": integers(1, 100),
    "max_turns": integers(1, 500),
    "idle_minutes": integers(1, 10_080),
    "joins_per_minute": integers(1, 10_000),
    "retention": Allowed("text: until when the data are kept", TEXT.test),
    "url": Allowed(ALLOWED, TEXT.test),
    "join_parameters": Allowed(
        "a list of distinct names of parameters, such as [PROLIFIC_PID]: letters, digits, _ and -",
        _are_parameters,
    ),
    "completion_code": Allowed(
        f"text of at most {_LONGEST_CODE} characters (numbers in quotes)",
        lambda value: isinstance(value, str) and len(value) <= _LONGEST_CODE,
    ),
    "completion_url": Allowed(
        "a link that begins with https://, without spaces",
        lambda value: value == "" or (isinstance(value, str) and bool(_HTTPS.fullmatch(value))),
    ),
}
"""The values that each key allows, except for ``ask_below`` and ``control``."""
