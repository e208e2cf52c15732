"""A turn never waits for the device."""

import pytest
import torch

from bbq_torchrl.domains import tensorize
from bbq_torchrl.envs import DialogueEnv, ExtensionSchedule
from bbq_torchrl.simulator import ErrorModel, Simulator
from bbq_torchrl.simulator.measured_errors import load_errors
from benchmarks.parts.host_waits import NeverWaits


@pytest.mark.parametrize("users", ["paper", "people"])
def test_neither_a_turn_nor_a_reset_waits_for_the_device(restaurant, users):
    env = DialogueEnv(
        restaurant,
        batch_size=(2, 5),
        slot_error_prob=0.3,
        slot_error_mode="mixed",
        intent_error_prob=0.2,
        schedule=ExtensionSchedule(start=1, every=1),
        users=users,
    )
    state = env.reset()
    state["action"] = env.rand_action()["action"]
    state["_reset"] = torch.rand(2, 5, 1) < 0.5
    with NeverWaits():
        env._step(state)
        env._reset(state)
        env._reset()


@pytest.mark.parametrize("mode", ["value", "slot", "delete", "mixed", "measured"])
def test_everything_that_a_turn_uses_is_on_its_device(movie, restaurant, mode):
    # Tensors on the device "meta" have no numbers: code that reads one, or mixes them with tensors
    # on the CPU, fails.
    domain = movie if mode == "measured" else restaurant
    tensors = tensorize(domain)
    errors = load_errors(domain) if mode == "measured" else ErrorModel(tensors, 0.3, mode, 0.2)
    simulator = Simulator(tensors, errors=errors, users="people").to("meta")
    active = torch.ones(tensors.n_slots, dtype=torch.bool, device="meta")
    action = torch.zeros(7, dtype=torch.int64, device="meta")
    with NeverWaits():
        state = simulator.reset(simulator.draw_reset((7,)), active)
        state = simulator.turn(state, action, simulator.draw_turn((7,)), active)
        features = simulator.observe(state, active)
    assert {features.device.type, *(entry.device.type for entry in state.values(True, True))} == {
        "meta"
    }
