"""``bbq bench``: trains agents on several domains, error levels and seeds, and compares them.

A cell is an agent in a setting (a domain at an error level): a run folder with a replica for each
seed, trained to the largest budget by the pipeline of ``bbq train``.
"""

from __future__ import annotations

import json
import logging
import math
import shlex
import sys
from argparse import Namespace
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from bbq_torchrl.options import Config
from bbq_torchrl.options.registry import EXPERIMENT, load_folder, options
from bbq_torchrl.runs.compose import compose, key_of, train_command
from bbq_torchrl.runs.folders import is_finished, restarted_config, run_lock
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.utils import interruption, output
from bbq_torchrl.utils.files import write_text
from bbq_torchrl.utils.output import between, page
from bbq_torchrl.utils.text import sentence

_LOG = logging.getLogger(__name__)

DOMAINS = ("movie", "hotel", "restaurant")
ERRORS = ("0", "reference", "0.2")
BUDGETS = (500, 1_000, 2_000, 7_500)
SEEDS = 10

PLAYS = 20
"""Mean number of plays of a goal for pass^k: fewer than 8 are rare."""

_PLAYED, _FAILED = "plays.json", "failed.txt"
"""Files of an ended cell: plays and successes of its goals, or the error that ended it."""

_SET = (
    *("seed", "replicas", "resume", "domain", "hydra", "env.slot_error_prob"),
    *("protocol.rounds", "protocol.eval_every"),
)
"""Keys that the bench sets."""


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
    setting: tuple[str, str]
    folder: Path
    overrides: tuple[str, ...]
    config: Config

    @property
    def name(self) -> str:
        """Such as ``dqn on movie, errors 0``."""
        return f"{self.agent} on {self.setting[0]}, errors {self.setting[1]}"

    @property
    def is_played(self) -> bool:
        """True if the cell is trained, and its goals were played."""
        return (self.folder / _PLAYED).is_file()

    @property
    def failure(self) -> str:
        """The error that ended the cell; empty without one."""
        file = self.folder / _FAILED
        return file.read_text("utf-8") if file.is_file() else ""


@output.refusing
def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line. Returns the exit code: 1 if a cell is missing at the end."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    interruption.tell(lambda: "in a benchmark", lambda: "the same command continues it")
    given = _parser().parse_args(arguments)
    if given.config_dir is not None:
        load_folder(given.config_dir)
    agents, domains = _agents(given.agents), _domains(given.domains)
    for item in chain(given.set, *agents.values()):
        if {key_of(item), key_of(item).partition(".")[0]} & set(_SET):
            raise ConfigError(
                f"{sentence(item)} cannot be given to a bench, which sets {', '.join(_SET)} itself"
            )
    given.budgets = sorted(set(given.budgets))
    cells = [
        cell
        for agent, overrides in agents.items()
        for cell in cells_of(agent, [*given.set, *overrides], domains, given)
    ]
    for cell in cells:
        _refuse_invalid(cell, to_train=not given.page)
    given.folder.mkdir(parents=True, exist_ok=True)
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
    for number, cell in enumerate([] if given.page else cells, 1):
        interruption.check()
        _LOG.info("cell %d of %d: %s", number, len(cells), cell.name)
        play(cell)
    missing = [
        f"{cell.name} ({cell.failure or 'not trained'})" for cell in cells if not cell.is_played
    ]
    trained = [item for item in arguments if item != "--page"]
    report = _write(given, shlex.join(["bbq", "bench", *trained]), cells, missing)
    for line in missing:
        output.print_error(f"missing: {line}")
    output.write(report)
    return 1 if missing else 0


