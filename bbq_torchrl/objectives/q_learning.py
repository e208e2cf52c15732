"""The base class of Q-learning losses: one-step targets, replicas, row masks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from operator import is_not
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import dispatch
from tensordict.utils import NestedKey
from torch import Tensor, nn
from torchrl.data import TensorSpec
from torchrl.data.utils import _find_action_space
from torchrl.modules import QValueActor
from torchrl.objectives import DQNLoss
from torchrl.objectives.utils import ValueEstimators

from bbq_torchrl.bayes.functional import checked_number, replicas_of
from bbq_torchrl.bayes.scope import WeightMode
from bbq_torchrl.networks.q_actor import Inputs, ValueFunction, legal_actions, masked
from bbq_torchrl.objectives.td_loss import (
    DISTANCE,
    Distance,
    margin_loss,
    normalized_weights,
    row_entry,
    td_loss,
)
from bbq_torchrl.settings import ABOVE_ZERO, PROBABILITY, check


class OneStepQLoss(DQNLoss):
    """A :class:`~torchrl.objectives.DQNLoss` for replicas of a network with uncertain weights.

    Reads a TensorDict [*replicas, *batch] with the actor's in_keys, the action, and under "next"
    the same in_keys, reward and terminated [*replicas, *batch, 1]. Each replica's loss is the mean
    over its batch. ``loss`` is their sum, so no replica's gradient depends on another's data.
    Rows can be left out: ``loss_mask_key`` (TorchRL's attribute) names an optional bool entry
    [*replicas, *batch] that is True for valid rows; the default reads TorchRL's entries and
    "valid". States and rewards of invalid rows may contain anything, including NaN.

    If the input has the entry ``next_state_value`` under "next", the loss takes the frozen
    network's values of the next states from there and runs the online network only.
    :meth:`next_state_values` computes them once per freeze for many batches.

    The actor may be any sequence of modules, see
    :func:`~bbq_torchrl.networks.q_actor.split_actor`. A recurrent state is one of its in_keys; the
    stored one under "next" belongs to the next state.

    If the input has TorchRL's entry ``steps_to_next_obs``, which its n-step transforms write, the
    value of the state n steps later is discounted by gamma ** n.

    Differences from TorchRL's loss: the target is that of TD0 without ``average_rewards``, computed
    without intermediate TensorDicts; actions are indices or one-hot; the loss sets the network's
    dropout and weight draws, not the exploration type or the training flag.

    Args:
        value_network: an actor, or a network that maps the observation to values.

    Keyword Args:
        gamma: discount of the one-step target, a number or a tensor [*replicas]. Defaults to 0.9.
        action_space: "categorical", "one-hot" or the action's spec; taken from the actor if it
            has one.
        delay_value: whether the target is a frozen copy of the network. Defaults to True.
        double_dqn: whether the online network chooses the target's action (its mean, unless a
            subclass differs). Defaults to False.
        loss_function: "l2", "l1" or "smooth_l1". Defaults to "l2".

    Raises:
        ValueError: for an invalid argument; when called, for entries of the wrong shape.
        KeyError: when called, for missing entries. A mask of legal actions may be missing only if
            the actor's ``action_mask_key`` is None.
    """

    @dataclass
    class _AcceptedKeys(DQNLoss._AcceptedKeys):
        """The keys that ``set_keys`` can change.

        Attributes:
            next_state_value: under "next", the optional values from :meth:`next_state_values`.
                Defaults to ``"next_state_value"``.
            demonstrated: the optional mask of demonstrated transitions, bool [*replicas, *batch].
                Defaults to ``"protected"``.
        """

        next_state_value: NestedKey = "next_state_value"
        demonstrated: NestedKey = "protected"

    tensor_keys: _AcceptedKeys
    default_keys = _AcceptedKeys
    out_keys = ["loss", "loss_value", "td_error", "q_value"]  # noqa: RUF012 - as in TorchRL
    SUPPORTED_VALUE_ESTIMATORS = (ValueEstimators.TD0,)
    # weight mode of targets and, in double DQN, of the choice of the target's action
    _target_mode: WeightMode = "mean"
    _scale: float | Tensor = 1.0  # factor of each row's loss; float64 if it is [*replicas]
    _kl_weight: Tensor  # factor of the KL, [*replicas]; only if _predict returns a KL
    _imitation: tuple[float, float] | None = None  # margin and factor

    def __init__(
        self,
        value_network: QValueActor | nn.Module,
        *,
        gamma: float | Tensor = 0.9,
        action_space: str | TensorSpec | None = None,
        delay_value: bool = True,
        double_dqn: bool = False,
        loss_function: Distance = "l2",
    ) -> None:
        check("loss_function", loss_function, DISTANCE)
        if isinstance(action_space, TensorSpec):
            # DQNLoss passes it to the actor of a bare network, which accepts its name only.
            action_space = _find_action_space(action_space)
        super().__init__(
            value_network,
            loss_function=loss_function,
            delay_value=delay_value,
            double_dqn=double_dqn,
            action_space=action_space,
        )
        if self.action_space not in ("categorical", "one_hot"):
            raise ValueError(
                f"action_space must be categorical or one-hot, got {self.action_space}"
            )
        self.replicas = replicas_of(self.value_network)
        gamma = checked_number("gamma", gamma, self.replicas, PROBABILITY)
        # The estimator makes a tensor itself and warns of a copy if it gets one.
        discount = gamma.tolist() if isinstance(gamma, torch.Tensor) else gamma
        device = next((parameter.device for parameter in self.parameters()), None)
        self.make_value_estimator(ValueEstimators.TD0, gamma=discount, device=device)
        self._function = ValueFunction(
            self.value_network, self.value_network_params, self.tensor_keys.action_value
        )

    def imitate(self, margin: float, factor: float) -> None:
        """Adds the large-margin loss of demonstrated transitions (Hester et al. 2018, "DQfD").

        The actions of transitions marked under the key ``demonstrated`` are to have values ahead of
        all others'. A :class:`~bbq_torchrl.data.ReplicaReplay` marks its protected rows. The
        squared errors of these transitions still count.

        Args:
            margin: the difference of values to reach, in units of Q, above 0.
            factor: factor of the mean over the batch, next to 1 for the error, above 0.

        Raises:
            ValueError: for an invalid argument.
        """
        self._imitation = check("margin", margin, ABOVE_ZERO), check("factor", factor, ABOVE_ZERO)

    # -- parameters -------------------------------------------------------------------------

    def _tensors(self) -> tuple[list[Tensor], list[Tensor]]:
        """Returns the parameters and buffers of the online and the target network."""
        # TorchRL erases attributes that begin with _cache when it casts or moves the loss. Loading
        # a state writes into the existing tensors; to_module replaces them.
        networks = [self.value_network_params]
        if self.delay_value:
            networks.append(self.target_value_network_params)
        current = [params._param_td for params in networks]
        cached = self.__dict__.get("_cache_tensors")
        if cached is None or any(map(is_not, cached[0], current)):
            cached = self.__dict__["_cache_tensors"] = (
                current,
                [*map(self._function.tensors, networks)],
            )
        online, *target = cached[1]
        # Not cached: a detached tensor keeps the old data if the parameter's data are replaced.
        return online, target[0] if target else [tensor.detach() for tensor in online]

    def __getstate__(self) -> dict[str, Any]:
        state = self.__dict__.copy()
        state.pop("_cache_tensors", None)
        return state

    # -- targets ----------------------------------------------------------------------------

    @property
    def has_fixed_targets(self) -> bool:
        """Whether the frozen network's value of a state is the same for every batch.

        It differs between batches if it depends on the online network or on noise drawn per batch.
        """
        return bool(self.delay_value) and not self.double_dqn and self._target_mode == "mean"

    @torch.no_grad()
    def next_state_values(self, tensordict: TensorDictBase) -> Tensor:
        """Returns max Q(s', ·) of the frozen network over legal actions, [*replicas, *batch, 1].

        Pass them to :meth:`forward` in the entry ``next_state_value`` under "next" until the target
        network is updated.

        Args:
            tensordict: transitions [*replicas, *batch] with the network's inputs under "next".

        Raises:
            RuntimeError: if ``has_fixed_targets`` is False.
        """
        if not self.has_fixed_targets:
            raise RuntimeError("next_state_values needs targets that are the same for every batch")
        online, target = self._tensors()
        return self._next_values(tensordict, online, target)

    # -- forward ----------------------------------------------------------------------------

    def _predict(
        self, tensors: Sequence[Tensor], inputs: Inputs
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Returns the values [*replicas, *batch, N] to train, and optionally "kl" [*replicas]."""
        return self._function(tensors, inputs, "draw"), {}

    def _target_values(self, tensors: Sequence[Tensor], inputs: Inputs) -> Tensor:
        """Returns the frozen network's values of the next state, [*replicas, *batch, N]."""
        return self._function(tensors, inputs, self._target_mode)

    @dispatch  # type: ignore[untyped-decorator]
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Returns the losses of a batch of transitions.

        Also writes the squared TD error [*replicas, *batch, 1] into the input under the priority
        key, for prioritized replay.

        Args:
            tensordict: a batch [*replicas, *batch].

        Returns:
            a TensorDict with the scalar "loss" to differentiate and, without a graph,
            "loss_value", "td_error" (mean of |Q - target|) and "q_value" (mean of Q at the
            actions taken), each [*replicas], and the entries that the subclass adds.
        """
        keys = self.tensor_keys
        online, target = self._tensors()
        reward, index = self._reward_and_index(tensordict)
        weight = normalized_weights(self, tensordict, reward)
        values, out = self._predict(online, self._inputs(tensordict, weight))
        with torch.no_grad():
            td_target = self._td_target(tensordict, online, target)
        chosen = self._rows(values), self._rows(index)
        weight = None if weight is None else self._rows(weight)
        loss_value, out["td_error"], out["q_value"], square = td_loss(
            *chosen, self._rows(td_target), weight, self.loss_function, self._scale
        )
        tensordict.set(keys.priority, square.reshape(td_target.shape), inplace=True)
        if self._imitation is not None:
            loss_value = loss_value + self._imitation_loss(tensordict, *chosen, weight, self._rows)
        penalty = out.get("kl")
        if penalty is not None:
            loss_value = loss_value + penalty * self._kl_weight
            out["kl"] = penalty.detach()
        out["loss"] = loss_value.sum() if self.replicas else loss_value
        out["loss_value"] = loss_value.detach()
        return TensorDict(out)

    def _imitation_loss(
        self,
        tensordict: TensorDictBase,
        values: Tensor,
        index: Tensor,
        weight: Tensor | None,
        rows: Callable[[Tensor], Tensor],
    ) -> Tensor | float:
        """Returns the loss of :meth:`imitate`, [*networks].

        Args:
            tensordict: a batch [*replicas, *batch].
            values: [*networks, B, N].
            index: [*networks, B, 1].
            weight: [*networks, B, 1], or None.
            rows: maps [*replicas, *batch, n] to [*networks, B, n].
        """
        assert self._imitation is not None
        margin, factor = self._imitation
        found = row_entry(tensordict, self.tensor_keys.demonstrated, tensordict.batch_size)
        if found is None:
            return 0.0
        legal = legal_actions(tensordict, self._function.action_mask_key)
        legal = None if legal is None else rows(legal)
        loss = margin_loss(values, index, legal, rows(found), weight, margin)
        return (loss * factor * self._scale).to(loss.dtype)

    def _inputs(self, tensordict: TensorDictBase, weight: Tensor | None) -> Inputs:
        """Returns the network's inputs, 0 in rows of weight 0, because NaN · 0 would be NaN."""
        ignored = None if weight is None else (weight == 0).all(-1)
        return self._function.inputs(tensordict, ignored)

    def _rows(self, tensor: Tensor) -> Tensor:
        """Returns [*replicas, *batch, features] as [*replicas, B, features]."""
        return tensor.reshape(*self.replicas, -1, tensor.shape[-1])

    def _reward_and_index(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor]:
        """Returns the reward and the index of the action, both [*replicas, *batch, 1].

        Raises:
            ValueError: if reward, action or terminated has the wrong shape.
        """
        keys = self.tensor_keys
        reward, terminated = (tensordict["next", key] for key in (keys.reward, keys.terminated))
        if reward.shape[-1:] != (1,) or terminated.shape != reward.shape:
            raise ValueError(
                f"{keys.reward!r} and {keys.terminated!r} must have shape [*batch, 1], got "
                f"{list(reward.shape)} and {list(terminated.shape)}"
            )
        action = tensordict[keys.action]
        if self.action_space == "one_hot":
            index = action.to(torch.uint8).argmax(-1, keepdim=True)
        else:
            index = action if action.ndim == reward.ndim else action.unsqueeze(-1)
        if index.shape != reward.shape:
            raise ValueError(
                f"{keys.action!r} must be {self.action_space} with batch "
                f"{list(reward.shape[:-1])}, as action_space says, got {list(action.shape)}"
            )
        return reward, index.long()

    def _td_target(
        self, tensordict: TensorDictBase, online: Sequence[Tensor], target: Sequence[Tensor]
    ) -> Tensor:
        """Returns r + γⁿ max Q(s', ·) over legal actions, r at an end, [*replicas, *batch, 1]."""
        keys, following = self.tensor_keys, tensordict["next"]
        value = following.get(keys.next_state_value, None)
        if value is None:
            value = self._next_values(tensordict, online, target)
        reward = following[keys.reward]
        estimator = self.value_estimator
        if estimator.average_rewards:
            raise ValueError("average_rewards of the value estimator must be False, got True")
        gamma = estimator.gamma
        if gamma.ndim:
            gamma = gamma.reshape(gamma.shape + (1,) * (reward.ndim - gamma.ndim))
        steps = row_entry(tensordict, estimator.tensor_keys.steps_to_next_obs, reward.shape[:-1])
        if steps is not None:
            gamma = gamma**steps
        if gamma.ndim:
            gamma = self._like_values(gamma)
        reward = self._like_values(reward)
        bootstrapped = torch.addcmul(reward, value, gamma)
        terminated = self._like_values(following[keys.terminated].bool())
        return torch.where(terminated, reward, bootstrapped)

    def _next_values(
        self, tensordict: TensorDictBase, online: Sequence[Tensor], target: Sequence[Tensor]
    ) -> Tensor:
        """Returns max Q(s', ·) over legal actions, [*replicas, *batch, 1]."""
        function = self._function
        inputs = function.inputs(tensordict["next"])
        key = function.action_mask_key
        mask = legal_actions(tensordict, None if key is None else ("next", key))
        if mask is not None:
            mask = self._like_values(mask)
        values = masked(self._target_values(target, inputs), mask)
        if not self.double_dqn:
            return values.amax(-1, keepdim=True)
        choice = masked(function(online, inputs, self._target_mode), mask)
        return values.gather(-1, choice.argmax(-1, keepdim=True))

    def _like_values(self, entry: Tensor) -> Tensor:
        """Returns an entry [*replicas, *batch, n] in a shape that broadcasts with the values."""
        return entry
