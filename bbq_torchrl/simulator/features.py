"""The agent's features, their layout and computation from a state, and the rewards of a turn."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from torch import Tensor

from bbq_torchrl.domains import DomainTensors
from bbq_torchrl.domains.tensors import Movable, one_hot, rows
from bbq_torchrl.domains.values import NONE
from bbq_torchrl.settings import REWARD, check
from bbq_torchrl.simulator.knowledge_base import KnowledgeBase

TURN_SCALE = 10.0  # acts; keeps the turn feature near the size of the flags
COUNT_SCALE = 100.0  # records


class FeatureLayout:
    """The positions and names of the features.

    There are ``2 A + 7 S + 3 + T`` features for ``A`` acts, ``S`` slots and a one-hot turn of width
    ``T``. The order is that of Li et al. (2016), the list and the total of 268 those of Lipton et
    al. (2018).

    ===================  =======================================================================
    group                the features are
    ===================  =======================================================================
    ``user_act``         the act heard from the user
    ``user_informed``    the slots that the user informed in its last act
    ``user_requested``   the slots that the user is heard to request
    ``agent_act``        the agent's last act; all 0 in the first state
    ``agent_informed``   the slots that the agent's last act informed
    ``agent_requested``  the slot that the agent's last act requested
    ``filled``           the slots for which the tracker holds a value
    ``turn``             acts of both sides so far, divided by 10
    ``turn_onehot``      acts so far as one-hot, clamped to the last feature
    ``kb_match``         whether the kb_count of the same name is above 0
    ``kb_count``         number of records / 100: with the slot's value if it is filled, else
                         with all values held
    ===================  =======================================================================

    Args:
        domain: the domain's tensors.

    Attributes:
        groups: the act, slot or number of each feature by group, in order.
        size: the number of features.
        names: the name of each feature, ``"group:member"``.

    Examples:
        >>> from bbq_torchrl.domains import movie_domain, tensorize
        >>> layout = FeatureLayout(tensorize(movie_domain()))
        >>> layout.size
        268
        >>> layout["user_act"]
        slice(0, 11, None)
        >>> layout.column("user_requested", "theater")
        62
        >>> layout.names[62]
        'user_requested:theater'
    """

    def __init__(self, domain: DomainTensors) -> None:
        acts, slots = tuple(domain.act), tuple(domain.slot)
        self._slots = slots
        self.groups = {
            "user_act": acts,
            "user_informed": slots,
            "user_requested": slots,
            "agent_act": acts,
            "agent_informed": slots,
            "agent_requested": slots,
            "filled": slots,
            "turn": ("scaled",),
            "turn_onehot": tuple(map(str, range(domain.turn_width))),
            "kb_match": (*slots, "all"),
            "kb_count": (*slots, "all"),
        }
        self.names = tuple(
            f"{group}:{member}" for group, members in self.groups.items() for member in members
        )
        self.size = len(self.names)
        self._columns = {name: index for index, name in enumerate(self.names)}

    def __getitem__(self, name: str) -> slice:
        """Returns the slice of a group's features."""
        first = self.column(name, self.groups[name][0])
        return slice(first, first + len(self.groups[name]))

    def __iter__(self) -> Iterator[str]:
        return iter(self.groups)

    def active(self, slots: Tensor) -> Tensor:
        """Returns the features that can differ from 0, bool ``[F]``: all but inactive slots'.

        Args:
            slots: the active slots, bool ``[S]``.
        """
        features = slots.new_ones(self.size)
        for group, members in self.groups.items():
            if members[: len(slots)] == self._slots:
                first = self[group].start
                features[first : first + len(slots)] = slots
        return features

    def column(self, group: str, member: str) -> int:
        """Returns the index of one feature.

        Raises:
            KeyError: if the feature does not exist.
        """
        return self._columns[f"{group}:{member}"]


class Features(Movable):
    """The function from states to features.

    Args:
        domain: the domain's tensors.
        knowledge_base: the domain's records.
    """

    def __init__(self, domain: DomainTensors, knowledge_base: KnowledgeBase) -> None:
        self.layout = FeatureLayout(domain)
        self._knowledge_base = knowledge_base
        self._n_acts = domain.n_acts
        self._turn_onehot = torch.eye(
            domain.turn_width, dtype=torch.float32, device=domain.records.device
        )

    def __call__(self, state: TensorDictBase, active: Tensor) -> Tensor:
        """Returns the features, float32 ``[*B, F]``.

        Args:
            state: the simulator's state.
            active: bool ``[S]``; knowledge-base features of inactive slots are 0.
        """
        held = state["held"]
        is_filled = held != NONE
        # The user's first act counts as one; each later turn adds an act of each side.
        acts = state["turn"] + 1
        flags = torch.cat(
            [
                one_hot(state["heard_act"], self._n_acts),
                state["user_informs"] != NONE,
                state["heard_requests"],
                one_hot(state["agent_act"], self._n_acts),
                state["agent_informs"] != NONE,
                state["agent_requests"],
                is_filled,
            ],
            dim=-1,
        )
        everything = self._knowledge_base.matching_counts(held)[..., None]
        by_slot = torch.where(is_filled, self._knowledge_base.value_counts(held), everything)
        counts = torch.cat([by_slot * active, everything], dim=-1).float()
        return torch.cat(
            [
                flags.float(),
                acts[..., None].float() / TURN_SCALE,
                rows(self._turn_onehot, acts.clamp(max=self._turn_onehot.shape[0] - 1)),
                counts.clamp(max=1.0),
                counts / COUNT_SCALE,
            ],
            dim=-1,
        )


@dataclass(frozen=True)
class Rewards:
    """The rewards of a turn (Lipton et al., 2018).

    Args:
        success: reward of the turn that ends a dialogue in success.
        failure: reward of the turn that ends it otherwise, running out of turns included.
        turn: reward of every other turn.

    Raises:
        ValueError: if a reward is not finite.
    """

    success: float = 40.0
    failure: float = -10.0
    turn: float = -1.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            check(f"the reward for {name}", value, REWARD)

    def of(self, was_done: Tensor, is_done: Tensor, success: Tensor) -> Tensor:
        """Returns the reward of a turn, float32 ``[*B]``; 0 if the dialogue was over before.

        Args:
            was_done: bool ``[*B]``, before the turn.
            is_done: bool ``[*B]``, after the turn.
            success: bool ``[*B]``, whether the turn ends in success.
        """
        at_end = torch.where(success, self.success, self.failure)
        reward = torch.where(was_done, 0.0, torch.where(is_done, at_end, self.turn))
        return reward.float()  # torch.where on numbers returns torch's default dtype
