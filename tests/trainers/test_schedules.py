"""Schedules fall as they are asked to, and go on after a resume where they were."""

from __future__ import annotations

import pytest
import torch
from tensordict.nn import TensorDictSequential
from torchrl.data import Categorical
from torchrl.modules import EGreedyModule
from torchrl.objectives import HardUpdate
from trainer_parts import ACTIONS, FEATURES, GuessEnv

from bbq_torchrl.data import ReplicaReplay
from bbq_torchrl.exploration import Boltzmann, Greedy
from bbq_torchrl.networks import FlatMLP, q_actor
from bbq_torchrl.objectives import DropoutDQNLoss
from bbq_torchrl.trainers import ReplicaAdam, RoundSettings, RoundTrainer

START, END, STEPS = 0.9, 0.1, 5
# the value at the start of each round: falls evenly, then stays
SCHEDULE = [0.9, 0.74, 0.58, 0.42, 0.26, 0.1, 0.1]


def explorer(kind):
    """Returns an exploration module and what reads its present value."""
    if kind == "epsilon":
        module = EGreedyModule(
            Categorical(ACTIONS),
            START,
            END,
            annealing_num_steps=STEPS,
            action_mask_key="action_mask",
        )
        return module, lambda: float(module.eps)
    module = Boltzmann(START, END, STEPS)
    return module, lambda: float(module.temperature)


def make_trainer(kind, folder, rounds, **settings):
    replicas = 2
    env = GuessEnv(replicas, 4)
    actor = q_actor(FlatMLP(FEATURES, ACTIONS, (8,), replicas=(replicas,)), Categorical(ACTIONS))
    explore, value = explorer(kind)
    loss = DropoutDQNLoss(actor)
    return RoundTrainer(
        env,
        TensorDictSequential(Greedy(actor), explore),
        loss,
        ReplicaReplay(100, replicas=replicas),
        ReplicaAdam(loss.parameters(), replicas),
        HardUpdate(loss, value_network_update_interval=0),
        RoundSettings(
            rounds=rounds, dialogues=4, batch_size=32, epochs=1, checkpoint_every=1, **settings
        ),
        folder,
        round_metrics={"exploration": value},
        progress=False,
    )


@pytest.mark.parametrize("kind", ["epsilon", "temperature"])
@pytest.mark.parametrize("stops", [(3,), (1, 6)], ids=["halfway", "twice"])
def test_a_resumed_training_goes_on_with_its_schedule(tmp_path, kind, stops):
    for rounds in stops:
        make_trainer(kind, tmp_path, rounds).train(resume=rounds != stops[0])

    rows = make_trainer(kind, tmp_path, len(SCHEDULE)).train(resume=True)

    seen = [row["exploration"] for row in rows if row["replica"] == 0]
    assert seen == pytest.approx(SCHEDULE)


def weights(trainer):
    return [parameter.detach().clone() for parameter in trainer.policy.parameters()]


def trained(folder, stops, **settings):
    """Returns the weights after each of the rounds in which the training stopped."""
    seen = []
    for stop in stops:
        torch.manual_seed(0)  # of the weights that are drawn; a resumed training has saved ones
        trainer = make_trainer("epsilon", folder, max(stops), **settings)
        trainer.begin(resume=folder.exists())
        while trainer.rounds_done < stop:
            trainer.train_round()
        seen.append(weights(trainer))
    return seen


def same(ours, theirs):
    return all(map(torch.equal, ours, theirs))


def test_the_learning_rate_falls_after_its_share_of_the_rounds(tmp_path):
    constant = trained(tmp_path / "constant", (2, 4))
    falls = trained(tmp_path / "falls", (2, 3, 4), lr_final=0.0, lr_decay_from=0.5)

    assert same(falls[0], constant[0])
    assert not same(falls[1], falls[0])  # at half of the rate
    assert same(falls[2], falls[1])  # at 0: nothing moves in the last round
    assert not same(constant[1], falls[2])


def test_a_resumed_training_goes_on_at_the_rate_of_its_round(tmp_path):
    settings = {"lr_final": 0.1, "lr_decay_from": 0.25}
    (through,) = trained(tmp_path / "through", (4,), **settings)
    *_, resumed = trained(tmp_path / "resumed", (1, 2, 3, 4), **settings)
    assert same(through, resumed)
