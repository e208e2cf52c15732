"""Turns per second of the simulator alone."""

from __future__ import annotations

from statistics import median
from typing import TYPE_CHECKING

import torch

from bbq_torchrl.domains import movie_domain
from bbq_torchrl.envs import DialogueEnv
from benchmarks.parts.rows import Row
from benchmarks.parts.timing import seconds

if TYPE_CHECKING:
    from collections.abc import Callable

    from benchmarks.parts.sizes import Sizes

TURNS = (15_000, 80_000, 100_000)
PUBLIC = {"random": (411, 100), "rule": (1_560, 40)}
"""Policy -> the public simulator's turns per second on one core, and the target factor."""


def play_simulator(env: DialogueEnv, policy: str = "random") -> Callable[[], int]:
    """Returns a function that plays a batch to its end and counts the turns before each end.

    Args:
        env: whose simulator and errors are used.
        policy: ``"random"``, or a domain's policy that is a fixed sequence, such as ``"rule"``.
    """
    simulator, active, batch = env.simulator, env.active_slots, env.batch_size
    domain = env.domain
    if policy != "random":
        steps = [domain.action_index(step) for step in domain.policies[policy].steps]

    def play() -> int:
        generator = torch.Generator(env.device).manual_seed(0)
        state = simulator.reset(simulator.draw_reset(batch, generator), active)
        simulator.observe(state, active)
        valid = turn = 0
        while not state["done"].all():
            valid += int((~state["done"]).sum())
            if policy == "random":
                action = torch.randint(
                    len(domain.actions), batch, generator=generator, device=env.device
                )
            else:
                step = steps[min(turn, len(steps) - 1)]
                action = torch.full(batch, step, device=env.device)
            state = simulator.turn(state, action, simulator.draw_turn(batch, generator), active)
            simulator.observe(state, active)
            turn += 1
        return valid

    return play


def simulator(sizes: Sizes) -> list[Row]:
    """Turns per second, including features, and their ratio to the public simulator's."""
    rows = [
        Row(
            "simulator",
            f"simulator, {dialogues:,} dialogues in parallel",
            "turns/s",
            _turns_per_second(dialogues, "random", sizes),
            target,
            "higher",
        )
        for dialogues, target in zip(sizes.dialogues, TURNS, strict=True)
    ]
    dialogues = sizes.dialogues[1]
    for policy, (public, target) in PUBLIC.items():
        times = _turns_per_second(dialogues, policy, sizes) / public
        what = f"simulator, {policy} policy under errors, {dialogues:,} dialogues"
        unit = f"times the public one's {public:,} turns/s"
        rows.append(Row("simulator", what, unit, times, target, "higher"))
    return rows


def _turns_per_second(dialogues: int, policy: str, sizes: Sizes) -> float:
    play = play_simulator(DialogueEnv(movie_domain(), batch_size=(dialogues,), seed=0), policy)
    valid = play()
    return valid / median(seconds(play) for _ in range(sizes.repeats))
