"""Measures a network that imitates the script ``repair`` without its memory: results/imitation.csv.

The network has the agents' size and sees one observation, so its success shows what such a network
can represent. It learns the script's actions in some dialogues by cross-entropy, with early
stopping on a tenth of them, and plays its most probable action in fresh dialogues.

    python scripts/measure_imitation.py --dialogues 100 1000 10000 --seeds 3
"""

from __future__ import annotations

import argparse
import copy
import csv
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from torch.nn.functional import cross_entropy
from torchrl.modules import MLP, QValueActor

from bbq_torchrl.domains import movie_domain
from bbq_torchrl.envs import DialogueEnv, scripted_policy
from bbq_torchrl.networks import q_actor
from bbq_torchrl.trainers import episode_stats, rollouts

if TYPE_CHECKING:
    from tensordict import TensorDict

FILE = Path(__file__).resolve().parent.parent / "results" / "imitation.csv"
PLAYED, BATCH, EPOCHS, PATIENCE = 10_000, 2_500, 200, 10


def demonstrations(dialogues: int, seed: int) -> tuple[TensorDict, TensorDict]:
    """Returns the script's turns, nine tenths of the dialogues to learn from and one to stop by."""
    env = DialogueEnv(movie_domain(), batch_size=(1, dialogues), seed=seed)
    (played,) = rollouts(env, scripted_policy("repair", env), dialogues, max_steps=21)
    turns = played.select("observation", "action_mask", "action", "valid")[0]
    split = dialogues // 10
    stop, learn = (part[part["valid"].squeeze(-1)] for part in (turns[:split], turns[split:]))
    return learn, stop


def loss(actor: QValueActor, turns: TensorDict) -> torch.Tensor:
    """Returns the mean cross-entropy of the script's actions."""
    (network,) = (module for module in actor.modules() if isinstance(module, MLP))
    values = network(turns["observation"]).masked_fill(~turns["action_mask"], -torch.inf)
    return cross_entropy(values, turns["action"])


def imitate(dialogues: int, seed: int) -> QValueActor:
    """Returns a greedy actor that has learned from the script's dialogues."""
    torch.manual_seed(seed)
    learn, stop = demonstrations(dialogues, seed)
    env = DialogueEnv(movie_domain(), batch_size=(1, 1))
    network = MLP(
        env.layout.size,
        env.action_spec.space.n,
        num_cells=[256, 256],
        activation_class=torch.nn.ReLU,
    )
    actor = q_actor(network, env.action_spec_unbatched)
    optimizer = torch.optim.Adam(network.parameters(), 1e-3)
    best, kept, since = float("inf"), copy.deepcopy(network.state_dict()), 0
    for _ in range(EPOCHS):
        for rows in torch.randperm(len(learn)).split(128):
            optimizer.zero_grad()
            loss(actor, learn[rows]).backward()
            optimizer.step()
        with torch.no_grad():
            now = loss(actor, stop).item()
        since += 1
        if now < best:
            best, kept, since = now, copy.deepcopy(network.state_dict()), 0
        elif since == PATIENCE:
            break
    network.load_state_dict(kept)
    return actor


def success(actor: QValueActor, seed: int) -> float:
    """Returns the share of fresh dialogues that the actor books."""
    env = DialogueEnv(movie_domain(), batch_size=(1, BATCH), seed=10_000 + seed)
    with torch.no_grad():
        played = [episode_stats(r).success for r in rollouts(env, actor, PLAYED, max_steps=21)]
    return torch.cat(played, -1).double().mean().item()


def main() -> None:
    """Measures each number of dialogues with each seed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--dialogues", type=int, nargs="+", default=[100, 1_000, 10_000])
    parser.add_argument("--seeds", type=int, default=3)
    given = parser.parse_args()
    rows = [
        {
            "dialogues": number,
            "seed": seed,
            "success": round(success(imitate(number, seed), seed), 4),
        }
        for number in given.dialogues
        for seed in range(given.seeds)
    ]
    with FILE.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":
    main()
