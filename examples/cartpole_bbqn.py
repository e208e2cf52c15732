"""BBQN on CartPole: the parts in a TorchRL loop of one's own, without any dialogue.

    pip install -e '.[examples]'
    python examples/cartpole_bbqn.py                  # 20,000 frames, a minute
    python examples/cartpole_bbqn.py --agent dqn      # the same loop with DQN, epsilon-greedy
    python examples/cartpole_bbqn.py --frames 480     # only to see it run

With the default settings the mean network's return over 20 episodes was 271, 153 and 161 with
seeds 0, 1 and 2, and DQN's 159, 112 and 152 (random actions: about 22; the most is 500). Both learn
and neither solves the task: with a discount of .95 they look twenty frames ahead, and their
returns go up and down from one thousand frames to the next.
"""

from __future__ import annotations

import argparse
from typing import Any, Literal, get_args

import torch
from tensordict.nn import TensorDictSequential
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import GymEnv, ObservationNorm, TransformedEnv
from torchrl.modules import EGreedyModule
from torchrl.objectives import SoftUpdate

from bbq_torchrl.bayes import BayesMLP
from bbq_torchrl.exploration import EvaluationPolicy, Greedy, ThompsonSampling
from bbq_torchrl.networks import FlatMLP, q_actor
from bbq_torchrl.objectives import BBQNLoss, DropoutDQNLoss

Agent = Literal["bbqn", "dqn"]

HIDDEN, GAMMA = (64, 64), 0.95
FRAMES_PER_BATCH, UPDATES_PER_BATCH = 16, 16
LONGEST = 500  # frames of an episode of CartPole-v1; each is worth a reward of 1
# One over what position [m], velocity [m/s], angle [rad] and its velocity [rad/s] reach.
SCALE = 1 / torch.tensor([2.4, 2.0, 0.2, 2.0])


def make_env(seed: int) -> TransformedEnv:
    """Returns CartPole with every feature at the scale of 1, as a prior over weights wants it."""
    env = GymEnv("CartPole-v1", categorical_action_encoding=True)
    env.set_seed(seed)
    return TransformedEnv(env, ObservationNorm(0.0, SCALE, in_keys=["observation"]))


def mean_return(env: TransformedEnv, policy: EvaluationPolicy, episodes: int) -> float:
    """Returns the mean return over episodes of a policy that does not explore."""
    returns = [env.rollout(LONGEST, policy)["next", "reward"].sum() for _ in range(episodes)]
    return float(torch.stack(returns).mean())


def make_agent(agent: Agent, env: TransformedEnv, frames: int) -> tuple[Any, Any, Any]:
    """Returns the Q-value actor, the policy that explores, and the loss.

    Args:
        agent: "bbqn" explores by Thompson sampling, one weight draw a step; "dqn", the same
            network without uncertainty, by ε from 1 to .05 in a quarter of the frames.
        env: whose actions there are.
        frames: to learn from.
    """
    if agent == "bbqn":
        net = BayesMLP(4, 2, HIDDEN, prior_std="fan_in", mean_init="kaiming", std_init=0.03)
        actor = q_actor(net, env.action_spec_unbatched, action_mask_key=None)
        return actor, ThompsonSampling(actor), BBQNLoss(actor, gamma=GAMMA, noise_std=1.0)
    actor = q_actor(FlatMLP(4, 2, HIDDEN), env.action_spec_unbatched, action_mask_key=None)
    dither = EGreedyModule(env.action_spec_unbatched, eps_end=0.05, annealing_num_steps=frames // 4)
    return actor, TensorDictSequential(Greedy(actor), dither), DropoutDQNLoss(actor, gamma=GAMMA)


def train(agent: Agent, frames: int, seed: int, *, every: int = 2000) -> float:
    """Learns for a number of frames and returns the mean network's mean return.

    Args:
        agent: which one.
        frames: of the environment, all of them explored.
        seed: of the weights, the draws and the environment.

    Keyword Args:
        every: number of frames after which progress is printed.
    """
    torch.manual_seed(seed)
    env, test_env = make_env(seed), make_env(seed + 10_000)
    actor, explore, loss = make_agent(agent, env, frames)
    target = SoftUpdate(loss, tau=0.005)
    optimizer = torch.optim.Adam(loss.parameters(), 1e-3, fused=True)
    updates = frames * UPDATES_PER_BATCH // FRAMES_PER_BATCH
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, updates)
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(frames), batch_size=64)
    collector = Collector(
        env,
        explore,
        frames_per_batch=FRAMES_PER_BATCH,
        total_frames=frames,
        auto_register_policy_transforms=True,  # what a policy needs of its environment
    )
    policy = EvaluationPolicy(actor)  # the mean network
    seen = 0
    for batch in collector:
        buffer.extend(batch.reshape(-1))
        if agent == "bbqn":
            loss.set_num_data(len(buffer))  # the more data, the less the prior weighs
        else:
            explore[-1].step(batch.numel())  # ε falls
        for _ in range(UPDATES_PER_BATCH):
            out = loss(buffer.sample())
            optimizer.zero_grad()
            out["loss"].backward()
            optimizer.step()
            schedule.step()
            target.step()
        before, seen = seen, seen + batch.numel()
        if seen // every > before // every:
            figures = f"TD error {out['td_error']:5.2f}  Q {out['q_value']:5.1f}"
            print(f"{seen:6} frames  return {mean_return(test_env, policy, 3):5.1f}  {figures}")
    collector.shutdown()
    return mean_return(test_env, policy, 20)


def main() -> None:
    """Trains one agent and prints its return."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--agent", choices=get_args(Agent), default="bbqn")
    parser.add_argument("--frames", type=int, default=20_000, help="frames to learn from")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    result = train(options.agent, options.frames, options.seed)
    print(f"mean network, 20 episodes: return {result:.1f} of at most {LONGEST}")


if __name__ == "__main__":
    main()
