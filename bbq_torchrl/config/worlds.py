"""The keys of ``env=`` and ``domain=``: whom the agent talks with, and what about."""

from __future__ import annotations

from dataclasses import dataclass

from bbq_torchrl.config.settings import (
    ANY_TEXT,
    BOOLEAN,
    COUNT,
    NON_NEGATIVE_INTEGER,
    PROBABILITY,
    REQUIRED,
    REWARD,
    integers,
    one_of,
    option,
    optional,
    setting,
)

__all__ = [
    "DomainConfig",
    "DomainExtensionConfig",
    "EnvConfig",
    "FolderDomainConfig",
    "FullEnvConfig",
    "MiuLabDomainConfig",
    "MovieDomainConfig",
]


@dataclass
class EnvConfig:
    """The user and the channel: what every environment has."""

    name: str = REQUIRED
    slot_error_prob: float | None = setting(
        None,
        optional(PROBABILITY, "the domain's calibrated difficulty"),
        "probability that an informed slot is hit by an error",
    )
    slot_error_mode: str = setting(
        "value", one_of("value", "slot", "delete", "mixed"), "what an error does to a slot"
    )
    intent_error_prob: float = setting(0.0, PROBABILITY, "probability of a random user act")
    max_turn: int = setting(40, integers(2), "turns of a dialogue, both sides counted")
    success_reward: float = setting(40.0, REWARD, "reward of a dialogue that succeeds")
    failure_reward: float = setting(-10.0, REWARD, "reward of a dialogue that fails")
    turn_reward: float = setting(-1.0, REWARD, "reward of a turn that does not end the dialogue")
    compile_turns: bool = setting(
        False, BOOLEAN, "turns are compiled by torch.compile, which takes up to a minute"
    )
    paper_rounds: int = setting(400, COUNT, "rounds of training in the paper")


@dataclass
class FullEnvConfig(EnvConfig):
    """All slots from the start."""

    name: str = option("full")


@dataclass
class DomainExtensionConfig(EnvConfig):
    """The essential slots first; then the others one by one, in the domain's order."""

    name: str = option("domain_ext")
    start: int = setting(40, NON_NEGATIVE_INTEGER, "round in which the first new slot appears")
    every: int = setting(10, COUNT, "rounds between two new slots")
    paper_rounds: int = setting(200, COUNT, "rounds of training in the paper")


@dataclass
class DomainConfig:
    """What the dialogues are about."""

    name: str = REQUIRED


@dataclass
class MovieDomainConfig(DomainConfig):
    """The movie-booking corpus that ships with the package."""

    name: str = option("movie")


@dataclass
class MiuLabDomainConfig(DomainConfig):
    """The public MiuLab files (TC-Bot), read safely; they are not part of this project."""

    name: str = option("miulab")
    path: str = setting(REQUIRED, ANY_TEXT, "folder that holds the files")
    goals: str = setting("user_goals_first_turn_template.v2.p", ANY_TEXT, "file of user goals")
    kb: str = setting("movie_kb.1k.p", ANY_TEXT, "file of the knowledge base")
    values: str = setting("dicts.v3.p", ANY_TEXT, "file of the values that errors draw from")
    skip_unusable: bool = setting(
        True,
        BOOLEAN,
        "goals, rows and slots that cannot be used are left out and named, or refused",
    )


@dataclass
class FolderDomainConfig(DomainConfig):
    """A domain folder: domain.yaml, knowledge_base.csv, goals.jsonl, values.json."""

    name: str = option("folder")
    path: str = setting(REQUIRED, ANY_TEXT, "the folder")
