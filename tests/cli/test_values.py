"""Several values in one run: each replica trains as in a run in which all have its value."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import pytest
import torch
from tiny import TINY, rows

from bbq_torchrl import evaluate
from bbq_torchrl.cli.store import compose
from bbq_torchrl.cli.training import build_trainer
from bbq_torchrl.evaluation.groups import read_groups
from bbq_torchrl.run import run

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

SHRUNKEN = (*TINY, "protocol.batch_size=16", "protocol.eval_every=0")
# Keys that one training can have side by side share it: a replica whose values are not its own in
# any of them differs.
CASES: dict[str, tuple[tuple[str, ...], dict[str, list[float]]]] = {
    "BBQN-MC": (
        ("agent=bbqn", "agent.target=mc"),
        {
            "agent.prior_std": [0.05, 0.4],
            "agent.std_init": [0.02, 0.2],
            "agent.noise_std": [0.3, 3.0],
            "agent.kl_temperature": [0.5, 2.0],
            "agent.gamma": [0.5, 0.95],
        },
    ),
    "BBQN-MC, no KL": (("agent=bbqn", "agent.target=mc"), {"agent.kl_temperature": [0.0, 2.0]}),
    "BBQN-MC, held draws": (
        ("agent=bbqn", "agent.target=mc", "explore.per=episode", "agent.kl=sampled"),
        {"agent.prior_std": [0.05, 0.4]},
    ),
    "BBQN-MAP, extension": (
        (
            *("agent=bbqn", "agent.std_init=.02", "env=domain_ext", "env.start=1", "env.every=1"),
            *("explore=thompson_epsilon", "explore.anneal_fraction=1"),
        ),
        {"agent.prior_std": [0.05, 0.4], "explore.eps_init": [0.9, 0.3]},
    ),
    "bootstrap": (("agent=bootstrap",), {"agent.gamma": [0.5, 0.95]}),
    "noisy": (
        ("agent=dqn", "explore=noisy", "agent.noisy=true", "agent.dropout=0"),
        {"agent.gamma": [0.5, 0.95]},
    ),
    "DQN": (
        ("agent=dqn", "explore.anneal_fraction=1"),
        {
            "agent.lr": [1e-3, 0.03],
            "agent.gamma": [0.5, 0.95],
            "explore.eps_init": [0.9, 0.3],
            "explore.eps_end": [0.2, 0.3],
        },
    ),
    "VIME-MAP": (("agent=bbqn", "intrinsic=vime"), {"agent.lr": [1e-3, 0.03]}),
    "VIME-MC, Boltzmann": (
        (
            *("agent=dqn", "intrinsic=vime", "intrinsic.weights=mc"),
            *("explore=boltzmann", "explore.anneal_fraction=1"),
        ),
        {
            "intrinsic.eta": [0.0, 3.0],
            "explore.temperature_init": [5.0, 0.5],
            "explore.temperature_end": [1.0, 0.1],
        },
    ),
}


def overrides(choices: Sequence[str], values: dict[str, Any], domain: Path) -> list[str]:
    given = [f"{key}={value}" for key, value in values.items()]
    return [*choices, *SHRUNKEN, *given, "domain=folder", f"domain.path={domain}"]


def trained(command: list[str], folder: Path) -> tuple[list[torch.Tensor], list[dict[str, Any]]]:
    """What is learned, and the metrics but for the times."""
    trainer, _ = build_trainer(compose(command), folder)
    plain = [
        {k: v for k, v in row.items() if not k.startswith("seconds")} for row in trainer.train()
    ]
    return [parameter.detach().clone() for parameter in trainer.optimizer.parameters], plain


@pytest.mark.parametrize("case", CASES)
def test_a_replica_trains_bitwise_as_where_all_have_its_value(case, restaurant_folder, tmp_path):
    choices, values = CASES[case]
    weights, together = trained(
        ["replicas=2", *overrides(choices, values, restaurant_folder)], tmp_path / "both"
    )
    for replica in range(2):
        own = {key: several[replica] for key, several in values.items()}
        alone, expected = trained(
            ["replicas=2", *overrides(choices, own, restaurant_folder)], tmp_path / str(replica)
        )
        assert all(
            torch.equal(one[replica], other[replica])
            for one, other in zip(weights, alone, strict=True)
        )
        ours = [row for row in together if row["replica"] == replica]
        theirs = [row | own for row in expected if row["replica"] == replica]
        assert ours == theirs


@pytest.fixture
def finished(restaurant_folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run of four replicas, two of each value of one key and one of each of another."""
    folder = tmp_path / "run"
    folder.mkdir()
    values = {"agent.prior_std": "[.05,.2]", "agent.lr": "[.001,.002,.001,.002]"}
    run(compose(["replicas=4", *overrides(["agent=bbqn"], values, restaurant_folder)]), folder)
    return folder


def test_results_say_which_replica_had_which_value(finished):
    per_replica = json.loads((finished / "result.json").read_text())["per_replica"]
    assert [entry["values"] for entry in per_replica] == [
        {"agent.lr": 0.001, "agent.prior_std": 0.05},
        {"agent.lr": 0.002, "agent.prior_std": 0.05},
        {"agent.lr": 0.001, "agent.prior_std": 0.2},
        {"agent.lr": 0.002, "agent.prior_std": 0.2},
    ]
    for row in rows(finished / "metrics.csv"):
        values = per_replica[int(row["replica"])]["values"]
        assert {key: float(row[key]) for key in values} == values

    line = evaluate.evaluation(evaluate.composed([f"policy={finished}", "dialogues=6", "batch=3"]))
    assert line["values_per_replica"] == [entry["values"] for entry in per_replica]
    groups = read_groups([finished])
    assert [len(group.final) for group in groups] == [1] * 4
    assert groups[1].label == "BBQN-MAP, agent.lr=0.002, agent.prior_std=0.05"
    assert (finished / "curve.png").read_bytes().startswith(b"\x89PNG")