def _parser() -> output.Parser:
    parser = output.Parser(
        prog="bbq bench",
        description="Trains agents on several domains, error levels and seeds, and compares them.\n"
        "The same command continues; several at once share the cells.\n"
        f"Put your agent on the table: {page('your_agent')}",
    )
    parser.add_argument("folder", type=Path, help="folder of the cells, the page and its data")
    parser.add_argument(
        "--agents",
        nargs="+",
        required=True,
        help="recipes of conf/experiment/agents, such as bbqn_map, or of your own: "
        "'<name>: agent=<option> <key>=<value> ...'",
    )
    parser.add_argument(
        "--domains",
        nargs="+",
        default=list(DOMAINS),
        help="options of domain=, with their folder if they need one: miulab=<folder>, "
        "folder=<domain folder>; default: %(default)s",
    )
    parser.add_argument(
        "--errors",
        nargs="+",
        type=_error,
        default=list(ERRORS),
        help="slot error probabilities, or reference: the domain's calibrated one; default: "
        "%(default)s",
    )
    parser.add_argument(
        "--budgets",
        nargs="+",
        type=between(int, 1, 10**7),
        default=list(BUDGETS),
        help="numbers of training dialogues; default: %(default)s",
    )
    parser.add_argument(
        "--seeds", type=between(int, 1, 10_000), default=SEEDS, help="default: %(default)s"
    )
    parser.add_argument("--seed", type=between(int, 0, 2**63 - 1), default=1, help="of all seeds")
    parser.add_argument(
        "--set", nargs="+", default=[], help="keys of bbq train for all cells, as protocol=quick"
    )
    parser.add_argument("--page", action="store_true", help="write the page only, train nothing")
    parser.add_argument("--config-dir", type=Path, help="folder of your own options")
    return parser


def _error(text: str) -> str:
    return text if text == "reference" else f"{between(float, 0, 1)(text):g}"


def _agents(given: Sequence[str]) -> dict[str, list[str]]:
    """Returns name -> overrides of ``bbq train``; Hydra refuses a recipe that it does not find."""
    agents: dict[str, list[str]] = {}
    for text in given:
        name, colon, own = text.partition(":")
        if colon:
            overrides = shlex.split(own)
        else:
            within = f"agents/{name}" in options(EXPERIMENT)
            overrides = [f"+{EXPERIMENT}={f'agents/{name}' if within else name}"]
        name = name.replace("/", "_")
        if name in agents:
            raise ConfigError(f"--agents must have distinct names, got {name} twice")
        agents[name] = overrides
    return agents


def _domains(given: Sequence[str]) -> dict[str, list[str]]:
    """Returns name -> overrides; a domain in a folder has the folder's name."""
    domains: dict[str, list[str]] = {}
    for text in given:
        option, has_path, path = text.partition("=")
        name = Path(path).resolve().name if option == "folder" else option
        if name in domains:
            raise ConfigError(f"--domains must have distinct names, got {name} twice")
        domains[name] = [f"domain={option}", *([f"domain.path='{path}'"] if has_path else [])]
    return domains


def cells_of(
    agent: str,
    overrides: Sequence[str],
    domains: Mapping[str, Sequence[str]],
    given: Namespace,
) -> list[Cell]:
    """Returns the cells of an agent: a run folder for each domain and error level.

    Args:
        agent: the agent's name.
        overrides: those of ``bbq train`` that make the agent.
        domains: name -> overrides.
        given: the command line, with its budgets in order.

    Raises:
        ConfigError: a budget is not whole rounds, or a configuration is refused.
    """
    budgets, seeds = given.budgets, given.seeds
    dialogues = compose([*overrides, f"replicas={seeds}"]).protocol.dialogues
    if uneven := [budget for budget in budgets if budget % dialogues]:
        raise ConfigError(
            f"--budgets must be multiples of a round's {dialogues} dialogues "
            f"(protocol.dialogues), got {', '.join(map(str, uneven))}"
        )
    shared = [
        *overrides,
        f"seed={given.seed}",
        f"replicas={seeds}",
        f"protocol.rounds={budgets[-1] // dialogues}",
        f"protocol.eval_every={math.gcd(*budgets) // dialogues}",
    ]
    cells = []
    for domain, own in domains.items():
        for level in dict.fromkeys(given.errors):
            chance = "null" if level == "reference" else level
            whole = (*shared, *own, f"env.slot_error_prob={chance}")
            place = given.folder / domain / f"errors_{level}" / agent
            cells.append(Cell(agent, (domain, level), place, whole, compose(whole)))
    return cells


