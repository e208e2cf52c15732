"""The environment beside TorchRL's collectors, vectorized environments and transforms."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from torchrl.collectors import Collector
from torchrl.envs import (
    ActionMask,
    Compose,
    InitTracker,
    ParallelEnv,
    RewardSum,
    SerialEnv,
    StepCounter,
    TransformedEnv,
    check_env_specs,
)

from bbq_torchrl.envs import DialogueEnv, ExtensionSchedule, UniformPolicy, scripted_policy


def test_transforms_count_and_add_up(movie):
    base = DialogueEnv(movie, batch_size=(16,), seed=0)
    env = TransformedEnv(base, Compose(InitTracker(), StepCounter(), RewardSum(), ActionMask()))
    check_env_specs(env)
    torch.manual_seed(0)
    rollout = env.rollout(30, break_when_any_done=False)
    assert torch.equal(rollout["step_count"], rollout["turns"])
    assert torch.equal(rollout["next", "step_count"], rollout["next", "turns"])
    assert torch.equal(rollout["is_init"], rollout["turns"] == 0)
    done = rollout["next", "done"]
    assert int(done.sum()) > 16
    success, turns = rollout["next", "success"][done], rollout["next", "turns"][done]
    total = torch.where(success, 40.0, -10.0) - (turns - 1)
    assert torch.equal(rollout["next", "episode_reward"][done], total)


def test_a_collector_gives_whole_dialogues_one_after_another(movie):
    env = DialogueEnv(movie, batch_size=(10,), seed=0)
    collector = Collector(
        env,
        scripted_policy("rule", env),
        frames_per_batch=400,
        total_frames=800,
        auto_register_policy_transforms=False,
    )
    batches = list(collector)
    collector.shutdown()
    assert len(batches) == 2
    for batch in batches:
        assert batch.shape == (10, 40)
        # The rule policy ends every dialogue with its eighth action.
        assert torch.equal(batch["turns"].squeeze(-1), torch.arange(40).expand(10, -1) % 8)
        assert torch.equal(batch["next", "done"], batch["next", "turns"] == 8)


@pytest.mark.parametrize(
    "vectorized",
    [
        SerialEnv,
        pytest.param(partial(ParallelEnv, mp_start_method="spawn"), marks=pytest.mark.slow),
    ],
    ids=["serial", "parallel"],
)
def test_several_environments_play_side_by_side(movie, vectorized):
    schedule = ExtensionSchedule(start=1, every=1)
    make = partial(DialogueEnv, movie, batch_size=(4,), schedule=schedule)
    env = vectorized(2, make)
    try:
        env.set_seed(0)
        check_env_specs(env)
        torch.manual_seed(0)
        # Their spec has no mask, so that it takes a policy to act by it.
        rollout = env.rollout(12, UniformPolicy(), break_when_any_done=False)
        assert rollout.shape == (2, 4, 12)
        assert rollout["action_mask"].gather(-1, rollout["action"][..., None]).all()
        assert not torch.equal(rollout["goal_id"][0], rollout["goal_id"][1])
        done = rollout["next", "done"].squeeze(-1)[..., :-1]
        assert done.any()
        assert (rollout["turns"].squeeze(-1)[..., 1:][done] == 0).all()
    finally:
        env.close()
