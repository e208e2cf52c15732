"""Activation checkpointing leaves the gradients unchanged."""

from __future__ import annotations

from functools import partial

import pytest
import torch
from q_transitions import bayes_loss, noisy_loss, plain_loss, transitions
from torch.utils.checkpoint import checkpoint

recomputed = partial(checkpoint, use_reentrant=False)


def called(function, *args):
    return function(*args)


def gradients(run, parameters, call):
    """The gradients of the output of ``run``, always with the same draw."""
    torch.manual_seed(0)
    return torch.autograd.grad(run(call), parameters, allow_unused=True)


def assert_the_same(run, parameters):
    expected = gradients(run, parameters, called)
    assert any(slope is not None and slope.any() for slope in expected)
    for found, slope in zip(gradients(run, parameters, recomputed), expected, strict=True):
        assert slope is None if found is None else torch.equal(found, slope)


@pytest.mark.parametrize("make", [bayes_loss, partial(plain_loss, dropout=0.3), noisy_loss])
def test_a_whole_loss_learns_the_same(make):
    loss, _ = make()
    td = transitions()
    assert_the_same(lambda call: call(lambda: loss(td)["loss"]), list(loss.parameters()))
