"""Result folders of runs that never ran."""

from dataclasses import asdict

import yaml
from tiny import composed

from bbq_torchrl.evaluation.run_result import RunResult, replica_result, write_json

DIALOGUES = 100


def run_result(rates, values=None, **described):
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


def metrics_text(rates, rounds, eval_every=0):
    """Training success half of the rates; an evaluation is by as many tenths below as rounds are
    missing."""
    lines = ["round,replica,dialogues,success_rate" + (",eval_success_rate" if eval_every else "")]
    for r in range(rounds):
        for n, rate in enumerate(rates):
            line = f"{r},{n},50,{rate / 2}"
            if eval_every:
                is_due = (r + 1) % eval_every == 0
                line += f",{rate - 0.1 * (rounds - 1 - r)}" if is_due else ","
            lines.append(line)
    return "\n".join(lines) + "\n"


def make_run(
    folder,
    rates,
    *,
    agent="bbqn",
    explore=None,
    seed=0,
    rounds=3,
    eval_every=0,
    changes=None,
    values=None,
    references=None,
    scripted=None,
    **agent_keys,
):
    """Writes what a finished run leaves behind. Returns the folder.

    ``changes`` are of the configuration: dotted key to value.
    """
    folder.mkdir(parents=True)
    explore = explore or {"dqn": "epsilon_greedy"}.get(agent, "thompson")
    config = asdict(composed(f"agent={agent}", f"explore={explore}"))
    config |= {"seed": seed, "replicas": len(rates)}
    config["agent"] |= agent_keys
    config["protocol"] |= {"rounds": rounds, "checkpoint_every": 10 + seed}
    config["logger"]["name"] = "csv" if seed else "tensorboard"
    for key, value in (changes or {}).items():
        group, _, name = key.rpartition(".")
        (config[group] if group else config)[name] = value
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    (folder / "metrics.csv").write_text(metrics_text(rates, rounds, eval_every))
    described = {"agent": agent, "explore": explore, "seed": seed, "rounds": rounds}
    described |= {"references": dict(references or {}), "scripted": dict(scripted or {})}
    result = run_result(rates, values, **described)
    write_json(result, folder / "result.json")
    return folder
