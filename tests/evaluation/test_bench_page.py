"""The page of a benchmark: averages over the settings that all agents have finished, no others."""

import math
from itertools import product

import numpy as np

from bbq_torchrl.evaluation.bench_report import bench_report

SETTINGS = [("movie", "0"), ("hotel", "0"), ("hotel", "0.2")]
RATES = {
    ("a", SETTINGS[0]): [0.5, 0.6, 0.7, 0.8, 0.6],
    ("b", SETTINGS[0]): [0.4, 0.6, 0.6, 0.9, 0.5],
    ("a", SETTINGS[1]): [0.1, 0.2, 0.3, 0.2, 0.1],
    ("b", SETTINGS[1]): [0.3, 0.1, 0.4, 0.5, 0.2],
    ("a", SETTINGS[2]): [0.9] * 5,
    ("b", SETTINGS[2]): [0.9] * 4,  # one diverged
}


def test_averages_are_over_what_all_agents_have_finished():
    rows = [
        {"agent": agent, "domain": domain, "errors": errors, "seed": 1, "replica": number}
        | {"booked after 50": rate / 2, "success after 50": rate, "reward": 0.0}
        | {"dialogues to 0.5": 40.0 if number < 3 else math.inf}
        | {f"pass^{k}": rate**k for k in (1, 2, 4, 8)}
        for (agent, (domain, errors)), rates in RATES.items()
        for number, rate in enumerate(rates)
    ]
    given = {"budgets": [50], "seeds": 5, "missing": [], "scripts": {}, "command": "bbq bench"}
    text = str(bench_report(rows, ["a", "b"], SETTINGS, given))
    both = [[RATES[agent, one] for one in SETTINGS[:2]] for agent in "ab"]
    wins = [
        np.mean([(x > y) + 0.5 * (x == y) for x, y in product(mine, theirs)])
        for mine, theirs in zip(*both, strict=True)
    ]
    line = next(line for line in text.splitlines() if line.startswith("| a over b |"))
    assert f"| {np.mean(wins):.3f} [" in line
    assert f"| {np.mean(np.subtract(*both)):+.3f} [" in line
    (iqm,) = (
        line for line in text.splitlines() if line.startswith("| a | 0.") and "5 |" not in line
    )
    middle = np.sort(np.ravel(both[0]))[2:-2].mean()
    assert f"| a | {middle:.3f} [" in iqm
    movie = text.split("### movie, errors 0\n")[1]
    assert "| 40 (3 of 5) |" in movie  # a level that few seeds reach
