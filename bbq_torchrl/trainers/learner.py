"""What a round learns: the target is frozen, and epochs over the buffers follow."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.hooks import provides
from bbq_torchrl.objectives.hooks import BeginsEpochs, FixedTargets, UsesNumData
from bbq_torchrl.trainers.learn import Update, learn_epoch

if TYPE_CHECKING:
    from collections.abc import Callable

    from torch import nn
    from torchrl.objectives.utils import TargetNetUpdater

    from bbq_torchrl.data import ReplicaReplay
    from bbq_torchrl.trainers.optimizer import ReplicaOptimizer
    from bbq_torchrl.trainers.settings import RoundSettings

__all__ = ["Learner"]


class Learner:
    """Learns from the buffers of R replicas: freeze, some epochs, freeze again, some epochs.

    Args:
        loss (LossModule): see :class:`~bbq_torchrl.trainers.RoundTrainer`; what else it may have is
            in :mod:`bbq_torchrl.objectives.hooks`.
        replay (ReplicaReplay): the buffers.
        optimizer (ReplicaOptimizer): of the loss's parameters.
        target_updater (HardUpdate): ``.step()`` freezes the target.
        settings (RoundSettings): how many freezes and epochs, of which batches, and whether the
            learning rate falls.
        seed_phase (callable): seeds all that is random for a phase, which it is given as a name and
            numbers; called before each epoch.
    """

    def __init__(
        self,
        loss: nn.Module,
        replay: ReplicaReplay,
        optimizer: ReplicaOptimizer,
        target_updater: TargetNetUpdater,
        settings: RoundSettings,
        seed_phase: Callable[..., None],
    ) -> None:
        self.loss = loss
        self.replay = replay
        self.target_updater = target_updater
        self.settings = settings
        self.seed_phase = seed_phase
        self._update = Update(loss, optimizer)

    @property
    def updates(self) -> list[int]:
        """How many updates each replica has had in the round."""
        return self._update.sums.updates

    def learn(self, round_number: int) -> dict[str, list[float]]:
        """Learns for a round. Returns the mean of what the loss reports, for each replica."""
        self._update.sums.reset()
        if self.settings.lr_final != 1.0:
            self._update.optimizer.scale_lr(self.settings.lr_share(round_number))
        if provides(self.loss, UsesNumData):
            self.loss.set_num_data(self.replay.num_data())
        self.update_all(round_number)
        return {
            "loss" if name == "loss_value" else name: means
            for name, means in self._update.sums.means().items()
        }

    def update_all(self, round_number: int) -> None:
        """Freezes and learns, without waiting for the device."""
        settings = self.settings
        for freeze in range(settings.freezes):
            self.target_updater.step()
            self.compute_targets()
            for epoch in range(settings.epochs):
                # A seed for every epoch: its length is that of the longest replica's, and the
                # draws of the next epoch must not depend on it.
                self.seed_phase("learn", round_number, freeze, epoch)
                if provides(self.loss, BeginsEpochs):
                    self.loss.begin_epoch()
                learn_epoch(self._update, self.replay.epoch(settings.batch_size))

    def compute_targets(self) -> None:
        """Has the frozen network's values computed for the whole buffer, where a loss allows it."""
        loss = self.loss
        if provides(loss, FixedTargets) and loss.has_fixed_targets:
            self.replay.compute(("next", loss.tensor_keys.next_state_value), loss.next_state_values)
