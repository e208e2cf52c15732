"""Tandem training: a passive agent learns from the dialogues of an active one.

    python examples/tandem.py                                     # DQN with BBQN-MAP, 100 rounds
    python examples/tandem.py --active dqn --passive bbqn_map --file tandem.csv
    python examples/tandem.py --active dqn --passive dqn --passive-seed 100000    # another DQN's

After every round of the active agent the passive one learns from the same buffer with another loss,
for the same epochs in the same order. It plays only in evaluations (the tandem setting of Ostrovski
et al. 2021, "The Difficulty of Passive Learning in Deep Reinforcement Learning"). They found that
passive agents learn worse from the same data. So the value of BBQN's dialogues for a DQN shows in
the comparison with a DQN that learns from another DQN's.

The active agent is not affected: its rounds equal those of an ordinary run with that seed bit by
bit. So do the users in evaluations, which allows paired comparisons with other runs.
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import dataclasses
import logging
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.train import build_trainer

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
    """Returns the trainers of the active and the passive agent.

    Args:
        active: the agent that plays, one of ``AGENTS``.
        passive: the agent that only learns, which may be the same.
        overrides: overrides of both configurations.
        folder: folder of the trainers' files.
        passive_seed: seed of the passive agent's initial weights, instead of the run's. Two equal
            agents with one seed would stay equal.
    """

    def make(role: str, name: str, *more: str) -> RoundTrainer:
        chosen = [f"+experiment=[agents/{name},{PROTOCOL}]", *overrides, *more]
        return build_trainer(compose(chosen), folder / role)[0]

    leader, follower = make("active", active), make("passive", passive)
    if passive_seed is not None:
        fresh = make("weights", passive, f"seed={passive_seed}").learner.loss
        follower.learner.loss.load_state_dict(fresh.state_dict())
    return leader, follower


def tandem(leader: RoundTrainer, follower: RoundTrainer) -> Iterator[list[Row]]:
    """Trains both agents, and yields their success after each evaluation.

    Args:
        leader: the trainer of the active agent.
        follower: that of the passive one, of which only loss, optimizer and evaluator are used.

    Yields:
        (role, rounds so far, replica, evaluation success) for each role and replica.
    """
    if follower.evaluator is None:
        raise ValueError("protocol.eval_every must be positive: evaluations are the result")
    learner = dataclasses.replace(follower.learner, replay=leader.replay)
    leader.begin()
    while leader.rounds_done < leader.rounds:
        rows = leader.train_round()
        number = leader.rounds_done - 1
        learner.learn(number, leader.seed)
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
    """Writes one line per agent, evaluation and replica."""
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
