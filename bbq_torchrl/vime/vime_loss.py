"""A Q-learning loss and a dynamics loss on the same batches (VIME, Houthooft et al. 2016)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
from tensordict.nn import dispatch
from torch import Tensor, nn
from torchrl.objectives import LossModule

from bbq_torchrl.protocols import BeginsEpochs, UsesNumData, provides

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tensordict import TensorDictBase
    from tensordict.utils import NestedKey
    from torchrl.objectives.value import ValueEstimatorBase

    from bbq_torchrl.vime.dynamics_loss import DynamicsLoss


class VIMELoss(LossModule):
    """Runs a Q-learning loss and a :class:`DynamicsLoss` on the same batch.

    The two have no parameter in common, so that an optimizer that works weight by weight (Adam)
    trains both by the sum exactly as if they were apart. Everything that a loss has besides
    (target parameters for TorchRL's target updaters, ``value_network``, keys, the value
    estimator) is the Q-learning loss's.

    Args:
        q_loss: the loss of the Q-network, such as :class:`BBQNLoss` or :class:`DropoutDQNLoss`;
            one that returns what is to be differentiated as "loss", and not, as TorchRL's
            ``DiscreteCQLLoss`` does, in parts.
        dynamics_loss: the loss of the dynamics model.

    Keyword Args:
        dynamics_every: the dynamics learn on every how manieth batch; on the others their last
            losses are reported again. The count is part of the state, and :meth:`begin_epoch`
            starts it again. Defaults to 1.

    Raises:
        ValueError: if ``dynamics_every`` is not positive, or the losses have parameters in common.
        KeyError: when called, if ``q_loss`` returns no "loss".

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from torchrl.data import Categorical
        >>> from torchrl.objectives import HardUpdate
        >>> from bbq_torchrl.networks import FlatMLP, q_actor
        >>> from bbq_torchrl.vime import DynamicsModel
        >>> from bbq_torchrl.objectives import DropoutDQNLoss
        >>> from bbq_torchrl.vime import DynamicsLoss, VIMELoss
        >>> q_loss = DropoutDQNLoss(q_actor(FlatMLP(3, 4), Categorical(4), action_mask_key=None))
        >>> loss = VIMELoss(q_loss, DynamicsLoss(DynamicsModel(3, 4)))
        >>> freeze = HardUpdate(loss, value_network_update_interval=0)
        >>> loss.set_num_data(1000)
        >>> state = dict(observation=torch.ones(32, 3))
        >>> end = dict(reward=torch.ones(32, 1), terminated=torch.zeros(32, 1).bool())
        >>> action = torch.ones(32).long()
        >>> td = TensorDict({**state, "action": action, "next": {**state, **end}}, [32])
        >>> sorted(loss(td).keys())
        ['dynamics_kl', 'dynamics_loss', 'loss', 'loss_value', 'q_value', 'td_error']
    """

    held: Tensor

    def __init__(
        self, q_loss: LossModule, dynamics_loss: DynamicsLoss, *, dynamics_every: int = 1
    ) -> None:
        if dynamics_every < 1:
            raise ValueError(f"dynamics_every must be at least 1, got {dynamics_every}")
        super().__init__()
        own = {id(p) for p in q_loss.parameters()}
        if any(id(p) in own for p in dynamics_loss.parameters()):
            raise ValueError("q_loss and dynamics_loss must not have parameters in common")
        self.q_loss = q_loss
        self.dynamics_loss = dynamics_loss
        self.dynamics_every = dynamics_every
        # one record for both, so that an updater of this loss counts as one of the Q-loss
        self._has_update_associated = q_loss._has_update_associated
        # on the host: whether a batch is skipped must not wait for a device
        self.batches = 0
        self.register_buffer(
            "held", dynamics_loss.num_data.new_zeros((2, *dynamics_loss.num_data.shape))
        )

    # -- the dynamics' share ----------------------------------------------------------------

    def set_num_data(self, num_data: int | Tensor) -> None:
        """Sets N of the dynamics loss, and of the Q-loss if it has one.

        Args:
            num_data: a number, or one for each replica, [*replicas].
        """
        self.dynamics_loss.set_num_data(num_data)
        if provides(self.q_loss, UsesNumData):
            self.q_loss.set_num_data(torch.as_tensor(num_data))

    def begin_epoch(self) -> None:
        """Lets the dynamics learn on the next batch, and from there on every so manieth.

        To be called before each epoch where the replicas have epochs of different
        lengths (:class:`~bbq_torchrl.data.ReplicaReplay`), or the length of one replica's epoch
        decides which batches of the next the others' dynamics learn on.
        """
        self.batches = 0
        if provides(self.q_loss, BeginsEpochs):
            self.q_loss.begin_epoch()

    def get_extra_state(self) -> Tensor:
        """Returns the number of batches since the schedule began, int64, shape []."""
        return torch.tensor(self.batches)

    def set_extra_state(self, state: Tensor) -> None:
        """Restores what :meth:`get_extra_state` returned."""
        self.batches = int(state)

    @dispatch  # type: ignore[untyped-decorator]
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Returns the losses of a batch of transitions.

        Args:
            tensordict: a batch [*replicas, *batch].

        Returns:
            a TensorDict with what both losses return; the scalar "loss" to differentiate is
            their sum, or the Q-loss's where the dynamics do not learn.
        """
        out: TensorDictBase = self.q_loss(tensordict)
        is_due = self.batches % self.dynamics_every == 0
        self.batches += 1
        if is_due:
            learned = self.dynamics_loss(tensordict)
            out.set("loss", out["loss"] + learned["loss"])
            self.held.copy_(torch.stack([learned.get("dynamics_loss"), learned.get("dynamics_kl")]))
        dynamics_loss, dynamics_kl = self.held.clone().unbind(0)
        return out.set("dynamics_loss", dynamics_loss).set("dynamics_kl", dynamics_kl)

    # -- what is the Q-loss's ---------------------------------------------------------------

    @property
    def in_keys(self) -> list[NestedKey]:
        """What both losses read."""
        return list(dict.fromkeys([*self.q_loss.in_keys, *self.dynamics_loss.in_keys]))

    @property
    def out_keys(self) -> list[NestedKey]:
        """What both losses return."""
        return list(dict.fromkeys([*self.q_loss.out_keys, *self.dynamics_loss.out_keys]))

    @property
    def tensor_keys(self) -> Any:
        """The Q-loss's keys."""
        return self.q_loss.tensor_keys

    def set_keys(self, **kwargs: NestedKey) -> None:
        """Sets the keys of both losses, each where it has it.

        The state's key is the dynamics loss's ``observation``; the Q-loss reads its actor's
        ``in_keys``.

        Raises:
            ValueError: for a key that neither has.
        """
        losses = (self.q_loss, self.dynamics_loss)
        known = [set(loss._AcceptedKeys.__dataclass_fields__) for loss in losses]
        unknown = set(kwargs) - set.union(*known)
        if unknown:
            raise ValueError(
                f"{', '.join(sorted(unknown))} is not an accepted tensordict key. Accepted keys "
                f"are: {sorted(set.union(*known))}"
            )
        for loss, names in zip(losses, known, strict=True):
            loss.set_keys(**{name: key for name, key in kwargs.items() if name in names})

    @property
    def loss_mask_key(self) -> NestedKey | None:
        """The entry that marks the rows that count, of both losses."""
        return self.q_loss.loss_mask_key

    @loss_mask_key.setter
    def loss_mask_key(self, value: NestedKey | None) -> None:
        self.q_loss.loss_mask_key = value
        self.dynamics_loss.loss_mask_key = value  # type: ignore[assignment]

    @property
    def use_prioritized_weights(self) -> bool | str:
        """Whether the weights of prioritized replay are read, by both losses."""
        return self.q_loss.use_prioritized_weights

    @use_prioritized_weights.setter
    def use_prioritized_weights(self, value: bool | str) -> None:
        self.q_loss.use_prioritized_weights = value
        self.dynamics_loss.use_prioritized_weights = value  # type: ignore[assignment]

    @property
    def value_estimator(self) -> ValueEstimatorBase:
        """The Q-loss's value estimator."""
        return self.q_loss.value_estimator

    def make_value_estimator(self, *args: Any, **kwargs: Any) -> Any:
        """Makes the Q-loss's value estimator."""
        return self.q_loss.make_value_estimator(*args, **kwargs)

    def reset_parameters_recursive(self) -> None:
        """Starts the parameters of both losses again."""
        self.q_loss.reset_parameters_recursive()
        self.dynamics_loss.reset_parameters_recursive()

    def named_children(self) -> Iterator[tuple[str, nn.Module]]:
        """Yields the two losses and the Q-loss's target parameters.

        TorchRL's target updaters look for these among a loss's children; they are no submodules
        a second time, so states and parameters hold them once.
        """
        yield from super().named_children()
        for name, child in self.q_loss.named_children():
            if name.startswith("target_"):
                yield name, child

    def __getattr__(self, name: str) -> Any:
        try:
            return nn.Module.__getattr__(self, name)
        except AttributeError:
            q_loss = self.__dict__.get("_modules", {}).get("q_loss")
            if q_loss is None:
                raise
            return getattr(q_loss, name)
