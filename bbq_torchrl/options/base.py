"""What every option is: one dataclass in one file, ours and others'.

It has its keys with default, bounds and meaning
(:func:`~bbq_torchrl.options.settings.setting`), what it needs or offers, and how it is made.
The package of each group says what an option of the group is. Importing an option does not import
torch: making it does.
"""

from __future__ import annotations

from abc import ABC
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options.settings import REQUIRED

if TYPE_CHECKING:
    from bbq_torchrl.options.root import Config


@dataclass
class Option(ABC):
    """One choice of a group of the configuration.

    A class is made an option by :func:`~bbq_torchrl.options.register`; its field ``name`` says
    which (:func:`~bbq_torchrl.options.settings.option`).

    Attributes:
        group: the group that it belongs to; set by the base class of the group.
    """

    name: str = REQUIRED

    group: ClassVar[str]

    def check(self, config: Config) -> None:  # noqa: B027 (most have nothing to refuse)
        """Refuses what cannot be combined; each value alone has been checked by then.

        Raises:
            ConfigError: one sentence that names the key, its value and what is allowed.
        """
