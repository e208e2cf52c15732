"""Replicas never change each other: optimizer and sums, one that breaks (see test_values.py)."""

from functools import partial

import pytest
import torch
from tensordict import TensorDict
from torch import nn
from trainer_parts import make_trainer

from bbq_torchrl.data import Batch
from bbq_torchrl.trainers import ReplicaAdam
from bbq_torchrl.trainers.learn import LossSums

LR = (1e-2, 1e-2, 1e-3)


@pytest.mark.parametrize("decay", [0.0, 0.1])
def test_steps_are_bitwise_adams_whoever_is_active_at_whatever_share_of_the_rate(decay):
    kind = partial(torch.optim.AdamW, weight_decay=decay) if decay else torch.optim.Adam
    weight, bias = nn.Parameter(torch.randn(3, 4, 5)), nn.Parameter(torch.randn(3, 7))
    twins = [[p.detach()[r].clone().requires_grad_() for p in (weight, bias)] for r in range(3)]
    frozen = nn.Parameter(torch.ones(2), False)  # is left out
    ours = ReplicaAdam([weight, bias, frozen], 3, lr=LR, weight_decay=decay)
    theirs = [kind(twin, lr=rate, fused=True) for twin, rate in zip(twins, LR, strict=True)]

    for number in range(12):
        active = (True, number % 4 != 3, number % 3 != 2)
        share = (1.0, 0.7, 0.1)[number // 4]
        gradients = [torch.randn_like(weight), torch.randn_like(bias)]
        if number % 5 == 4:
            gradients[1] = None
        for replica, (twin, adam) in enumerate(zip(twins, theirs, strict=True)):
            if active[replica]:
                adam.param_groups[0]["lr"] = LR[replica] * share
                for own, gradient in zip(twin, gradients, strict=True):
                    own.grad = None if gradient is None else gradient[replica].clone()
                adam.step()
            else:
                gradients[0][replica] = torch.nan  # what does not concern a batch means nothing
        weight.grad, bias.grad = gradients
        ours.scale_lr(share)
        ours.step(None if all(active) else active)
        if number == 6:  # what was saved at a fallen rate goes on at whichever comes
            saved = ours.state_dict()
            ours = ReplicaAdam([weight, bias], 3, lr=LR, weight_decay=decay)
            ours.load_state_dict(saved)

    for replica, twin in enumerate(twins):
        assert torch.equal(weight.detach()[replica], twin[0].detach())
        assert torch.equal(bias.detach()[replica], twin[1].detach())


@pytest.mark.parametrize("updates", [1, 63, 64, 65, 200])
def test_sums_of_many_updates_are_those_of_one_after_the_other(updates):
    values = torch.randn(updates, 3) * 10.0 ** torch.randint(-6, 6, (updates, 3))
    expected = torch.zeros(3, dtype=torch.float64)
    for update in values:
        expected += update

    means = [float(total) / updates for total in expected]
    sums, batch = LossSums(3), Batch(TensorDict(valid=torch.ones(3, 1).bool()), (True,) * 3)
    for update in values:
        sums.add(TensorDict(loss_value=update, kl=-update, loss=update.sum()), batch)
    assert sums.means() == {"loss_value": means, "kl": [-mean for mean in means]}


def weights(trainer):
    (weight,) = trainer.learner.optimizer.parameters
    return weight.detach()


def test_where_one_breaks_the_others_learn_on_and_the_state_is_saved(tmp_path):
    plain, broken, other = (
        make_trainer(tmp_path / name, rounds=2) for name in ("plain", "broken", "other")
    )
    broken.callbacks = (lambda trainer, _: weights(trainer)[0, 1].fill_(torch.nan),)
    plain.train()

    broken.train()

    assert torch.equal(weights(plain)[1:], weights(broken)[1:])
    assert len(broken.metrics.rows) == 6
    other.checkpoints.load(tmp_path / "broken" / "checkpoint" / "failed-round-000001.torchrl")
    assert weights(other)[0].isnan().any()
    assert torch.equal(weights(other)[1:], weights(broken)[1:])
