"""On a CUDA device: nothing waits for it, and graphs do what is done without them."""

from __future__ import annotations

from contextlib import contextmanager

import pytest
import torch

from bbq_torchrl.build import build_trainer
from bbq_torchrl.config.store import compose
from bbq_torchrl.envs import DialogueEnv

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="needs a CUDA device")

SHRUNKEN = (
    "device=cuda",
    "protocol.rounds=3",
    "protocol.dialogues=4",
    "protocol.batch_size=8",
    "protocol.capacity=120",
    "protocol.epochs=1",
    "spike.dialogues=4",
    "spike.policy=random",
    "agent.hidden=[8,8]",
    "replicas=3",
)
AGENTS = (
    "bbqn_map",
    "bbqn_mc",
    "bbqn_vime_map",
    "bbqn_vime_mc",
    "dqn",
    "dqn_boltzmann",
    "dqn_bootstrap",
    "dqn_vime_map",
    "dqn_vime_mc",
)


@contextmanager
def never_waiting(monkeypatch):
    """Turns every synchronisation into an error, ``torch.cuda.synchronize()`` too."""

    def refuse(*_: object) -> None:
        raise AssertionError("torch.cuda.synchronize() was called")

    with monkeypatch.context() as patched:
        patched.setattr(torch.cuda, "synchronize", refuse)
        torch.cuda.set_sync_debug_mode("error")
        try:
            yield
        finally:
            torch.cuda.set_sync_debug_mode("default")


def make_trainer(agent, domain, folder, *further):
    overrides = [f"+experiment=agents/{agent}", *SHRUNKEN, *further]
    config = compose([*overrides, "domain=folder", f"domain.path={domain}"])
    return build_trainer(config, folder)[0]


@pytest.mark.parametrize("agent", AGENTS)
def test_a_rounds_updates_never_wait(agent, restaurant_folder, tmp_path, monkeypatch):
    trainer = make_trainer(agent, restaurant_folder, tmp_path)
    trainer.begin()
    trainer.train_round()  # captures
    with never_waiting(monkeypatch):
        trainer._update_all(1)


@pytest.mark.parametrize("agent", AGENTS)
def test_a_captured_round_is_the_plain_one(agent, restaurant_folder, tmp_path):
    losses = []
    for name, further in (("plain", ("cuda_graph=false",)), ("captured", ())):
        trainer = make_trainer(agent, restaurant_folder, tmp_path / name, *further)
        trainer.begin()
        losses.append([row["loss"] for row in trainer.train_round()])
    # The same numbers in another order may add up to other last digits.
    assert losses[0] == pytest.approx(losses[1], rel=1e-3)


def test_a_turn_never_waits(movie, monkeypatch):
    env = DialogueEnv(movie, batch_size=(2, 5), seed=0, device="cuda")
    for captured in (False, True):
        state = env.reset()
        state["action"] = env.rand_action()["action"]
        if captured:
            with never_waiting(monkeypatch):
                env._step(state)
        else:
            env._step(state)
            env._step(state)


def test_a_captured_turn_is_the_turn(movie):
    played = []
    for cuda_graph in (False, True):
        env = DialogueEnv(movie, batch_size=(5,), seed=0, device="cuda", cuda_graph=cuda_graph)
        torch.manual_seed(0)
        played.append(env.rollout(12, break_when_any_done=False))
    for key in ("observation", ("next", "reward"), ("next", "done"), "action"):
        assert torch.equal(played[0][key], played[1][key]), key
