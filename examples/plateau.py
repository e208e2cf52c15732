"""Speed of fitting a fixed buffer from different initial posteriors: the plateau of the zero mean.

    python examples/plateau.py --file results/plateau.csv    # two minutes
    python examples/plateau.py --epochs 3                    # a first look, on the screen

The agent learns from a fixed buffer, 100 dialogues of the rule agent and 100 of a random one,
without playing. The last transition of each success has the target 40, the reward itself, from the
first update on. The mean network's value there shows whether anything is learned.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import logging
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from bbq_torchrl.envs import scripted_policy
from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.train import build_trainer
from bbq_torchrl.trainers import rollouts
from bbq_torchrl.trainers.collect import rows_per_replica

if TYPE_CHECKING:
    from collections.abc import Iterator

    from torch import Tensor

    from bbq_torchrl.trainers import RoundTrainer

STARTS = {
    "zero mean, std 0.1 (the paper's)": ("zero", 0.1),
    "Kaiming mean, std 0.1": ("kaiming", 0.1),
    "Kaiming mean, std 0.03": ("kaiming", 0.03),
}
DIALOGUES = 100
EPOCHS_A_FREEZE = 3


def spiked_trainer(mean_init: str, std_init: float, seeds: int, folder: Path) -> RoundTrainer:
    """Returns a trainer with the rule agent's dialogues and as many random ones in its buffers."""
    config = compose(
        [
            "agent=bbqn",
            "explore=thompson",
            f"agent.mean_init={mean_init}",
            f"agent.std_init={std_init}",
            "agent.prior_std=.1",
            "agent.kl_temperature=1",
            f"spike.dialogues={DIALOGUES}",
            f"protocol.dialogues={DIALOGUES}",
            f"replicas={seeds}",
        ]
    )
    trainer, _ = build_trainer(config, folder)
    trainer.begin()
    randomly = scripted_policy("random", trainer.env)
    for rollout in rollouts(trainer.env, randomly, DIALOGUES):
        trainer.replay.extend(rows_per_replica(rollout, trainer.replay.keys))
    return trainer


def values_of_successes(trainer: RoundTrainer) -> list[float]:
    """Returns each replica's mean Q of the mean network at the last actions of successes."""
    total = counts = None
    with torch.no_grad():
        for batch in trainer.replay.epoch(512):
            rows = batch.transitions
            values: Tensor = trainer.policy.actor[0].module(rows["observation"], "mean")
            chosen = values.gather(-1, rows["action"].unsqueeze(-1)).squeeze(-1)
            success = rows["valid"] & (rows["next", "reward"].squeeze(-1) > 0)
            part = torch.where(success, chosen, 0.0).sum(-1), success.sum(-1)
            total, counts = part if total is None else (total + part[0], counts + part[1])
    return (total / counts).tolist()


def curve(trainer: RoundTrainer, epochs: int) -> Iterator[tuple[int, list[float]]]:
    """Yields, at every freeze, the number of updates and the values at successes."""
    learner = trainer.learner
    learner.loss.set_num_data(trainer.replay.num_data())
    for epoch in range(epochs):
        if epoch % EPOCHS_A_FREEZE == 0:
            if epoch:
                yield learner.sums.updates[0], values_of_successes(trainer)
            learner.target_updater.step()
            trainer.replay.compute(("next", "next_state_value"), learner.loss.next_state_values)
        learner.loss.begin_epoch()
        for batch in trainer.replay.epoch(learner.batch_size):
            learner.update(batch)
    yield learner.sums.updates[0], values_of_successes(trainer)


def main() -> None:
    """Writes a line for each start, number of updates and seed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--epochs", type=int, default=24, help="passes over the buffer")
    parser.add_argument("--seeds", type=int, default=3, help="replicas side by side")
    parser.add_argument("--file", type=Path, help="CSV file to write; the screen by default")
    options = parser.parse_args()
    torch.set_num_threads(1)  # the networks are too small for more
    logging.getLogger("torchrl").setLevel(logging.WARNING)
    to_screen = contextlib.nullcontext(sys.stdout)
    file = options.file and options.file.open("w", newline="", encoding="utf-8")
    with file or to_screen as stream:
        lines = csv.writer(stream, lineterminator="\n")
        lines.writerow(["start", "updates", "seed", "q_value"])
        for name, (mean_init, std_init) in STARTS.items():
            with tempfile.TemporaryDirectory() as folder:
                trainer = spiked_trainer(mean_init, std_init, options.seeds, Path(folder))
                for updates, values in curve(trainer, options.epochs):
                    lines.writerows([name, updates, *row] for row in enumerate(values))
                    stream.flush()


if __name__ == "__main__":
    main()
