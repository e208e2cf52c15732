"""The options of ``domain=``: the subject of the dialogues."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options.registry import Option, register
from bbq_torchrl.settings import ANY_TEXT, BOOLEAN, REQUIRED, option, setting

if TYPE_CHECKING:
    from bbq_torchrl.domains import Domain


@dataclass
class DomainOption(Option):
    """The subject of the dialogues."""

    group: ClassVar[str] = "domain"

    @abstractmethod
    def make(self) -> Domain:
        """Loads the domain.

        Raises:
            ValueError or OSError: the corpus is damaged or missing.
        """


@dataclass
class ShippedDomain(DomainOption):
    """A corpus that ships with the package."""

    def make(self) -> Domain:
        """Loads the corpus."""
        from bbq_torchrl.domains import shipped_domain

        return shipped_domain(self.name)


@register
@dataclass
class MovieDomain(ShippedDomain):
    """The movie-booking corpus that ships with the package."""

    name: str = option("movie")


@register
@dataclass
class HotelDomain(ShippedDomain):
    """Rooms in hotels, with the slots of MultiWOZ's hotels and values of our making."""

    name: str = option("hotel")


@register
@dataclass
class RestaurantDomain(ShippedDomain):
    """Tables in restaurants, with the slots of MultiWOZ's restaurants and values of our making."""

    name: str = option("restaurant")


@register
@dataclass
class FolderDomain(DomainOption):
    """A domain folder: domain.yaml, knowledge_base.csv, goals.jsonl, values.json."""

    name: str = option("folder")
    path: str = setting(REQUIRED, ANY_TEXT, "the folder")

    def make(self) -> Domain:
        """Loads and validates the folder."""
        from bbq_torchrl.domains import load_domain

        return load_domain(self.path)


@register
@dataclass
class MiuLabDomain(DomainOption):
    """The public MiuLab files (TC-Bot), read safely; they are not part of this project."""

    name: str = option("miulab")
    path: str = setting(REQUIRED, ANY_TEXT, "folder of the files")
    goals: str = setting("user_goals_first_turn_template.v2.p", ANY_TEXT, "file of user goals")
    kb: str = setting("movie_kb.1k.p", ANY_TEXT, "file of the knowledge base")
    values: str = setting("dicts.v3.p", ANY_TEXT, "file of the values that errors draw from")
    skip_unusable: bool = setting(
        True, BOOLEAN, "leave out and report unusable goals, rows and slots; false: refuse them"
    )

    def make(self) -> Domain:
        """Reads the files."""
        from bbq_torchrl.domains import load_miulab

        return load_miulab(**{key: value for key, value in vars(self).items() if key != "name"})
