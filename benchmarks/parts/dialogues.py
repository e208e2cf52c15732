"""Dialogues in lockstep: on the simulator alone, and in a TorchRL rollout."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch

from bbq_torchrl.envs import scripted_policy

if TYPE_CHECKING:
    from collections.abc import Callable

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.envs import DialogueEnv

    Choice = Callable[[int, torch.Size, torch.Generator], torch.Tensor]

SEED = 0

PUBLIC_RANDOM, PUBLIC_RULE = 411, 1_560
"""Turns a second of the public simulator on one core: a random policy; the rule policy, errors."""


def _choice(policy: str, domain: Domain) -> Choice:
    """Returns a function from turn, batch size and generator to actions."""
    if policy == "random":
        n_actions = len(domain.actions)
        return lambda turn, batch, generator: torch.randint(n_actions, batch, generator=generator)
    steps = torch.tensor([domain.action_index(step) for step in domain.policies[policy].steps])
    return lambda turn, batch, generator: steps[min(turn, len(steps) - 1)].expand(batch)


def play_simulator(env: DialogueEnv, policy: str = "random") -> Callable[[], int]:
    """Returns a function that plays a batch on the simulator and counts its valid turns.

    Args:
        env: whose simulator and errors are used.
        policy: ``"random"``, or a domain's policy that is a fixed sequence, such as ``"rule"``.
    """
    simulator, active = env.simulator, env.active_slots
    choose = _choice(policy, env.domain)

    def play() -> int:
        generator = torch.Generator().manual_seed(SEED)
        state = simulator.reset(simulator.draw_reset(env.batch_size, generator), active)
        simulator.observe(state, active)
        valid = turn = 0
        while not state["done"].all():
            valid += int((~state["done"]).sum())
            action = choose(turn, env.batch_size, generator)
            draws = simulator.draw_turn(env.batch_size, generator)
            state = simulator.turn(state, action, draws, active)
            simulator.observe(state, active)
            turn += 1
        return valid

    return play


def play_rollout(env: DialogueEnv, policy: str = "random") -> Callable[[], int]:
    """Returns a function that rolls a batch out and counts its valid turns."""
    actor = scripted_policy(policy, env)

    def play() -> int:
        torch.manual_seed(SEED)
        env.set_seed(SEED)
        rollout = env.rollout(
            env.max_agent_turns, actor, break_when_any_done=False, break_when_all_done=True
        )
        done = rollout["next", "done"].squeeze(-1)
        return int(((done.cumsum(-1) - done.long()) == 0).sum())

    return play
