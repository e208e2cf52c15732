"""The sweep behind results/deep_sea.csv: every agent on seas of many sizes, the cheapest first.

    OMP_NUM_THREADS=1 python examples/deep_sea/sweep.py

Can be stopped at any time: what is in the file is not trained again.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import torch
from deep_sea_results import AGENT_NAMES, RESULTS, append, read
from deep_sea_training import train

SIZES = (4, 6, 8, 10, 14, 20)
SEEDS = 5
EPISODES = 300


def main() -> None:
    """Trains the cells that the file lacks."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--agents", nargs="+", choices=AGENT_NAMES, default=list(AGENT_NAMES))
    parser.add_argument("--sizes", nargs="+", type=int, default=list(SIZES))
    parser.add_argument("--seeds", type=int, default=SEEDS, help="replicas side by side")
    parser.add_argument("--episodes", type=int, default=EPISODES, help="the most that are dived")
    parser.add_argument("--file", type=Path, default=RESULTS)
    options = parser.parse_args()
    torch.set_num_threads(1)  # the networks are too small for more
    for size in options.sizes:
        for agent in options.agents:
            if any((line.agent, line.size) == (agent, size) for line in read(options.file)):
                continue
            results = train(agent, size, replicas=options.seeds, episodes=options.episodes)
            append(results, options.file)
            to_solve = [result.episodes_to_solve for result in results]
            sys.stdout.write(f"{agent}, N = {size}: episodes to solve {to_solve}\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()
