"""Who understands and speaks for a domain: the own language layer, or an endpoint."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.language import (
    Endpoint,
    EndpointGenerator,
    EndpointUnderstander,
    Generator,
    Understander,
    load_phrases,
)
from bbq_torchrl.language.kept import kept_understander

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from bbq_torchrl.chat.partner import Ears, Mouth
    from bbq_torchrl.domains import Domain

__all__ = ["make_ears", "make_mouth", "slot_names"]


def make_ears(
    domain: Domain,
    *,
    file: Path | None = None,
    labeled: Path | None = None,
    endpoint: Endpoint | None = None,
    tell: Callable[[str], None] = lambda _: None,
) -> Ears:
    """Returns who understands people.

    Without a file it is :func:`~bbq_torchrl.language.kept.kept_understander`.

    Args:
        domain: what is spoken of, with its phrases in its folder; of none, the generic ones.
        file: of an understander that was trained before.
        labeled: own labeled lines to learn from as well.
        endpoint: who is asked first.
        tell: is told when training begins, which takes a minute.

    Raises:
        ValueError or OSError: a file that cannot be used.
        ModuleNotFoundError: the extra ``language`` is not installed.
    """
    if file is not None:
        own = Understander.load(file, domain)
    else:
        own = kept_understander(domain, labeled, tell)
    return own if endpoint is None else EndpointUnderstander(endpoint, own)


def make_mouth(domain: Domain, endpoint: Endpoint | None = None) -> Mouth:
    """Returns who says what an agent means.

    Args:
        domain: as of :func:`make_ears`.
        endpoint: who is asked first.
    """
    own = Generator(domain)
    return own if endpoint is None else EndpointGenerator(endpoint, own)


def slot_names(domain: Domain) -> dict[str, str]:
    """Returns how people call the slots of a domain."""
    return {slot: entry.name for slot, entry in load_phrases(domain).slots.items()}
