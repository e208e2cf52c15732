"""BBQN on CartPole: the parts in a TorchRL loop of one's own, without any dialogue.

pip install gymnasium
python examples/cartpole_bbqn.py                  # 20,000 frames
python examples/cartpole_bbqn.py --frames 500     # only to see it run
"""

from __future__ import annotations

import argparse

import torch
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer
from torchrl.envs import GymEnv
from torchrl.objectives import SoftUpdate

from bbq_torchrl.modules import BayesMLP, EvaluationPolicy, ThompsonSampling, q_network
from bbq_torchrl.objectives import BBQNLoss

FRAMES_PER_BATCH, UPDATES_PER_BATCH = 16, 8
LONGEST = 500  # frames of an episode of CartPole-v1; each is worth a reward of 1


def mean_return(env: GymEnv, policy: EvaluationPolicy, episodes: int) -> float:
    """Returns the mean return over episodes of a policy that does not explore."""
    returns = [env.rollout(LONGEST, policy)["next", "reward"].sum() for _ in range(episodes)]
    return float(torch.stack(returns).mean())


def train(frames: int, seed: int, *, every: int = 2000) -> float:
    """Learns for a number of frames and returns the mean network's mean return.

    Args:
        frames: of the environment, all of them explored by Thompson sampling.
        seed: of the weights, the draws and the environment.

    Keyword Args:
        every: number of frames after which progress is printed.
    """
    torch.manual_seed(seed)
    env = GymEnv("CartPole-v1", categorical_action_encoding=True)
    test_env = GymEnv("CartPole-v1", categorical_action_encoding=True)
    env.set_seed(seed)
    test_env.set_seed(seed + 10_000)

    net = BayesMLP(4, 2, (64, 64), prior_std="fan_in", mean_init="kaiming", std_init=0.03)
    actor = q_network(net, env.action_spec, action_mask_key=None)
    loss = BBQNLoss(actor, gamma=0.98, noise_std=1.0)
    target = SoftUpdate(loss, tau=0.01)
    optimiser = torch.optim.Adam(loss.parameters(), 1e-3, fused=True)
    buffer = TensorDictReplayBuffer(storage=LazyTensorStorage(frames), batch_size=64)
    collector = Collector(
        env, ThompsonSampling(actor), frames_per_batch=FRAMES_PER_BATCH, total_frames=frames
    )
    policy = EvaluationPolicy(actor)  # the mean network
    seen = 0
    for batch in collector:
        buffer.extend(batch.reshape(-1))
        loss.set_num_data(len(buffer))  # the more data, the less the prior weighs
        for _ in range(UPDATES_PER_BATCH):
            out = loss(buffer.sample())
            optimiser.zero_grad()
            out["loss"].backward()
            optimiser.step()
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
    parser.add_argument("--frames", type=int, default=20_000, help="frames to learn from")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    result = train(options.frames, options.seed)
    print(f"mean network, 20 episodes: return {result:.1f} of at most {LONGEST}")


if __name__ == "__main__":
    main()
