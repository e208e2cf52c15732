"""What a search leaves in its folder: a table of all trials, and the best one."""

from __future__ import annotations

import csv
import shlex
from collections import Counter
from io import StringIO
from typing import TYPE_CHECKING, Any

import optuna

from bbq_torchrl.cli.messages import train_command
from bbq_torchrl.evaluation.results import write_json
from bbq_torchrl.run_folder import write_text

if TYPE_CHECKING:
    from bbq_torchrl.cli.searches import Search

__all__ = ["BEST", "TRIALS", "best_trial", "trial_name", "write_tables"]

TRIALS = "trials.csv"
BEST = "best.json"


def trial_name(number: int) -> str:
    """The folder of a trial."""
    return f"trial_{number:04d}"


def best_trial(search: Search, study: optuna.Study) -> dict[str, Any] | None:
    """The best complete trial, and the command that trains it again; None if there is none."""
    trials = study.get_trials(deepcopy=False)
    complete = [item for item in trials if item.state is optuna.trial.TrialState.COMPLETE]
    if not complete:
        return None
    # Of equals the first, however the trials were shared out among processes.
    best = max(complete, key=lambda item: (item.value, -item.number))
    values = {name: best.params[name] for name in search.space}
    return {
        "trial": best.number,
        "value": best.value,
        "objective": search.settings.objective,
        "statistic": search.settings.statistic,
        "values": values,
        "folder": str(search.folder / trial_name(best.number)),
        "command": shlex.join([*train_command(), *search.overrides(values)]),
        "trials": dict(sorted(Counter(item.state.name.lower() for item in trials).items())),
    }


def write_tables(search: Search, study: optuna.Study) -> None:
    """Writes ``trials.csv`` and ``best.json``, atomically."""
    rows = [
        {
            "trial": item.number,
            "state": item.state.name.lower(),
            "value": "" if item.values is None else item.value,
            **{name: item.params.get(name, "") for name in search.space},
            "rounds": len(item.intermediate_values),
            "seconds": "" if item.duration is None else round(item.duration.total_seconds(), 1),
            "folder": trial_name(item.number),
            "reason": item.user_attrs.get("reason", ""),
        }
        for item in study.get_trials(deepcopy=False)
    ]
    text = StringIO()
    writer = csv.DictWriter(text, list(rows[0]))
    writer.writeheader()
    writer.writerows(rows)
    write_text(search.folder / TRIALS, text.getvalue())
    best = best_trial(search, study)
    if best is not None:
        write_json(best, search.folder / BEST)
