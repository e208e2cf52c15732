"""Evaluation while training: what it says, what it keeps, and that training does not notice."""

from __future__ import annotations

import dataclasses
import logging
import math
from typing import TYPE_CHECKING

import numpy as np
import pytest
import torch
from tiny import TINY

from bbq_torchrl import evaluate as command
from bbq_torchrl import load_run
from bbq_torchrl.cli.store import compose
from bbq_torchrl.cli.training import build_trainer
from bbq_torchrl.evaluation.metrics import read_metrics
from bbq_torchrl.evaluation.results import read_result
from bbq_torchrl.evaluation.rollouts import evaluate
from bbq_torchrl.options import ConfigError
from bbq_torchrl.run import run
from bbq_torchrl.trainers import derive_seed

if TYPE_CHECKING:
    from pathlib import Path

    from bbq_torchrl.options import Config
    from bbq_torchrl.trainers import RoundTrainer

SMALL = (
    *TINY,
    "protocol.rounds=3",
    "protocol.eval_dialogues=20",
    "protocol.eval_batch=40",
    "protocol.eval_every=2",
    "protocol.eval_every_dialogues=15",
    "protocol.checkpoint_every=2",
    "spike.policy=random",
    "env.max_turn=12",
    "replicas=2",
    "domain=folder",
)
AGENTS = {
    "mean network": ("agent=bbqn",),
    "new draws, by the dialogue": ("agent=bbqn", "agent.evaluate=thompson", "explore.per=episode"),
    "dropout and epsilon": ("agent=dqn",),
    "majority vote": ("agent=bootstrap", "agent.heads=3"),
    "domain extension": ("env=domain_ext", "env.start=1", "env.every=2"),
}


pytestmark = pytest.mark.usefixtures("without_curves")


@pytest.fixture
def small(restaurant_folder):
    def compose_small(*choices: str) -> Config:
        return compose([*SMALL, f"domain.path={restaurant_folder}", *choices])

    return compose_small


def trained(config: Config, folder: Path) -> RoundTrainer:
    trainer, _ = build_trainer(config, folder)
    trainer.train()
    return trainer


@pytest.mark.parametrize("agent", AGENTS)
def test_training_is_bitwise_the_same_with_and_without(small, tmp_path, agent):
    config = small(*AGENTS[agent])
    with_it = trained(config, tmp_path / "with")
    never = dataclasses.replace(config.protocol, eval_every=0)
    without = trained(dataclasses.replace(config, protocol=never), tmp_path / "without")

    ours, theirs = with_it.loss.state_dict(), without.loss.state_dict()
    assert ours.keys() == theirs.keys()
    assert all(torch.equal(ours[name], theirs[name]) for name in ours)
    assert len(with_it.metrics.rows) == len(without.metrics.rows) == 6
    for ours, theirs in zip(with_it.metrics.rows, without.metrics.rows, strict=True):
        added = {"eval_success_rate", "eval_reward", "eval_turns", "seconds_eval"}
        assert ours.keys() - theirs.keys() == added
        same = {name for name in theirs if not name.startswith("seconds")}
        assert all(ours[name] == theirs[name] for name in same)


@pytest.mark.parametrize("agent", ["mean network", "majority vote", "domain extension"])
def test_a_row_has_what_the_policy_does_at_the_end_of_its_round(small, tmp_path, agent):
    config = small(*AGENTS[agent], "protocol.rounds=4")
    trainer, parts = build_trainer(config, tmp_path / "run")
    trainer.train()
    metrics = read_metrics(tmp_path / "run")
    evaluated = ~np.isnan(metrics["eval_turns"])
    assert evaluated.tolist() == [[number in (1, 3)] * 2 for number in range(4)]
    assert (metrics["seconds_eval"] < metrics["seconds"]).all()

    # By hand: another environment, in the state of the last round, and the same users.
    env = config.env.make(trainer.env.domain, (2, 15))
    env.set_round(3)
    seed = derive_seed(config.seed, "evaluate while training", 3)
    played = evaluate(env, config.agent.make_evaluation(parts.actor)[1], 15, seed=seed)
    for name, values in played._asdict().items():
        column = {"success": "success_rate"}.get(name, name)
        expected = values.double().mean(-1).tolist()
        assert metrics[f"eval_{column}"][3].tolist() == pytest.approx(expected)


