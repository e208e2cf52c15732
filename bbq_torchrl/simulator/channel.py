"""What lies between the user's mouth and the tracker's ear."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

if TYPE_CHECKING:
    import torch
    from tensordict import TensorDictBase

    from bbq_torchrl.simulator.tracker import AgentTurn

__all__ = ["Channel", "Utterance"]


@dataclass(frozen=True)
class Utterance:
    """What a user says in a turn, or what is heard of it.

    Args:
        act: long ``[*B]``, the act.
        informs: long ``[*B, S]``, the values informed.
        requests: bool ``[*B, S]``, the slots that the user asks for.
        repeats: long ``[*B]``, of what is heard: how often the user was asked to say it again;
            ``None``: never.
    """

    act: torch.Tensor
    informs: torch.Tensor
    requests: torch.Tensor
    repeats: torch.Tensor | None = None


class Channel(Protocol):
    """Turns what users say into what the tracker hears.

    Attributes:
        slot_draws: names of the uniform numbers ``[*B, S]`` that a turn is heard by.
        draws: names of those of a turn that are ``[*B]``.
        mishears_all: whether the opening and requests can be misheard as well. Then the opening
            needs the same numbers as a turn, and the tracker keeps requests until they are
            answered.
    """

    slot_draws: tuple[str, ...]
    draws: tuple[str, ...]
    mishears_all: bool

    def to(self, device: torch.device | str) -> Channel:
        """Returns the same channel with every tensor on ``device``."""

    def transmit(
        self,
        said: Utterance,
        agent: AgentTurn | None,
        before: torch.Tensor,
        is_silent: torch.Tensor,
        draws: TensorDictBase,
        active: torch.Tensor,
    ) -> Utterance:
        """Returns what is heard.

        Args:
            said: what the users say.
            agent: what the agent has said before; ``None`` at the opening.
            before: long ``[*B]``, the act heard in the turn before; at the opening the one said.
            is_silent: bool ``[*B]``, dialogues that have ended: there ``said.act`` is heard.
            draws: what :attr:`slot_draws` and :attr:`draws` name.
            active: bool ``[S]``, the slots that can be heard.
        """
