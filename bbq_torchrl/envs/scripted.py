"""Hand-written policies: a fixed sequence, a form to fill in, and pure chance."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from tensordict.nn import TensorDictModuleBase

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tensordict import NestedKey, TensorDictBase

__all__ = ["CarefulPolicy", "SequencePolicy", "UniformPolicy"]


class SequencePolicy(TensorDictModuleBase):
    """Plays a fixed sequence of actions, whatever happens; its last action again and again.

    Args:
        actions: the actions in order, at least one.
        turns_key: entry that counts the turns taken in the episode, int64 ``[*batch, 1]``.
        action_key: where the action is written, int64 ``[*batch]``.

    Raises:
        ValueError: if there is no action.

    Example:
        >>> from tensordict import TensorDict
        >>> policy = SequencePolicy([4, 2, 7])
        >>> policy(TensorDict(turns=torch.tensor([[0], [1], [9]]), batch_size=[3]))["action"]
        tensor([4, 2, 7])
    """

    actions: torch.Tensor

    def __init__(
        self,
        actions: Sequence[int],
        *,
        turns_key: NestedKey = "turns",
        action_key: NestedKey = "action",
    ) -> None:
        super().__init__()
        if len(actions) == 0:
            raise ValueError("actions must have at least one action, got none")
        self.turns_key, self.action_key = turns_key, action_key
        self.in_keys, self.out_keys = [turns_key], [action_key]
        self.register_buffer("actions", torch.tensor(actions, dtype=torch.int64))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the action whose turn it is."""
        turns = tensordict.get(self.turns_key).squeeze(-1)
        action = self.actions[turns.clamp(max=self.actions.shape[0] - 1)]
        return tensordict.set(self.action_key, action)


class CarefulPolicy(TensorDictModuleBase):
    """Fills in a form, answers what it is asked, completes and ends; all from flags it observes.

    It goes through its requests in order and leaves out those whose field is filled. After the last
    of them it answers the first open question, one a turn, until there is none; then it plays
    ``complete_action``, then ``end_action``. Illegal requests and answers are left out.

    Args:
        request_actions: the requests in order, ``K`` actions.
        requested_columns: for each of them the feature that flags it as the agent's last act.
        filled_columns: for each of them the feature that flags its field as filled.
        answer_actions: the answers in order of preference, ``J`` actions.
        asked_columns: for each of them the feature that flags its question as open.
        answered_column: the feature that flags that the agent's last act was an answer.
        complete_action: what to play when nothing is left to request or to answer.
        complete_column: the feature that flags that the agent's last act was ``complete_action``.
        end_action: what to play after that.
        observation_key: float ``[*batch, F]``, a flag is set where it is above 0.
        mask_key: bool ``[*batch, N]``, the legal actions; ``None`` where all are.
        action_key: where the action is written, int64 ``[*batch]``.

    Raises:
        ValueError: if a list of columns is not as long as its list of actions.
    """

    request_actions: torch.Tensor
    requested_columns: torch.Tensor
    filled_columns: torch.Tensor
    answer_actions: torch.Tensor
    asked_columns: torch.Tensor

    def __init__(
        self,
        *,
        request_actions: Sequence[int],
        requested_columns: Sequence[int],
        filled_columns: Sequence[int],
        answer_actions: Sequence[int],
        asked_columns: Sequence[int],
        answered_column: int,
        complete_action: int,
        complete_column: int,
        end_action: int,
        observation_key: NestedKey = "observation",
        mask_key: NestedKey | None = "action_mask",
        action_key: NestedKey = "action",
    ) -> None:
        super().__init__()
        columns = {
            "requested_columns": (requested_columns, request_actions),
            "filled_columns": (filled_columns, request_actions),
            "asked_columns": (asked_columns, answer_actions),
        }
        for name, (given, actions) in columns.items():
            if len(given) != len(actions):
                raise ValueError(
                    f"{name} must have one column for each of the {len(actions)} actions, "
                    f"got {len(given)}"
                )
        lists = {
            "request_actions": request_actions,
            "requested_columns": requested_columns,
            "filled_columns": filled_columns,
            "answer_actions": answer_actions,
            "asked_columns": asked_columns,
        }
        for name, values in lists.items():
            self.register_buffer(name, torch.tensor(values, dtype=torch.int64))
        self.answered_column, self.complete_column = answered_column, complete_column
        self.complete_action, self.end_action = complete_action, end_action
        self.observation_key, self.mask_key = observation_key, mask_key
        self.action_key = action_key
        self.in_keys = [observation_key] if mask_key is None else [observation_key, mask_key]
        self.out_keys = [action_key]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the action that comes next."""
        flags = tensordict.get(self.observation_key) > 0
        positions = torch.arange(self.request_actions.shape[0], device=flags.device)
        was_requested = flags[..., self.requested_columns]
        position = torch.where(was_requested, positions, -1).amax(-1, keepdim=True)
        has_answered = flags[..., self.answered_column, None]
        may_request = ~flags[..., self.filled_columns] & (positions > position) & ~has_answered
        may_answer = flags[..., self.asked_columns]
        if self.mask_key is not None:
            is_legal = tensordict.get(self.mask_key)
            may_request = may_request & is_legal[..., self.request_actions]
            may_answer = may_answer & is_legal[..., self.answer_actions]
        has_offered = flags[..., self.complete_column]
        action = torch.where(has_offered, self.end_action, self.complete_action)
        action = torch.where(
            may_answer.any(-1) & ~has_offered, _first(self.answer_actions, may_answer), action
        )
        action = torch.where(may_request.any(-1), _first(self.request_actions, may_request), action)
        return tensordict.set(self.action_key, action)


class UniformPolicy(TensorDictModuleBase):
    """Plays a legal action, all alike. Unlike TorchRL's ``RandomPolicy`` it reads the mask.

    Args:
        mask_key: bool ``[*batch, N]``, the legal actions, at least one.
        action_key: where the action is written, int64 ``[*batch]``.

    Example:
        >>> from tensordict import TensorDict
        >>> mask = torch.tensor([[False, True, False]])
        >>> UniformPolicy()(TensorDict(action_mask=mask, batch_size=[1]))["action"]
        tensor([1])
    """

    def __init__(
        self, *, mask_key: NestedKey = "action_mask", action_key: NestedKey = "action"
    ) -> None:
        super().__init__()
        self.mask_key, self.action_key = mask_key, action_key
        self.in_keys, self.out_keys = [mask_key], [action_key]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the action."""
        mask = tensordict.get(self.mask_key)
        uniform = torch.rand(mask.shape, device=mask.device)
        return tensordict.set(self.action_key, torch.where(mask, uniform, -1.0).argmax(-1))


def _first(actions: torch.Tensor, is_possible: torch.Tensor) -> torch.Tensor:
    """Returns the first possible action, int64 ``[*batch]``."""
    if actions.shape[0] == 0:
        return torch.zeros(is_possible.shape[:-1], dtype=torch.int64, device=is_possible.device)
    return actions[is_possible.to(torch.uint8).argmax(-1)]
