"""Makes a shipped agent from a finished run.

    python scripts/ship_agent.py <run folder> bbqn_map

writes ``bbq_torchrl/runs/shipped/bbqn_map``: the Q-network's weights of one replica, in half
precision, with the run's configuration, command line and result.
``load_run("shipped:bbqn_map")`` loads it.
"""

from __future__ import annotations

import argparse
import shutil
from dataclasses import replace
from pathlib import Path

from bbq_torchrl.evaluation.run_result import read_result, write_json
from bbq_torchrl.options.task import replica_values
from bbq_torchrl.runs import folders
from bbq_torchrl.runs.build import make_domain
from bbq_torchrl.runs.folders import config_fingerprint, run_config, save_config
from bbq_torchrl.runs.train import make_agent
from bbq_torchrl.trainers import CheckpointFolder
from bbq_torchrl.utils.files import CHECKPOINTS, CONFIG, OVERRIDES, RESULT


def ship(run: Path, target: Path, replica: int = 0) -> None:
    """Writes a shipped agent.

    Args:
        run: a finished run folder.
        target: the folder to make; one that exists is replaced.
        replica: which of the run's.

    Raises:
        ValueError: the run is not finished, has no such replica or no checkpoint, or its replicas
            have values of their own.
    """
    config, result = run_config(run), read_result(run)
    if not 0 <= replica < config.replicas:
        raise ValueError(f"replica must be from 0 to {config.replicas - 1}, got {replica}")
    if any(replica_values(config)):
        raise ValueError(f"{run} has a list of values: a shipped agent is of a run without")
    domain = make_domain(config)
    whole = make_agent(config, config.env.make(domain, (config.replicas, 1)))
    own = replace(config, replicas=1, resume=None)
    single = make_agent(own, own.env.make(domain, (1, 1)))
    saved = CheckpointFolder(run / CHECKPOINTS, loss=whole.loss)
    if saved.restore(config_fingerprint(config)) is None:
        raise ValueError(f"{run} has no checkpoint")
    shapes = {name: value.shape for name, value in single.actor.state_dict().items()}
    state = {
        name: value if value.shape == shapes[name] else value[replica : replica + 1]
        for name, value in whole.actor.state_dict().items()
    }
    single.actor.half().load_state_dict(state)
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir(parents=True)
    save_config(own, target / CONFIG)
    shutil.copyfile(run / OVERRIDES, target / "overrides.yaml")
    write_json(result.only([replica]), target / RESULT)
    checkpoints = CheckpointFolder(target / CHECKPOINTS, actor=single.actor)
    checkpoints.save(result.rounds, {})


def main() -> None:
    """Ships the run given on the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path, help="a finished run folder")
    parser.add_argument("name", help="of the shipped agent")
    parser.add_argument("--replica", type=int, default=0, help="which of the run's")
    arguments = parser.parse_args()
    ship(arguments.run, folders.SHIPPED / arguments.name, arguments.replica)


if __name__ == "__main__":
    main()
