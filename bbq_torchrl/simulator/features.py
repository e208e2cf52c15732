"""The features that the agent sees: their layout, and those of a state."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import torch

from bbq_torchrl.domains.values import NONE
from bbq_torchrl.simulator.choices import one_of, rows

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tensordict import TensorDictBase

    from bbq_torchrl.domains import DomainTensors
    from bbq_torchrl.simulator.knowledge_base import KnowledgeBase

TURN_SCALE = 10.0  # acts; keeps the turn feature near the size of the flags
COUNT_SCALE = 100.0  # records


class FeatureGroup(NamedTuple):
    """A run of features of one kind.

    Args:
        name: what the group is called.
        members: what each of its features is about.
        meaning: what the features are, in a sentence.
    """

    name: str
    members: tuple[str, ...]
    meaning: str


class FeatureLayout:
    """Says which feature is where: the one table that code, tests and docs read.

    ``2 A + 7 S + 3 + T`` features for ``A`` acts, ``S`` slots and a one-hot turn of width ``T``;
    Li et al. (2016) have the order, Lipton et al. (2018) the list and the total of 268.

    Args:
        domain: the domain's tensors.

    Attributes:
        groups: the runs of features of one kind.
        size: how many features there are.
        names: the features by name, ``"group:member"``.

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
        self.groups = (
            FeatureGroup("user_act", acts, "the act heard from the user"),
            FeatureGroup(
                "user_informed", slots, "the slots that the user informed in its last act"
            ),
            FeatureGroup("user_requested", slots, "the slots that the user is heard to ask for"),
            FeatureGroup("agent_act", acts, "the agent's last act, none in the first state"),
            FeatureGroup("agent_informed", slots, "the slots that the agent's last act informed"),
            FeatureGroup("agent_requested", slots, "the slot that the agent's last act requested"),
            FeatureGroup("filled", slots, "the slots that the tracker holds a value of"),
            FeatureGroup("turn", ("scaled",), "acts so far, of both sides, divided by 10"),
            FeatureGroup(
                "turn_onehot",
                tuple(str(count) for count in range(domain.turn_width)),
                "acts so far as one-hot, clamped at the end",
            ),
            FeatureGroup(
                "kb_match", (*slots, "all"), "whether the count of the same name is above 0"
            ),
            FeatureGroup(
                "kb_count",
                (*slots, "all"),
                "records / 100: of a filled slot those with its value; "
                "of any other, and in 'all', those that match everything held",
            ),
        )
        self._slices: dict[str, slice] = {}
        start = 0
        for group in self.groups:
            self._slices[group.name] = slice(start, start + len(group.members))
            start += len(group.members)
        self.size = start
        self.names = tuple(
            f"{group.name}:{member}" for group in self.groups for member in group.members
        )

    def __getitem__(self, name: str) -> slice:
        """Returns where the group's features are."""
        if name not in self._slices:
            raise KeyError(f"{name!r} is no group of features; there are {', '.join(self._slices)}")
        return self._slices[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._slices)

    def active(self, slots: torch.Tensor) -> torch.Tensor:
        """Returns which features can differ from 0, bool ``[F]``: all but those of inactive slots.

        Args:
            slots: the active slots, bool ``[S]``.
        """
        features = slots.new_ones(self.size)
        for group in self.groups:
            if group.members[: len(slots)] == self._slots:
                first = self[group.name].start
                features[first : first + len(slots)] = slots
        return features

    def column(self, group: str, member: str) -> int:
        """Returns the index of one feature.

        Raises:
            KeyError: if there is no such feature.
        """
        within, name = self[group], f"{group}:{member}"
        names = self.names[within]
        if name not in names:
            members = ", ".join(known.partition(":")[2] for known in names)
            raise KeyError(f"{member!r} is no feature of {group!r}, which has {members}")
        return within.start + names.index(name)


class Features:
    """Turns states into what the agent sees.

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

    def __call__(self, state: TensorDictBase, active: torch.Tensor) -> torch.Tensor:
        """Returns the features, float32 ``[*B, F]``.

        Args:
            state: the simulator's state.
            active: bool ``[S]``; the knowledge-base features of the other slots are 0.
        """
        held = state["held"]
        is_filled = held != NONE
        # The user's first act counts one, each later turn adds the agent's and the user's.
        acts = state["turn"] + 1
        flags = torch.cat(
            [
                one_of(state["heard_act"], self._n_acts),
                state["user_informs"] != NONE,
                state["heard_requests"],
                one_of(state["agent_act"], self._n_acts),
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
