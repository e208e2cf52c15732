"""A turn never waits for the device, and compiling does not change it."""

from __future__ import annotations

from functools import partial

import pytest
import torch

from bbq_torchrl.domains import tensorize
from bbq_torchrl.envs import DialogueEnv, ExtensionSchedule
from bbq_torchrl.envs.measured import load_errors
from bbq_torchrl.simulator import ErrorModel, Simulator
from benchmarks.parts.host_waits import NeverWaits


def make_env(domain, **options):
    return DialogueEnv(
        domain,
        batch_size=(2, 5),
        slot_error_prob=0.3,
        slot_error_mode="mixed",
        intent_error_prob=0.2,
        schedule=ExtensionSchedule(start=1, every=1),
        seed=3,
        **options,
    )


def turns(env):
    """Returns the observations of a random agent over two rounds of the extension."""
    torch.manual_seed(5)
    told = []
    for round_number in (0, 4):
        env.set_round(round_number)
        told.append(env.rollout(7, break_when_any_done=False).exclude("collector"))
        told.append(env.rollout(4, break_when_any_done=False).exclude("collector"))
    return told


@pytest.mark.parametrize("users", ["paper", "people"])
def test_neither_a_turn_nor_a_reset_waits_for_the_device(movie, users):
    env = make_env(movie, users=users)
    state = env.reset()
    state["action"] = env.rand_action()["action"]
    state["_reset"] = torch.rand(2, 5, 1) < 0.5
    with NeverWaits():
        env._step(state)
        env._reset(state)
        env._reset()


@pytest.mark.parametrize("users", ["paper", "people"])
@pytest.mark.parametrize("mode", ["value", "slot", "delete", "mixed", "measured"])
def test_everything_that_a_turn_uses_is_on_its_device(movie, mode, users):
    # Tensors on the device "meta" have no numbers: code that reads one, or mixes them with tensors
    # on the CPU, fails.
    tensors = tensorize(movie)
    errors = load_errors(movie) if mode == "measured" else ErrorModel(tensors, 0.3, mode, 0.2)
    simulator = Simulator(tensors, errors=errors, users=users).to("meta")
    active = torch.ones(tensors.n_slots, dtype=torch.bool, device="meta")
    action = torch.zeros(7, dtype=torch.int64, device="meta")
    with NeverWaits():
        state = simulator.reset(simulator.draw_reset((7,)), active)
        state = simulator.turn(state, action, simulator.draw_turn((7,)), active)
        features = simulator.observe(state, active)
    assert {features.device.type, *(entry.device.type for entry in state.values(True, True))} == {
        "meta"
    }


@pytest.mark.slow
def test_a_compiled_turn_is_the_turn(restaurant):
    compiled = turns(make_env(restaurant, compile_turns=True))
    for one, other in zip(compiled, turns(make_env(restaurant)), strict=True):
        assert (one == other).all()


@pytest.mark.slow
def test_environments_are_compiled_each_for_itself(restaurant, monkeypatch):
    monkeypatch.setattr(torch, "compile", partial(torch.compile, backend="eager"))
    with torch._dynamo.config.patch(recompile_limit=2):  # one for the first turn, one for others
        for max_turn in (10, 12):
            env = DialogueEnv(restaurant, batch_size=(2,), max_turn=max_turn, compile_turns=True)
            assert env.rollout(4, break_when_any_done=False).shape == (2, 4)
