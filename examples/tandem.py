"""Is it the dialogues, or what is learned from them? An agent that learns from another one's.

    python examples/tandem.py                                     # DQN beside BBQN-MAP, 100 rounds
    python examples/tandem.py --active dqn --passive bbqn_map --file tandem.csv
    python examples/tandem.py --active dqn --passive dqn --passive-seed 100000    # another DQN's

After every round of the active agent the passive one learns from the same buffer, by its own loss,
the same number of epochs in the same order, and never plays but in evaluations (the tandem setting
of Ostrovski et al. 2021, "The Difficulty of Passive Learning in Deep Reinforcement Learning").
They found that who never plays what it believes in learns worse from the same data. So what BBQN's
dialogues are worth to a DQN is told by a DQN that learns from another DQN's.

The active agent does not notice: its rounds are bitwise those of an ordinary run of that seed. So
are the users in the evaluations, and agents can be compared by pairs with any other run's.
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

from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.train import build_trainer
from bbq_torchrl.trainers.learn import Learner

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from bbq_torchrl.trainers import RoundTrainer

AGENTS = ("bbqn_map", "dqn")
PROTOCOL = "paper_full,large_batches"
DEFAULTS = ("protocol.rounds=100", "replicas=10")

Row = tuple[str, int, int, float]


def make_trainers(
    active: str,
    passive: str,
    overrides: Sequence[str],
    folder: Path,
    passive_seed: int | None = None,
) -> tuple[RoundTrainer, RoundTrainer]:
    """Returns the trainer of who plays and learns, and that of who learns only.

    Args:
        active: the agent whose dialogues are learned from, one of ``AGENTS``.
        passive: the other one, which may be the same.
        overrides: of both configurations.
        folder: for the trainers' files.
        passive_seed: of the passive one's first weights, instead of the run's own. Two agents of
            one kind and one seed would stay alike.
    """

    def make(role: str, name: str, *more: str) -> RoundTrainer:
        chosen = [f"+experiment=[agents/{name},{PROTOCOL}]", *overrides, *more]
        return build_trainer(compose(chosen), folder / role)[0]

    leader, follower = make("active", active), make("passive", passive)
    if passive_seed is not None:
        fresh = make("weights", passive, f"seed={passive_seed}").loss
        follower.loss.load_state_dict(fresh.state_dict())
    return leader, follower


def tandem(leader: RoundTrainer, follower: RoundTrainer) -> Iterator[list[Row]]:
    """Trains both, and yields after each evaluation every agent's success in it.

    Args:
        leader: the trainer of the active agent.
        follower: that of the passive one; its loss, optimizer and evaluations are all that is used.

    Yields:
        (role, rounds so far, replica, evaluation success) for each role and replica.
    """
    if follower.evaluator is None:
        raise ValueError("protocol.eval_every must be positive: evaluations are the result")
    leader.progress = False
    learner = Learner(
        follower.loss,
        leader.replay,
        follower.optimizer,
        follower.target_updater,
        leader.learner.seed_phase,
        batch_size=leader.learner.batch_size,
        freezes=leader.learner.freezes,
        epochs=leader.learner.epochs,
        lr_share=leader.learner.lr_share,
    )
    leader.begin()
    while leader.rounds_done < leader.rounds:
        rows = leader.train_round()
        number = leader.rounds_done - 1
        learner.learn(number)
        success = [row["eval_success_rate"] for row in rows]
        watched = torch.as_tensor(follower.evaluator(number)["eval_success_rate"])
        if success[0] == success[0]:  # NaN in a round without an evaluation
            found = {"active": success, "passive": watched.tolist()}
            yield [
                (role, leader.rounds_done, replica, rate)
                for role, rates in found.items()
                for replica, rate in enumerate(rates)
            ]


def main() -> None:
    """Writes a line for each agent, evaluation and replica."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--active", choices=AGENTS, default="bbqn_map", help="plays and learns")
    parser.add_argument("--passive", choices=AGENTS, default="dqn", help="learns only")
    parser.add_argument(
        "--passive-seed", type=int, help="of its first weights; the run's by default"
    )
    parser.add_argument("--file", type=Path, help="CSV file to write; the screen by default")
    parser.add_argument(
        "overrides", nargs="*", default=DEFAULTS, help=f"of both; else {' '.join(DEFAULTS)}"
    )
    options = parser.parse_args()
    torch.set_num_threads(1)  # the networks are too small for more
    logging.getLogger("torchrl").setLevel(logging.WARNING)
    to_screen = contextlib.nullcontext(sys.stdout)
    file = options.file and options.file.open("w", newline="", encoding="utf-8")
    with file or to_screen as stream, tempfile.TemporaryDirectory() as folder:
        lines = csv.writer(stream, lineterminator="\n")
        lines.writerow(["role", "agent", "rounds", "replica", "success_rate"])
        agents = {"active": options.active, "passive": options.passive}
        trainers = make_trainers(
            options.active, options.passive, options.overrides, Path(folder), options.passive_seed
        )
        for rows in tandem(*trainers):
            lines.writerows((role, agents[role], *rest) for role, *rest in rows)
            stream.flush()


if __name__ == "__main__":
    main()
