"""The environment with TorchRL's collectors, vectorized environments and transforms."""

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
    rollout = env.rollout(30, break_when_any_done=False)
    for part in (rollout, rollout["next"]):
        assert torch.equal(part["step_count"], part["turns"])
    assert torch.equal(rollout["is_init"], rollout["turns"] == 0)
    ends = rollout["next"][rollout["next", "done"].squeeze(-1)]
    assert len(ends) > 16
    total = torch.where(ends["success"], 40.0, -10.0) - (ends["turns"] - 1)
    assert torch.equal(ends["episode_reward"], total)


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
    assert [batch.shape for batch in batches] == [(10, 40)] * 2
    for batch in batches:
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
    env = vectorized(2, partial(DialogueEnv, movie, batch_size=(4,), schedule=schedule))
    try:
        env.set_seed(0)
        check_env_specs(env)
        # Their spec has no mask, so a policy is needed that reads it.
        rollout = env.rollout(12, UniformPolicy(), break_when_any_done=False)
    finally:
        env.close()
    assert rollout.shape == (2, 4, 12)
    assert rollout["action_mask"].gather(-1, rollout["action"][..., None]).all()
    assert not torch.equal(rollout["goal_id"][0], rollout["goal_id"][1])
    done = rollout["next", "done"].squeeze(-1)[..., :-1]
    assert done.any()
    assert (rollout["turns"].squeeze(-1)[..., 1:][done] == 0).all()
