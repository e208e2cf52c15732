"""Hyper-parameter search by Optuna: every trial is an ordinary run of ``train.py``.

:func:`main` is ``bbq search``, :func:`bbq_torchrl.search.trials.run_search` does the work. The help
works without Optuna.
"""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Sequence

from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from bbq_torchrl.options.registry import options
from bbq_torchrl.runs.compose import take_config_dir
from bbq_torchrl.search.definition import SEARCH, compose_search
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.utils import interruption, output
from bbq_torchrl.utils.output import needed, page
from bbq_torchrl.utils.text import sentence

USAGE = """\
usage: bbq search search=<name> [search.<key>=<value> ...] [<key>=<value> ...]

Searches hyper-parameters by Optuna. Every trial is a run of bbq train with the given keys; the same
command continues a search. Prints the best trial as one line of JSON.

  search=      {names}, or a YAML file
  search.trials=, search.objective=, search.folder=, ...
  search.space.<key>={{type: float, low: 0.1, high: 1, log: true}}, search.space.<key>.high=2

Searches: {scale}
All keys, of a search and of bbq train: {keys}
"""


@output.refusing
def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line.

    Returns:
        The exit code: 1 if no trial was completed or a file could not be written, 2 if refused.
    """
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    interruption.tell(lambda: "in a search", lambda: "the same command continues the search")
    if not arguments or {"-h", "--help"} & set(arguments):
        pages = {"scale": page("scale"), "keys": page("configuration")}
        output.write(USAGE.format(names=", ".join(options(SEARCH)), **pages))
        return 0
    # Imported after the help, since torch, torchrl and Optuna take seconds.
    optuna = needed("optuna", "optuna", "search")
    try:
        search = compose_search(take_config_dir(arguments))
        from bbq_torchrl.runs.build import check_resources
        from bbq_torchrl.runs.train import run
        from bbq_torchrl.search.trials import run_search

        for config in search.corners:
            check_resources(config)
        logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s")
        optuna.logging.set_verbosity(optuna.logging.ERROR)
        best = run_search(search, run, check_resources)
    except (OmegaConfBaseException, YAMLError, optuna.exceptions.StorageInternalError) as error:
        raise ConfigError(sentence(error)) from error
    if best is None:
        output.print_error(f"error: no trial was completed; {search.folder} has the reasons")
        return 1
    output.write(json.dumps(best) + "\n")
    return 0
