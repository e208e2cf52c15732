"""What no machine can hold is refused by name, and what is estimated is what is taken."""

from __future__ import annotations

import pytest
import torch

from bbq_torchrl.cli import memory
from bbq_torchrl.cli.memory import check_memory, device_memory, training_needs
from bbq_torchrl.cli.store import compose
from bbq_torchrl.cli.training import build_trainer
from bbq_torchrl.options import ConfigError


def check(*overrides):
    config = compose(overrides)
    check_memory(training_needs(config, config.domain.make()), config.device)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ("agent.hidden=[1000000000]", "the networks would take about .* agent.hidden=.1000000000."),
        ("protocol.dialogues=1000000000", "replicas=1, protocol.dialogues=1000000000"),
        ("protocol.capacity=1000000000", "the replay buffer would .* protocol.capacity=1000000000"),
        ("env.max_turn=1000000000", "env.max_turn=1000000000"),
        ("replicas=10000000", "with replicas=10000000"),
        ("protocol.eval_dialogues=1000000000", "protocol.eval_dialogues=1000000000"),
        (
            "protocol.eval_batch=500000000 protocol.eval_dialogues=500000000",
            "protocol.eval_batch=500000000",
        ),
        ("agent=bootstrap agent.heads=100000000", "agent.heads=100000000"),
        (
            "agent.evaluate=average agent.evaluate_draws=100000000",
            "agent.evaluate_draws=100000000",
        ),
        (
            "intrinsic=vime intrinsic.hidden=[900000000]",
            "of the intrinsic reward .*intrinsic.hidden",
        ),
    ],
)
def test_what_no_machine_can_hold_is_refused(overrides, message):
    with pytest.raises(ConfigError, match=message) as refused:
        check(*overrides.split())
    assert "and device=cpu has" in str(refused.value)


def test_the_papers_protocol_fits_a_small_machine(monkeypatch):
    monkeypatch.setattr(memory, "device_memory", lambda device: 4 * 10**9)
    for agent in ("bbqn", "dqn", "bootstrap"):
        check(f"agent={agent}", "replicas=5")


def test_a_machine_has_memory():
    assert device_memory("cpu") > 10**8


def test_the_estimate_of_the_buffer_is_what_it_takes(tmp_path):
    config = compose(["agent=dqn", "protocol.capacity=300", "spike.dialogues=8", "replicas=2"])
    trainer, _ = build_trainer(config, tmp_path)
    trainer.begin()
    list(trainer.replay.epoch(32))
    tensors = [buffer.storage._storage for buffer in trainer.replay.buffers]
    tensors.append(trainer.replay._memory._rows)
    taken = sum(td.bytes() for td in tensors)
    estimated = training_needs(config, trainer.env.domain)[0].size
    assert 0.8 < estimated / taken < 1.25


def test_the_estimate_of_a_rollout_is_not_less_than_its_tensors():
    config = compose(["agent=dqn", "protocol.dialogues=20"])
    domain = config.domain.make()
    env = config.env.make(domain, (1, 20))
    rollout = env.rollout(30, env.rand_action, break_when_any_done=False)
    per_turn = rollout.bytes() / rollout.numel()
    most = 20 * env.max_agent_turns * per_turn
    estimated = training_needs(config, domain)[1].size
    assert most < estimated < 4 * most


def test_the_estimate_of_the_networks_is_what_a_loss_and_adam_hold(tmp_path):
    config = compose(["agent=dqn", "replicas=3"])
    trainer, agent = build_trainer(config, tmp_path)
    weights = sum(parameter.numel() for parameter in agent.loss.parameters())
    frozen = sum(
        buffer.numel() for name, buffer in agent.loss.named_buffers() if name.startswith("target_")
    )
    assert trainer.optimizer is not None
    taken = torch.finfo(torch.float32).bits // 8 * (weights * 4 + frozen)
    assert training_needs(config, trainer.env.domain)[4].size == pytest.approx(taken, rel=0.05)
