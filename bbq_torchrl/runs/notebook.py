"""A training from Python, as in a notebook: overrides in, folder and result out."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import torch
from hydra.types import RunMode

from bbq_torchrl.options import ConfigError
from bbq_torchrl.options.registry import conf_folder, load_folder
from bbq_torchrl.runs.compose import compose_raw, register_options, session
from bbq_torchrl.runs.job import begin
from bbq_torchrl.runs.overrides import key_of, too_large, unreadable
from bbq_torchrl.runs.resume import Resumption
from bbq_torchrl.runs.train import run

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bbq_torchrl.evaluation.results import RunResult


_SWEEP = (
    "train runs one training, got a sweep: give each key one value, or use the command bbq train "
    "--multirun"
)


class TrainedRun(NamedTuple):
    """The outcome of :func:`train`.

    Attributes:
        folder: the run folder, for :func:`bbq_torchrl.load_run`.
        result: what ``result.json`` holds, such as ``success_rate``.
    """

    folder: Path
    result: RunResult


def train(overrides: Sequence[str] = (), *, options: Path | str | None = None) -> TrainedRun:
    """Trains an agent and evaluates it, as ``bbq train`` does.

    The process stays as it was: its signals, its logging, its Hydra session, torch's threads and
    the state of torch's generator on the CPU. Ctrl-C is a KeyboardInterrupt, after which
    ``resume=`` in the folder continues from the last checkpoint. The run folder lacks ``.hydra``
    and ``train.log``, which Hydra writes; messages go to the logger ``bbq_torchrl``.

    Args:
        overrides: as on the command line, such as ``["agent=dqn", "protocol=quick"]``;
            ``hydra.run.dir=<folder>`` names the run folder. One run, no sweep.
        options: a folder of options of your own (``--config-dir``); it stays loaded.

    Raises:
        ValueError: one sentence on what is wrong and what is allowed, before anything runs.
        OSError: a file that cannot be read or written.
        TrainingError: the training cannot continue, such as by a loss that is not finite.

    Examples:
        >>> from bbq_torchrl import load_run, train
        >>> folder, result = train(["agent=dqn", "protocol=quick"])  # doctest: +SKIP
        >>> env, policy, config, mode = load_run(folder)  # doctest: +SKIP
    """
    if isinstance(overrides, str):
        raise ConfigError(f"overrides must be a list, such as [{overrides!r}], got a text")
    for override in overrides:
        if override.startswith("-"):
            raise ConfigError(unreadable(override))
    if options is not None:
        load_folder(options, "options")
    threads = torch.get_num_threads()
    try:
        with ExitStack() as held, torch.random.fork_rng(devices=[]):
            if any(key_of(item) == "hydra.mode" and "MULTIRUN" in item for item in overrides):
                raise ConfigError(_SWEEP)
            if (refusal := too_large(overrides)) is not None:
                raise ConfigError(refusal)
            resumption = Resumption.of(overrides, held)
            with session():
                composed = compose_raw(overrides if resumption is None else resumption.arguments())
                if resumption is None and composed.hydra.mode is RunMode.MULTIRUN:
                    raise ConfigError(_SWEEP)
                start = begin(composed, overrides, held, resumption)
            folder = Path(composed.hydra.run.dir).resolve()
            result = run(start.config, folder, domain=start.domain, spiking=start.spiking)
            return TrainedRun(folder, result)
    finally:
        torch.set_num_threads(threads)


def config_dir() -> str:
    """Returns the folder of ``config.yaml`` for Hydra's Compose API, and registers the options.

    Examples:
        >>> from hydra import compose, initialize_config_dir
        >>> with initialize_config_dir(config_dir(), version_base="1.3"):
        ...     compose("config", ["agent=dqn", "protocol=quick"]).protocol.rounds
        40
    """
    register_options()
    return str(conf_folder())
