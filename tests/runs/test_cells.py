"""Every agent with every exploration: trains, resumes and evaluates."""

import dataclasses
from itertools import cycle, product

import pytest
import tiny
import torch
from adversary.folders import state
from tiny import TINY, nightly, rows

from bbq_torchrl.cli import evaluate
from bbq_torchrl.evaluation.curves import read_metrics
from bbq_torchrl.options import Task, explorations, schemas
from bbq_torchrl.runs.train import build_trainer, run
from bbq_torchrl.trainers import losses_of
from benchmarks.parts.host_waits import NeverWaits, drawn_as_on_a_device

SHRUNKEN = (*TINY, "spike.policy=random", "replicas=2")
EXTENSION = ("env.start=1", "env.every=1")
NEEDED = {
    ("dqn", "noisy"): ("agent.noisy=true", "agent.dropout=0"),
    ("gp", None): ("agent.inducing=8",),
}
# Each pair once, its environment and reward in turn, so that each agent meets all four of them.
PAIRS = [(agent, explore) for agent, explores in explorations().items() for explore in explores]
SURROUNDINGS = cycle(product(schemas()["env"], schemas()["intrinsic"]))
CELLS = {
    f"{agent}-{explore}-{env}-{intrinsic}": (
        *(f"agent={agent}", f"explore={explore}", f"env={env}", f"intrinsic={intrinsic}"),
        *NEEDED.get((agent, explore), NEEDED.get((agent, None), ())),
    )
    for (agent, explore), (env, intrinsic) in zip(PAIRS, SURROUNDINGS, strict=False)
}
CELLS |= {
    "GP": ("env=domain_ext", "agent=gp", "agent.inducing=8", "explore.per=episode"),
    "BBQN-MC": ("env=domain_ext", "agent.target=mc"),
    "sampled KL": ("env=full", "agent.kl=sampled"),
    "shared target noise": ("env=domain_ext", "agent.target=mc", "agent.target_noise=shared"),
    "separate networks with priors": (
        *("env=domain_ext", "agent=bootstrap", "agent.trunk_layers=0"),
        *("agent.prior_scale=3", "agent.double=true"),
    ),
    "VIME-MC": ("env=domain_ext", "intrinsic=vime", "intrinsic.weights=mc"),
    "dynamics now and then": (
        *("env=domain_ext", "agent=dqn", "intrinsic=vime", "intrinsic.dynamics_every=3"),
    ),
}

DAILY = (  # each agent, environment and reward; each strategy trains in some other daily test
    "bbqn-thompson_boltzmann-domain_ext-none",
    "bootstrap-bootstrap-full-none",
    "dqn-epsilon_greedy-domain_ext-vime",
    "gp-greedy-domain_ext-none",
)

pytestmark = pytest.mark.usefixtures("without_curves")


def composed(*choices):
    extension = EXTENSION if "env=domain_ext" in choices else ()
    return tiny.composed(*SHRUNKEN, *extension, *choices)


@pytest.mark.parametrize("cell", nightly(CELLS, DAILY))
def test_a_cell_trains_at_once_or_resumed_bitwise_the_same_and_evaluates(cell, tmp_path):
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    config = composed(*CELLS[cell])
    result, seen = run(config, whole), []
    one_round = dataclasses.replace(config.protocol, rounds=1)
    run(dataclasses.replace(config, protocol=one_round), parts)
    again = dataclasses.replace(config, resume=str(parts))
    resumed = run(again, parts, [lambda trainer, _: seen.append(trainer.rounds_done)])

    assert seen == [2]
    assert state(whole) == state(parts)
    assert len(result.per_replica) == 2
    assert resumed.per_replica == result.per_replica
    assert rows(whole / "metrics.csv") == rows(parts / "metrics.csv")

    line = evaluate.evaluation(evaluate.composed([f"policy={parts}", "dialogues=6", "batch=6"]))
    assert line["dialogues"] == 12
    assert 0 <= line["success_rate"] <= 1


# A Gaussian process is fitted, not updated.
UPDATED = [cell for cell in CELLS if "gp" not in cell.lower()]
WAITING = ("bootstrap-bootstrap-full-none", "BBQN-MC", "dqn-noisy-domain_ext-none")


@pytest.mark.filterwarnings("ignore:No target network updater")  # on a device without numbers
@pytest.mark.parametrize("cell", nightly(UPDATED, WAITING))
def test_a_cells_updates_never_wait_and_find_all_on_their_device(cell, tmp_path):
    config = composed(*CELLS[cell], "protocol.batch_size=6", "env.max_turn=16")
    trainer, _ = build_trainer(config, tmp_path)
    with drawn_as_on_a_device():
        trainer.begin()
        trainer.train_round()
        with NeverWaits():
            trainer.learner.update_all(1)

    trainer.learner.compute_targets()
    batch = trainer.replay.epoch(8)[0].transitions.to("meta")
    # Tensors on the device "meta" have no numbers: whatever asks for one, or mixes them with
    # tensors of the CPU, fails.
    env, device = trainer.env, torch.device("meta")
    task = Task(env.layout.size, env.action_spec_unbatched, replicas=2, rounds=2, device=device)
    q_loss = config.agent.make_loss(config.agent.make_actor(task), task)
    loss, _ = config.intrinsic.make(q_loss, task)
    for part in losses_of(loss):
        if hasattr(part, "set_num_data"):
            part.set_num_data(10)
    with NeverWaits():
        sum(part(batch)["loss"] for part in losses_of(loss)).backward()
    gradients = [p.grad for p in loss.parameters() if p.requires_grad]
    assert {gradient.device for gradient in gradients} == {device}


def test_an_intrinsic_reward_is_learned_from_and_never_reported(tmp_path):
    """Before anything is learned the two play alike, so whatever differs would be the bonus."""
    rounds = {}
    for name, eta in (("none", ()), ("vime", ("intrinsic.eta=1000",))):
        config = composed("agent=dqn", f"intrinsic={name}", "protocol.rounds=1", *eta)
        result = run(config, tmp_path / name)
        rounds[name] = read_metrics(tmp_path / name)
        assert result.reward <= config.env.success_reward

    for column in ("reward", "success_rate", "turns"):
        assert (rounds["none"][column] == rounds["vime"][column]).all()
    assert (rounds["vime"]["td_error"] > 10 * rounds["none"]["td_error"]).all()


@pytest.mark.parametrize(
    ("fraction", "epsilons"),
    [(0, [0.5, 0.1, 0.1, 0.1]), (0.5, [0.5, 0.3, 0.1, 0.1]), (1, [0.5, 0.4, 0.3, 0.2])],
)
def test_a_schedule_falls_over_its_share_of_the_rounds(fraction, epsilons, tmp_path):
    given = ("explore.eps_init=.5", "explore.eps_end=.1", f"explore.anneal_fraction={fraction}")
    config = tiny.composed("agent=dqn", *TINY, "protocol.rounds=4", *given)
    trainer, _ = build_trainer(config, tmp_path)
    assert [row["epsilon"] for row in trainer.train()] == pytest.approx(epsilons)
