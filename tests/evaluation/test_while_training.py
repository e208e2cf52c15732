"""Evaluation while training: what it says, what it keeps, and that training does not notice."""

import dataclasses
import logging

import numpy as np
import pytest
from tiny import TINY, composed, nightly, without_drawing
from torch.testing import assert_close

from bbq_torchrl import load_run
from bbq_torchrl.cli import evaluate as command
from bbq_torchrl.evaluation.curves import read_metrics
from bbq_torchrl.evaluation.run_result import read_result
from bbq_torchrl.runs.train import build_trainer, run
from bbq_torchrl.trainers import evaluate
from bbq_torchrl.utils.seeds import derive_seed

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
)
AGENTS = {
    "new draws, by the dialogue": ("agent=bbqn", "agent.evaluate=thompson", "explore.per=episode"),
    "majority vote": ("agent=bootstrap", "agent.heads=3"),
    "domain extension": ("agent=dqn", "env=domain_ext", "env.start=1", "env.every=2"),
}


def small(*choices):
    return composed(*SMALL, *choices)


def played(config, trainer, actor, round_number):
    """Plays the reported policy with the users of a round in another environment."""
    env = config.env.make(trainer.env.domain, (2, 15))
    env.set_round(round_number)
    seed = derive_seed(config.seed, "evaluate while training", round_number)
    return evaluate(env, config.agent.make_evaluation(actor)[1], 15, seed=seed)


@pytest.mark.parametrize("agent", nightly(AGENTS, ["domain extension"]))
def test_a_row_has_what_the_policy_does_and_training_is_bitwise_the_same(tmp_path, agent):
    learned, rows = [], []
    for every in (0, 2):
        config = small(*AGENTS[agent], "protocol.rounds=4")
        config.protocol.eval_every = every
        trainer, parts = build_trainer(config, tmp_path / str(every))
        trainer.train()
        learned.append(trainer.learner.loss.state_dict())
        rows.append(trainer.metrics.rows)
    assert_close(*learned, rtol=0, atol=0)
    for without, with_it in zip(*rows, strict=True):
        added = {"eval_success_rate", "eval_reward", "eval_turns", "seconds_eval"}
        assert with_it.keys() - without.keys() == added
        same = {name for name in without if not name.startswith("seconds")}
        assert all(with_it[name] == without[name] for name in same)

    metrics = read_metrics(tmp_path / "2")
    evaluated = ~np.isnan(metrics["eval_turns"])
    assert evaluated.tolist() == [[number in (1, 3)] * 2 for number in range(4)]
    assert (metrics["seconds_eval"] < metrics["seconds"]).all()
    if agent == "new draws, by the dialogue":  # drawn anew by each evaluation
        return
    found = played(config, trainer, parts.actor, 3)
    for name, values in found._asdict().items():
        column = {"success": "success_rate"}.get(name, name)
        expected = values.double().mean(-1).tolist()
        assert metrics[f"eval_{column}"][3].tolist() == pytest.approx(expected)


def test_the_best_network_plays_as_it_did(tmp_path):
    config = small("agent=dqn", "protocol.rounds=6", "protocol.eval_every=1")
    with without_drawing():
        run(config, tmp_path)
    given = [f"policy={tmp_path}", "dialogues=15", "weights=best"]
    assert command.evaluation(command.composed(given))["weights"] == "best"

    # The best weights, put back, do with the users of their round what they did then.
    result, metrics = read_result(tmp_path), read_metrics(tmp_path)
    trainer, parts = build_trainer(dataclasses.replace(config, resume="x"), tmp_path)
    trainer.begin(resume=True)
    trainer.evaluator.best.put_back()
    loaded = load_run(tmp_path, dialogues=15, weights="best").policy
    assert_close([*parts.actor.parameters()], [*loaded.parameters()], rtol=0, atol=0)
    for replica, entry in enumerate(result.per_replica):
        found = entry.while_training
        rates = metrics["eval_success_rate"][:, replica]
        expected = (rates.max(), rates.argmax(), rates[-1])
        assert (found.best, found.best_round, found.last) == expected
        assert found.last_five == pytest.approx(rates[1:].mean())
        best = played(config, trainer, parts.actor, int(found.best_round))
        turns = metrics["eval_turns"][int(found.best_round), replica]
        assert best.turns[replica].double().mean().item() == pytest.approx(turns)
        assert best.success[replica].double().mean().item() == pytest.approx(found.best)


def test_a_best_from_before_the_domain_grew_counts_until_the_next_evaluation(tmp_path):
    trainer, _ = build_trainer(small("env=domain_ext", "env.start=2", "env.every=3"), tmp_path)
    slots = len(trainer.env.schedule.additions(trainer.env.domain))
    growth, best, expected = range(2, 2 + 3 * slots, 3), trainer.evaluator.best, -1
    for number in range(3 * slots + 6):
        best.success_rate.fill_(2.0)  # better than any that follows
        trainer.evaluator(number)
        is_new = number == 1 or any(expected < grown <= number for grown in growth)
        if number % 2 and is_new:
            expected = number
        assert best.round.tolist() == [expected] * 2, number


def test_a_run_ends_with_its_success_beside_the_scripted_policies(tmp_path, caplog):
    choices = ("protocol.eval_dialogues=400", "protocol.eval_batch=800", "env.max_turn=40")
    config = small("agent=dqn", "protocol.rounds=1", "protocol.eval_every=0", *choices)
    with caplog.at_level(logging.INFO, "bbq_torchrl"):
        result = run(config, tmp_path)

    domain = config.domain.make()
    assert list(result.scripted) == [*domain.policies, "random"]
    assert list(result.references) == ["clairvoyant"]
    assert result.references["clairvoyant"] > max(result.scripted.values())
    assert str(tmp_path) in caplog.messages[0]
    best = max(domain.policies, key=lambda name: result.scripted[name])
    named = {"DQN": result.success_rate, best: result.scripted[best], **result.references}
    for part, (name, rate) in zip(caplog.messages[-1].split("; "), named.items(), strict=True):
        assert name in part
        assert (f"{rate:.2f}".lstrip("0") if 0.005 <= rate < 0.995 else f"{rate:.0f}") in part

    assert read_result(tmp_path) == result
    assert result.while_training is None