def test_the_best_network_plays_as_it_did(small, tmp_path):
    config = small("agent=dqn", "protocol.rounds=7", "protocol.eval_every=1")
    run(config, tmp_path)
    given = [f"policy={tmp_path}", "dialogues=15", "weights=best"]
    line = command.evaluation(command.composed(given))
    assert line["weights"] == "best"

    # The best weights, put back, do with the users of their round what they did then.
    result, metrics = read_result(tmp_path), read_metrics(tmp_path)
    trainer, parts = build_trainer(dataclasses.replace(config, resume="x"), tmp_path)
    trainer.begin(resume=True)
    trainer.evaluator.best.put_back()
    loaded = load_run(tmp_path, dialogues=15, weights="best").policy
    for ours, theirs in zip(parts.actor.parameters(), loaded.parameters(), strict=True):
        assert torch.equal(ours, theirs)
    for replica, entry in enumerate(result.per_replica):
        found = entry.while_training
        rates = metrics["eval_success_rate"][:, replica]
        assert found.best == rates.max()
        assert found.best_round == rates.argmax()
        assert found.last == rates[-1]
        assert found.last_five == pytest.approx(rates[2:].mean())
        env = config.env.make(trainer.env.domain, (2, 15))
        seed = derive_seed(config.seed, "evaluate while training", int(found.best_round))
        played = evaluate(env, config.agent.make_evaluation(parts.actor)[1], 15, seed=seed)
        turns = metrics["eval_turns"][int(found.best_round), replica]
        assert played.turns[replica].double().mean().item() == pytest.approx(turns)
        assert played.success[replica].double().mean().item() == pytest.approx(found.best)


def test_a_best_from_before_the_domain_grew_does_not_count(small, tmp_path):
    config = small("env=domain_ext", "env.start=2", "env.every=2", "protocol.eval_every=1")
    trainer, _ = build_trainer(config, tmp_path)
    evaluator, grown = trainer.evaluator, len(trainer.env.schedule.additions(trainer.env.domain))
    for number in range(2 * grown + 6):
        evaluator.best.success_rate.fill_(2.0)  # better than any that follows
        evaluator(number)
        # In rounds 0, 2, 4, ... something was new; later the domain is complete.
        is_new = number == 0 or (2 <= number <= 2 * grown and number % 2 == 0)
        assert ((evaluator.best.round == number) == is_new).all(), number


def test_a_best_from_before_the_domain_grew_counts_until_the_next_evaluation(small, tmp_path):
    trainer, _ = build_trainer(small("env=domain_ext", "env.start=2", "env.every=9"), tmp_path)
    best = trainer.evaluator.best
    for number, expected in enumerate([-1, 1, 1, 3]):  # the domain grows in round 2
        trainer.evaluator(number)
        assert best.round.tolist() == [expected] * 2
        best.success_rate.fill_(2.0)  # better than any that follows


@pytest.mark.parametrize(
    ("choices", "said"),
    [
        (["protocol.eval_every=0"], "no evaluation while training: protocol.eval_every is 0"),
        (["protocol.eval_every=9"], "protocol.eval_every (9) is more than protocol.rounds (1)"),
        ([], None),
    ],
)
def test_a_run_says_that_it_is_not_evaluated_while_training(small, tmp_path, caplog, choices, said):
    config = small("protocol.rounds=1", "protocol.eval_every=1", *choices)
    with caplog.at_level(logging.INFO, "bbq_torchrl"):
        result = run(config, tmp_path)

    assert ("no evaluation while training" in caplog.text) == (said is not None)
    assert said is None or said in caplog.text
    assert (result.while_training is None) == (said is not None)
    assert read_result(tmp_path) == result
    if said is not None:
        with pytest.raises(ConfigError, match=rf"weights must be last for {tmp_path}.*got 'best'"):
            command.evaluation(
                command.composed([f"policy={tmp_path}", "dialogues=5", "weights=best"])
            )


def test_a_run_ends_with_its_success_beside_the_scripted_policies(small, tmp_path, caplog):
    choices = ("protocol.eval_dialogues=400", "protocol.eval_batch=800", "env.max_turn=40")
    config = small("agent=dqn", "protocol.rounds=1", *choices)
    with caplog.at_level(logging.INFO, "bbq_torchrl"):
        result = run(config, tmp_path)

    domain = config.domain.make()
    assert list(result.scripted) == [*domain.policies, "random"]
    assert list(result.references) == ["clairvoyant"]
    assert result.references["clairvoyant"] > max(result.scripted.values())
    line = next(text for text in caplog.messages if " books " in text)
    assert line.startswith("DQN books ")
    assert "over 2 replicas (" in line
    assert "privileged clairvoyant ." in line
    for name, rate in result.scripted.items():
        given = [f"policy={name}", "dialogues=1000", "seed=5", "domain=folder"]
        alone = command.evaluation(command.composed([*given, f"domain.path={config.domain.path}"]))
        # 400 dialogues and 1,000 others: at most five standard errors apart.
        spread = math.sqrt(0.25 / 400 + 0.25 / 1000)
        assert rate == pytest.approx(alone["success_rate"], abs=5 * spread)
        shown = f"{rate:.2f}".lstrip("0") if 0.005 <= rate < 0.995 else f"{rate:.0f}"
        assert f"{name.replace('_', ' ')} {shown}" in line
