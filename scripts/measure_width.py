"""Measures how wide a posterior is where its agent has been: results/width.csv.

Of each legal action in the states of a replica's buffer: the standard deviation of its value over
draws of the weights, by how often the action was taken in that state and in states next to it.

    python train.py agent=bbqn protocol=quick protocol.rounds=20 seed=5400 \
        protocol.keep_checkpoints=last hydra.run.dir=runs/width_bbqn
    python train.py +experiment=agents/gp protocol=quick protocol.rounds=20 seed=5400 \
        protocol.capacity=40000 protocol.keep_checkpoints=last hydra.run.dir=runs/width_gp
    python scripts/measure_width.py runs/width_bbqn runs/width_gp
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import torch
from tensordict import TensorDict

from bbq_torchrl import load_run
from bbq_torchrl.data import ReplicaReplay
from bbq_torchrl.trainers import CheckpointFolder
from bbq_torchrl.utils.files import CHECKPOINTS

RESULT = Path(__file__).parents[1] / "results" / "width.csv"
STATES, NEIGHBORS, DRAWS = 1_000, 50, 200
VISITED = {"never": (0, 0), "rarely": (1, 3), "often": (20, NEIGHBORS)}


@torch.no_grad()
def widths(folder: Path) -> dict[str, tuple[float, int]]:
    """Returns the median std of values over draws, and the number of actions, by visits."""
    run = load_run(folder, mode="thompson")
    replay = ReplicaReplay(run.config.protocol.capacity, successes=run.config.spike.successes)
    CheckpointFolder(folder / CHECKPOINTS, replay=replay).restore()
    rows = replay.buffers[0][:]
    torch.manual_seed(0)
    chosen = rows[torch.randperm(len(rows))[:STATES]]
    near = torch.cdist(chosen["observation"], rows["observation"]).topk(NEIGHBORS, largest=False)
    mask = chosen["action_mask"]
    taken = torch.nn.functional.one_hot(rows["action"], mask.shape[-1])
    visits = taken[near.indices].sum(1)
    batch = TensorDict(chosen.select("observation", "action_mask").to_dict(), [len(chosen)])
    draws = [run.policy(batch.unsqueeze(0).clone())["action_value"][0] for _ in range(DRAWS)]
    std = torch.stack(draws).std(0)
    found = {}
    for name, (least, most) in VISITED.items():
        own = std[mask & (visits >= least) & (visits <= most)]
        found[name] = float(own.median()), len(own)
    return found


def main() -> None:
    """Writes a row for each agent and number of visits."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folders", nargs="+", type=Path, help="runs with their buffers")
    with RESULT.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("agent", "visited", "std", "actions"))
        for folder in parser.parse_args().folders:
            agent = load_run(folder).config.agent.name
            for name, (std, count) in widths(folder).items():
                writer.writerow((agent, name, f"{std:.4f}", count))


if __name__ == "__main__":
    main()
