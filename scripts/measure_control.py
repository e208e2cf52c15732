"""Measures the cost of each rule of the dialogue control in the simulator: ``results/control.csv``.

An agent that ships plays the same simulated users without rules, with each rule alone, and with all
of them.

    python scripts/measure_control.py [shipped:bbqn_map] [--dialogues 4000]
"""

from __future__ import annotations

import argparse
import csv
import math
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bbq_torchrl import load_run
from bbq_torchrl.people.dialogue.control import IN_THE_SIMULATOR, Control
from bbq_torchrl.utils import output

if TYPE_CHECKING:
    from tensordict.nn import TensorDictModuleBase

    from bbq_torchrl.envs import DialogueEnv

RESULT = Path(__file__).parents[1] / "results" / "control.csv"
_BATCH = 500


@torch.no_grad()
def play(
    env: DialogueEnv, policy: TensorDictModuleBase, control: Control, shape: torch.Size, seed: int
) -> tuple[float, float]:
    """Plays a batch of dialogues to their end. Returns their mean success and turns."""
    simulator, active = env.simulator, env.active_slots
    legal = simulator.action_mask(active).expand(*shape, -1)
    generator = torch.Generator().manual_seed(seed)
    state = simulator.reset(simulator.draw_reset(shape, generator), active)
    while not bool(state["done"].all()):
        state = control.remember(state)
        wished = state.get("wished", None)
        allowed, _ = control.allowed(state, legal)
        seen = {"observation": simulator.observe(state, active), "action_mask": allowed}
        action = policy(TensorDict(seen, batch_size=shape))["action"]
        state = simulator.turn(state, action, simulator.draw_turn(shape, generator), active)
        if wished is not None:
            state["wished"] = wished
    return float(state["success"].float().mean()), float(state["turn"].float().mean())


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("run", nargs="?", default="shipped:bbqn_map")
    parser.add_argument("--dialogues", type=int, default=4_000)
    given = parser.parse_args()
    torch.set_num_threads(1)
    env, policy, config, _ = load_run(given.run, dialogues=_BATCH)
    shape = torch.Size((config.replicas, _BATCH))
    batches = -(-given.dialogues // shape.numel())
    settings = {"none": (), **{name: (name,) for name in IN_THE_SIMULATOR}, "all": IN_THE_SIMULATOR}
    rows = []
    with set_exploration_type(ExplorationType.DETERMINISTIC):
        for name, rules in settings.items():
            control = Control(env.simulator, rules)
            played = [play(env, policy, control, shape, seed) for seed in range(batches)]
            success, turns = (sum(part) / batches for part in zip(*played, strict=True))
            error = math.sqrt(success * (1 - success) / (batches * shape.numel()))
            numbers = (f"{success:.4f}", f"{error:.4f}", f"{turns:.2f}")
            rows.append((name, given.run, batches * shape.numel(), *numbers))
            output.write(f"{' '.join(map(str, rows[-1]))}\n")
    with RESULT.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(("rules", "agent", "dialogues", "success", "standard_error", "turns"))
        writer.writerows(rows)


if __name__ == "__main__":
    main()
