"""Hyper-parameters of a loss for each replica: as losses that have them alone."""

from __future__ import annotations

import pytest
import torch
from q_transitions import bayes_loss, heads_loss, noisy_loss, plain_loss, transitions

REPLICAS = (3,)
SETTINGS = {
    "noise_std": [0.3, 1.0, 2.7],
    "kl_temperature": [0.0, 0.1, 7.3],
    "gamma": [0.0, 0.9, 1.0],
}
LOSSES = {"bbqn": bayes_loss, "dropout": plain_loss, "heads": heads_loss, "noisy": noisy_loss}
CASES = [("bbqn", name) for name in SETTINGS]
CASES += [(kind, "gamma") for kind in ("dropout", "heads", "noisy")]


def outcome(kind, mask=False, **settings):
    """Everything that a loss returns, and its gradients."""
    torch.manual_seed(0)
    if kind == "bbqn":
        settings["target"] = "mc"
    loss, _ = LOSSES[kind](REPLICAS, **settings)
    td = transitions(REPLICAS, (16,))
    if mask:
        td["valid"] = torch.rand(*REPLICAS, 16) < 0.7
    out = loss(td)
    gradients = torch.autograd.grad(out["loss"], list(loss.parameters()))
    entries = {name: value for name, value in out.items() if name != "loss"}
    return [*entries.values(), *gradients]


@pytest.mark.parametrize("mask", [False, True], ids=["all rows", "some rows"])
@pytest.mark.parametrize(("kind", "name"), CASES)
def test_each_element_is_bitwise_as_where_all_have_its_value(kind, name, mask):
    values = SETTINGS[name]
    together = outcome(kind, mask, **{name: torch.tensor(values, dtype=torch.double)})
    for element, value in enumerate(values):
        alone = outcome(kind, mask, **{name: value})
        for one, other in zip(together, alone, strict=True):
            assert one.shape[:1] == REPLICAS
            assert torch.equal(one[element], other[element])


def test_the_values_are_no_part_of_the_state_and_follow_the_loss():
    loss, _ = bayes_loss(REPLICAS, noise_std=torch.ones(3), kl_temperature=torch.zeros(3))
    plain, _ = bayes_loss(REPLICAS)
    assert loss.state_dict().keys() == plain.state_dict().keys()
    # What is a buffer moves along with its module.
    assert {"noise_std", "kl_temperature"} <= dict(loss.named_buffers()).keys()


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("noise_std", [0.0, 1, 1], "must be positive and finite, got"),
        ("kl_temperature", [-1.0, 1, 1], "must be at least 0 and finite, got"),
        ("gamma", [0.5, 1.5, 0], "must be at least 0 and at most 1, got"),
        ("gamma", [0.5, 0.9], r"must be one number or have the replicas' shape \[3\], got \[2\]"),
    ],
)
def test_a_value_that_is_not_allowed_is_refused(name, values, message):
    with pytest.raises(ValueError, match=f"{name} {message}"):
        bayes_loss(REPLICAS, **{name: torch.tensor(values)})
