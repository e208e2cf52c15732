"""Trains agents in parallel on DeepSea and prints the episodes that each needed to solve it.

    python examples/deep_sea/train.py --agent bootstrap_prior --size 10 --replicas 5

Solved: the greedy policy reaches the treasure, and at least a tenth of all episodes so far have.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import fields, replace
from typing import Literal

import torch
from deep_sea_agents import Settings, default_settings
from deep_sea_results import AGENT_NAMES
from deep_sea_training import train


def _prior_std(text: str) -> float | Literal["fan_in"]:
    return "fan_in" if text == "fan_in" else float(text)


def main() -> None:
    """Trains the agents of the command line, and writes a line for each replica."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--agent", choices=AGENT_NAMES, required=True)
    parser.add_argument("--size", type=int, default=10, help="N, the sea has N x N cells")
    parser.add_argument("--replicas", type=int, default=5, help="independent seeds side by side")
    parser.add_argument("--episodes", type=int, default=300, help="the most that are dived")
    parser.add_argument("--seed", type=int, default=0, help="of the first replica")
    parser.add_argument("--prior-std", type=_prior_std, help="of BBQN, or fan_in")
    parser.add_argument("--std-init", type=float, help="of BBQN's weights at the start")
    parser.add_argument("--noise-std", type=float, help="of BBQN, in units of Q")
    parser.add_argument("--prior-scale", type=float, help="of bootstrap_prior, or epinet")
    parser.add_argument("--index-size", type=int, help="of epinet")
    parser.add_argument("--inverse-temperature", type=float, help="of langevin")
    parser.add_argument("--mask-prob", type=float, help="of the bootstraps")
    parser.add_argument("--lr", type=float, help="learning rate")
    parser.add_argument("--updates-per-step", type=float, help="mini-batches for each step")
    options = parser.parse_args()
    settings = {field.name for field in fields(Settings)}
    given = {key: value for key, value in vars(options).items() if key in settings}
    given = {key: value for key, value in given.items() if value is not None}
    torch.set_num_threads(1)  # the networks are too small for more
    results = train(
        options.agent,
        options.size,
        replicas=options.replicas,
        episodes=options.episodes,
        seed=options.seed,
        settings=replace(default_settings(options.agent), **given),
    )
    for result in results:
        solved = result.episodes_to_solve
        end = "not solved" if solved is None else f"solved after {solved} episodes"
        sys.stdout.write(
            f"seed {result.seed}: {end}; treasure in {result.treasures} of {result.episodes}\n"
        )


if __name__ == "__main__":
    main()
