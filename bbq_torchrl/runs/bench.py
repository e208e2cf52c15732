"""The cells of a benchmark: agents in settings, trained and played as ordinary runs."""

from __future__ import annotations

import json
import math
import shlex
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch

from bbq_torchrl.evaluation.bench import setting_name
from bbq_torchrl.evaluation.rollouts import evaluation_rollouts
from bbq_torchrl.evaluation.run_result import write_json
from bbq_torchrl.runs.build import check_resources
from bbq_torchrl.runs.compose import compose, train_command
from bbq_torchrl.runs.folders import is_finished, restarted_config, run_lock
from bbq_torchrl.runs.loading import load_run
from bbq_torchrl.runs.train import run
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.trainers import TrainingError, derive_seed, episode_stats
from bbq_torchrl.utils.text import sentence

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from bbq_torchrl.evaluation.bench import Setting
    from bbq_torchrl.options import Config

PLAYS = 20
"""Mean number of plays of a goal for pass^k: fewer than 8 are rare."""

_PLAYED = "plays.json"


@dataclass(frozen=True)
class Cell:
    """An agent in a setting.

    Attributes:
        agent: the agent's name.
        setting: domain and error level.
        folder: the run folder.
        overrides: those of ``bbq train``.
        config: their configuration.
    """

    agent: str
    setting: Setting
    folder: Path
    overrides: tuple[str, ...]
    config: Config

    @property
    def name(self) -> str:
        """Such as ``dqn on movie, errors 0``."""
        return f"{self.agent} on {setting_name(self.setting)}"

    @property
    def is_played(self) -> bool:
        """True if the cell is trained, and its goals were played."""
        return (self.folder / _PLAYED).is_file()

    def played(self) -> tuple[Any, Any]:
        """Returns plays and successes, [replicas, goals] each."""
        content = json.loads((self.folder / _PLAYED).read_text(encoding="utf-8"))
        return content["plays"], content["successes"]

    @property
    def command(self) -> str:
        """The command that trains the cell by itself."""
        return shlex.join([*train_command(), *self.overrides])


def cells_of(
    agent: str,
    overrides: Sequence[str],
    *,
    folder: Path,
    domains: Mapping[str, Sequence[str]],
    errors: Sequence[str],
    budgets: Sequence[int],
    seeds: int,
    seed: int,
) -> list[Cell]:
    """Returns the cells of an agent: a run folder for each domain and error level.

    Args:
        agent: the agent's name.
        overrides: those of ``bbq train`` that make the agent.
        folder: the folder of the bench.
        domains: name -> overrides.
        errors: slot error probabilities, or ``reference``.
        budgets: numbers of training dialogues, in order.
        seeds: number of seeds.
        seed: the run's seed.

    Raises:
        ConfigError: a budget is not whole rounds, or a configuration is refused.
    """
    dialogues = compose(overrides).protocol.dialogues
    if uneven := [budget for budget in budgets if budget % dialogues]:
        raise ConfigError(
            f"--budgets must be multiples of a round's {dialogues} dialogues "
            f"(protocol.dialogues), got {', '.join(map(str, uneven))}"
        )
    shared = [
        *overrides,
        f"seed={seed}",
        f"replicas={seeds}",
        f"protocol.rounds={budgets[-1] // dialogues}",
        f"protocol.eval_every={math.gcd(*budgets) // dialogues}",
    ]
    cells = []
    for domain, own in domains.items():
        for level in dict.fromkeys(errors):
            chance = "null" if level == "reference" else level
            whole = (*shared, *own, f"env.slot_error_prob={chance}")
            place = folder / domain / f"errors_{level}" / agent
            cells.append(Cell(agent, (domain, level), place, whole, compose(whole)))
    return cells


def refuse_invalid(cell: Cell, *, to_train: bool) -> None:
    """Checks the run in a cell's folder and, as ``bbq train`` does, what is to be trained."""
    try:
        restarted_config(cell.config, cell.folder, way="choose another folder for this bench")
        if to_train:
            check_resources(cell.config)
    except (ValueError, OSError) as error:
        raise ConfigError(f"{cell.name}: {sentence(error)}") from error


def play(cell: Cell) -> str:
    """Trains a cell and plays its goals again and again. Returns why it could not; else empty."""
    try:
        with run_lock(cell.folder):
            config = restarted_config(cell.config, cell.folder)
            if not is_finished(cell.folder, config.protocol.rounds):
                run(config, cell.folder)
            if not cell.is_played:
                write_json(goal_plays(cell), cell.folder / _PLAYED)
    except (TrainingError, ConfigError) as error:  # also another process at work in the folder
        return sentence(error)
    return ""


def goal_plays(cell: Cell) -> dict[str, Any]:
    """Plays a trained cell's goals. Returns plays and successes, [replicas, goals] each."""
    config = cell.config
    goals = len(config.domain.make().goals)
    dialogues = PLAYS * goals
    parallel = config.protocol.parallel_dialogues(dialogues, config.replicas)
    env, policy, *_ = load_run(cell.folder, dialogues=parallel, device=config.device)
    plays, wins = torch.zeros(2, config.replicas, goals, dtype=torch.int64, device=config.device)
    seed = derive_seed(config.seed, "pass^k")
    for batch in evaluation_rollouts(
        env, policy, dialogues, seed=seed, max_steps=config.env.steps()
    ):
        goal, success = batch["goal_id"][..., 0, 0], episode_stats(batch).success.long()
        plays.scatter_add_(-1, goal, torch.ones_like(goal))
        wins.scatter_add_(-1, goal, success)
    return {"plays": plays.tolist(), "successes": wins.tolist()}
