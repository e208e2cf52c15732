"""An agent of another library that books movie tickets: MaskablePPO of sb3-contrib.

    pip install -e '.[examples]'
    python examples/maskable_ppo.py --steps 100000

The environment is Gymnasium's, one dialogue at a time; the agent finds the legal actions by
``action_masks()``. Prints the success rate of new dialogues.
"""

from __future__ import annotations

import argparse

import gymnasium
from sb3_contrib import MaskablePPO

from bbq_torchrl.envs.gymnasium import ENV_ID  # importing it registers the environment


def success_rate(agent: MaskablePPO, dialogues: int, seed: int) -> float:
    """Returns the share of dialogues that the agent, acting greedily, ends in success."""
    env = gymnasium.make(ENV_ID)
    successes = 0
    for dialogue in range(dialogues):
        observation, info = env.reset(seed=seed if dialogue == 0 else None)
        over = False
        while not over:
            action, _ = agent.predict(
                observation, action_masks=env.unwrapped.action_masks(), deterministic=True
            )
            observation, _, terminated, truncated, info = env.step(action)
            over = terminated or truncated
        successes += info["success"]
    return successes / dialogues


def main() -> None:
    """Trains, evaluates and prints the success."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--steps", type=int, default=100_000, help="turns to learn from")
    parser.add_argument("--batch", type=int, default=2_048, help="turns of a round")
    parser.add_argument("--dialogues", type=int, default=200, help="of the evaluation")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    agent = MaskablePPO(
        "MlpPolicy",
        gymnasium.make(ENV_ID),
        n_steps=options.batch,
        gamma=0.9,
        seed=options.seed,
        device="cpu",
    )
    agent.learn(options.steps)
    rate = success_rate(agent, options.dialogues, seed=options.seed + 1)
    print(f"MaskablePPO, {agent.num_timesteps} turns: success rate {rate:.3f}")


if __name__ == "__main__":
    main()
