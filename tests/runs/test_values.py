"""Several values in one run: each replica trains as in a run in which all have its value."""

import json

import pytest
import tiny
from tiny import TINY, nightly, rows
from torch.testing import assert_close

from bbq_torchrl.cli import evaluate
from bbq_torchrl.evaluation.groups import read_groups
from bbq_torchrl.evaluation.run_result import read_result
from bbq_torchrl.runs.train import build_trainer, run

SHRUNKEN = (*TINY, "protocol.batch_size=16", "protocol.eval_every=0")
# Keys that one training can have side by side share it: a replica whose values are not its own in
# any of them differs.
STDS = {"agent.prior_std": [0.05, 0.4]}
GAMMAS = {"agent.gamma": [0.5, 0.95]}
OF_BBQN = {
    "agent.std_init": [0.02, 0.2],
    "agent.noise_std": [0.3, 3.0],
    "agent.kl_temperature": [0.5, 2.0],
}
OF_DQN = {
    "agent.lr": [1e-3, 0.03],
    "explore.eps_init": [0.9, 0.3],
    "explore.eps_end": [0.2, 0.3],
}
OF_VIME = {
    "intrinsic.eta": [0.0, 3.0],
    "explore.temperature_init": [5.0, 0.5],
    "explore.temperature_end": [1.0, 0.1],
}
ANNEALED = "explore.anneal_fraction=1"
GROWING = "env=domain_ext env.start=1 env.every=1"
MC = "agent=bbqn agent.target=mc"
CASES = {
    "BBQN-MC": (MC, STDS | GAMMAS | OF_BBQN),
    "BBQN-MC, no KL": (MC, {"agent.kl_temperature": [0.0, 2.0]}),
    "BBQN-MC, held draws": (f"{MC} explore.per=episode agent.kl=sampled", STDS),
    "BBQN-MAP, extension": (
        f"agent=bbqn agent.std_init=.02 explore=thompson_epsilon {ANNEALED} {GROWING}",
        STDS | {"explore.eps_init": [0.9, 0.3]},
    ),
    "bootstrap": ("agent=bootstrap", GAMMAS),
    "noisy": ("agent=dqn explore=noisy agent.noisy=true agent.dropout=0", GAMMAS),
    "DQN": (f"agent=dqn {ANNEALED}", GAMMAS | OF_DQN),
    "VIME-MAP": ("agent=bbqn intrinsic=vime", {"agent.lr": [1e-3, 0.03]}),
    "VIME-MC, Boltzmann": (
        f"agent=dqn intrinsic=vime intrinsic.weights=mc explore=boltzmann {ANNEALED} "
        "explore.anneal_by=success spike.successes=2",
        OF_VIME,
    ),
}


def composed(choices, values):
    keys = (f"{key}={value}" for key, value in values.items())
    return tiny.composed(*choices.split(), *SHRUNKEN, *keys)


def trained(config, folder):
    """The learned weights, and the metrics but for the times."""
    trainer, _ = build_trainer(config, folder)
    plain = [
        {k: v for k, v in row.items() if not k.startswith("seconds")} for row in trainer.train()
    ]
    return [parameter.detach().clone() for parameter in trainer.learner.optimizer.parameters], plain


DAILY = ("BBQN-MC", "BBQN-MAP, extension", "VIME-MC, Boltzmann")


@pytest.mark.parametrize("case", nightly(CASES, DAILY))
def test_a_replica_trains_bitwise_as_where_all_have_its_value(case, tmp_path):
    choices, values = CASES[case]
    choices += " replicas=2"
    weights, together = trained(composed(choices, values), tmp_path / "both")
    for replica in range(2):
        own = {key: several[replica] for key, several in values.items()}
        alone, expected = trained(composed(choices, own), tmp_path / str(replica))
        mine, theirs = ([one[replica] for one in of] for of in (weights, alone))
        assert_close(mine, theirs, rtol=0, atol=0)
        assert [row for row in together if row["replica"] == replica] == [
            row | own for row in expected if row["replica"] == replica
        ]


@pytest.mark.parametrize("agent", nightly(["bbqn", "bootstrap", "dqn"], ["bbqn"]))
def test_a_replica_that_diverges_is_told_and_left_out_resumed_or_not(agent, tmp_path):
    """tests/trainers/test_replicas.py shows that it leaves the others alone."""
    config = composed(f"agent={agent} replicas=2", {"agent.lr": [1e-3, 1e30]})
    trainer, _ = build_trainer(config, tmp_path / "run", [lambda trainer, _: trainer.stop()])
    trainer.train()
    trainer, _ = build_trainer(config, tmp_path / "run")
    trainer.train(resume=True)
    assert trainer.learner.diverged == {1}

    result = run(config, tmp_path / "whole")
    assert result == read_result(tmp_path / "whole")
    assert result.diverged == (1,)
    assert result.success_rate == result.per_replica[0].success_rate
    assert rows(tmp_path / "whole" / "metrics.csv") == rows(tmp_path / "run" / "metrics.csv")
    assert [len(group.final) for group in read_groups([tmp_path / "whole"])] == [1]


def test_results_say_which_replica_had_which_value(tmp_path):
    finished = tmp_path / "run"
    values = {"agent.prior_std": [0.05, 0.2], "agent.lr": [0.001, 0.002, 0.001, 0.002]}
    run(composed("agent=bbqn replicas=4", values), finished)
    per_replica = json.loads((finished / "result.json").read_text())["per_replica"]
    assert [entry["values"] for entry in per_replica] == [
        {"agent.lr": lr, "agent.prior_std": std} for std in (0.05, 0.2) for lr in (0.001, 0.002)
    ]
    for row in rows(finished / "metrics.csv"):
        values = per_replica[int(row["replica"])]["values"]
        assert {key: float(row[key]) for key in values} == values

    line = evaluate.evaluation(evaluate.composed([f"policy={finished}", "dialogues=6", "batch=3"]))
    assert line["values_per_replica"] == [entry["values"] for entry in per_replica]
    groups = read_groups([finished])
    assert [len(group.final) for group in groups] == [1] * 4
    assert groups[1].label == "Soft BBQN-MAP, agent.lr=0.002"
    assert (finished / "curve.png").read_bytes().startswith(b"\x89PNG")
