"""Result folders of runs that never ran."""

from __future__ import annotations

from typing import TYPE_CHECKING

import yaml

from bbq_torchrl.evaluation import RunResult
from bbq_torchrl.evaluation.results import replica_result, write_json

if TYPE_CHECKING:
    from pathlib import Path

DIALOGUES = 100


def run_result(
    rates: list[float], values: list[dict[str, float]] | None = None, **described: object
) -> RunResult:
    """A result whose replicas have these success rates; they were half as good in training."""
    replicas = [
        replica_result(
            number,
            success=[1.0] * round(rate * DIALOGUES) + [0.0] * (DIALOGUES - round(rate * DIALOGUES)),
            reward=[10.0] * DIALOGUES,
            turns=[8.0] * DIALOGUES,
            training_success=rate / 2,
            values=values[number] if values else None,
        )
        for number, rate in enumerate(rates)
    ]
    given = {
        "agent": "bbqn",
        "explore": "thompson",
        "env": "full",
        "domain": "movie",
        "policy": "mean",
        "seed": 0,
        "rounds": 3,
        "wall_seconds": 1.5,
        "versions": {"torch": "0"},
    }
    return RunResult.of(replicas, **(given | described))


def metrics_text(rates: list[float], rounds: int) -> str:
    lines = ["round,replica,dialogues,success_rate"]
    lines += [f"{r},{n},50,{rate / 2}" for r in range(rounds) for n, rate in enumerate(rates)]
    return "\n".join(lines) + "\n"


def make_run(
    folder: Path,
    rates: list[float],
    *,
    agent: str = "bbqn",
    explore: str = "thompson",
    seed: int = 0,
    rounds: int = 3,
    values: list[dict[str, float]] | None = None,
    **agent_keys: object,
) -> Path:
    """Writes what a finished run leaves behind. Returns the folder."""
    folder.mkdir(parents=True)
    keys = {"target": "map", "prior_std": 0.1} if agent == "bbqn" else {"dropout": 0.5}
    config = {
        "agent": {"name": agent, "lr": 0.001, **keys, **agent_keys},
        "explore": {"name": explore}
        | ({"eps_init": 0.1} if explore == "epsilon_greedy" else {"per": "step"}),
        "env": {"name": "full"},
        "protocol": {"rounds": rounds, "checkpoint_every": 10 + seed},
        "logger": {"name": "csv" if seed else "tensorboard"},
        "seed": seed,
        "replicas": len(rates),
    }
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    (folder / "metrics.csv").write_text(metrics_text(rates, rounds))
    result = run_result(rates, values, agent=agent, explore=explore, seed=seed, rounds=rounds)
    write_json(result, folder / "result.json")
    return folder