def _refuse_invalid(cell: Cell, *, to_train: bool) -> None:
    """Checks the run in a cell's folder and, as ``bbq train`` does, what is to be trained."""
    from bbq_torchrl.runs.build import check_resources

    try:
        restarted_config(cell.config, cell.folder, way="choose another folder for this bench")
        if to_train:
            check_resources(cell.config)
    except (ValueError, OSError) as error:
        raise ConfigError(f"{cell.name}: {sentence(error)}") from error


def play(cell: Cell) -> None:
    """Trains a cell, unless another process does, and plays its goals again and again.

    An error is kept in the cell's folder, so that the same command does not train the cell again.
    An OSError, such as a full disk, ends the bench.
    """
    from bbq_torchrl.evaluation.run_result import write_json
    from bbq_torchrl.runs.build import FORESEEN
    from bbq_torchrl.runs.train import run

    try:
        with run_lock(cell.folder):
            if cell.failure:
                return
            config = restarted_config(cell.config, cell.folder)
            try:
                if not is_finished(cell.folder, config.protocol.rounds):
                    run(config, cell.folder)
                if not cell.is_played:
                    write_json(goal_plays(cell), cell.folder / _PLAYED)
            except OSError:
                raise
            except Exception as error:
                is_known = isinstance(error, FORESEEN)
                reason = sentence(error if is_known else f"{type(error).__name__}: {error}")
                _LOG.error("%s failed: %s", cell.name, reason, exc_info=not is_known)
                if cell.folder.is_dir():  # it may have been moved
                    write_text(cell.folder / _FAILED, reason)
    except ConfigError as error:  # another process at work in the folder
        _LOG.warning("%s: %s", cell.name, sentence(error))


def goal_plays(cell: Cell) -> dict[str, Any]:
    """Plays a trained cell's goals. Returns plays and successes, [replicas, goals] each."""
    import torch

    from bbq_torchrl.runs.loading import load_run
    from bbq_torchrl.trainers import episode_stats, evaluation_rollouts
    from bbq_torchrl.utils.seeds import derive_seed

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


def _write(given: Namespace, command: str, cells: Sequence[Cell], missing: list[str]) -> str:
    """Writes the page, its figures, bench.csv and bench.json. Returns the page.

    Diverged replicas are added to what is missing.
    """
    from bbq_torchrl.evaluation.bench_report import bench_report, rows_of, setting_name
    from bbq_torchrl.evaluation.run_result import read_result, write_json

    rows, scripts, about = [], {}, []
    for cell in cells:
        entry: dict[str, Any] = {"cell": cell.name}
        entry["command"] = shlex.join([*train_command(), *cell.overrides])
        if cell.is_played:
            played = json.loads((cell.folder / _PLAYED).read_text(encoding="utf-8"))
            name = cell.agent, cell.setting, cell.folder, given.budgets
            rows += rows_of(*name, played["plays"], played["successes"])
            result = read_result(cell.folder)
            missing += [f"{cell.name}, replica {number} (diverged)" for number in result.diverged]
            entry |= {"commit": result.commit, "clean": result.clean, "versions": result.versions}
            scripts[setting_name(cell.setting)] = result.scripted | result.references
        about.append(entry)
    settings = list(dict.fromkeys(cell.setting for cell in cells))
    content = {
        "command": command,
        "budgets": given.budgets,
        "seeds": given.seeds,
        "missing": missing,
        "scripts": scripts,
        "cells": about,
    }
    agents = list(dict.fromkeys(cell.agent for cell in cells))
    report = bench_report(rows, agents, settings, content)
    report.write(given.folder)
    write_json(content, given.folder / "bench.json")
    return str(report)
