"""Runs from Python: :func:`train` and :func:`load_run`."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import torch
from hydra.types import RunMode

from bbq_torchrl.options.registry import conf_folder, load_folder
from bbq_torchrl.options.root import register_options
from bbq_torchrl.protocols import enter_round
from bbq_torchrl.runs.build import check_weights, float32_by_default, make_domain
from bbq_torchrl.runs.compose import compose_raw, session
from bbq_torchrl.runs.folders import config_fingerprint, is_shipped, run_config, run_folder
from bbq_torchrl.runs.prepare import prepare_run
from bbq_torchrl.runs.train import make_agent, run
from bbq_torchrl.settings import ConfigError, check, one_of
from bbq_torchrl.trainers import BestWeights, CheckpointFolder
from bbq_torchrl.utils.files import CHECKPOINTS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tensordict.nn import TensorDictModuleBase
    from torchrl.envs import EnvBase

    from bbq_torchrl.evaluation.run_result import RunResult
    from bbq_torchrl.options import Config


class LoadedRun(NamedTuple):
    """A loaded run.

    Attributes:
        env: the run's environment in its last training round, batch size [replicas, dialogues].
        policy: the policy that the run reports, on the environment's TensorDict.
        config: the run's configuration.
        mode: the policy's name, such as ``mean`` or ``vote``.
    """

    env: EnvBase
    policy: TensorDictModuleBase
    config: Config
    mode: str


def load_run(
    folder: Path | str,
    *,
    dialogues: int = 50,
    mode: str | None = None,
    weights: Literal["last", "best"] = "last",
    seed: int = 0,
    device: torch.device | str = "cpu",
    options: Path | str | None = None,
) -> LoadedRun:
    """Loads a run: its environment, the policy that it learned, and its configuration.

    Nothing is written into the folder.

    Args:
        folder: the run folder, or ``shipped:<name>`` for an agent that comes with the package.
        dialogues: dialogues played in parallel, for each replica.
        mode: the policy of a Bayesian agent: ``mean``, ``average``, ``draw`` or ``thompson``;
            None for ``agent.evaluate``.
        weights: ``last``, or ``best``: each replica's weights at its best evaluation during
            training.
        seed: the seed of the environment.
        device: the device of environment and weights.
        options: the folder of your own options that the run was trained with (``--config-dir``);
            its Python files are run, and it stays loaded.

    Raises:
        ValueError: not a run folder, no readable checkpoint, or a folder of options that cannot be
            loaded.

    Examples:
        >>> from bbq_torchrl import load_run
        >>> env, policy, config, mode = load_run("runs/my_run")  # doctest: +SKIP
        >>> env.rollout(20, policy, break_when_any_done=False)  # doctest: +SKIP
    """
    if options is not None:
        load_folder(options, "options")
    folder = run_folder(folder)
    config = run_config(folder)
    env = config.env.make(
        make_domain(config), (config.replicas, dialogues), seed=seed, device=device
    )
    policy, name = trained_policy(config, folder, env, mode=mode, weights=weights)
    return LoadedRun(env, policy, config, name)


def trained_policy(
    config: Config,
    folder: Path,
    env: EnvBase,
    *,
    mode: str | None = None,
    weights: str = "last",
) -> tuple[TensorDictModuleBase, str]:
    """Returns the policy of a run's newest readable checkpoint, and its name.

    The environment enters the round of the checkpoint.

    Raises:
        ConfigError: a mode that the agent lacks, or no checkpoint with such weights.
        TrainingError: no readable checkpoint, one of another configuration, or weights that are
            not finite.
    """
    config.agent.check_mode(mode)
    check("weights", weights, one_of("last", "best"))
    with float32_by_default():
        agent = make_agent(config, env)
    name, policy = config.agent.make_evaluation(agent.actor, mode)
    best = BestWeights(policy, config.replicas) if weights == "best" else None
    if best is not None and (is_shipped(folder) or not config.protocol.eval_every):
        raise ConfigError(
            f"weights must be last for {folder}, which has no evaluation during training "
            f"(protocol.eval_every={config.protocol.eval_every}), got 'best'"
        )
    saved: dict[str, Any] = {"loss": agent.loss} if best is None else {"best": best}
    fingerprint = config_fingerprint(config)
    if is_shipped(folder):
        saved, fingerprint = {"actor": agent.actor}, {}
    rounds = CheckpointFolder(folder / CHECKPOINTS, **saved).restore(fingerprint)
    if rounds is None:
        raise ConfigError(f"{folder} has no checkpoint yet")
    enter_round(env, max(rounds - 1, 0))
    if best is not None:
        best.put_back()
    check_weights(policy, folder)
    return policy, name


class TrainedRun(NamedTuple):
    """The outcome of :func:`train`.

    Attributes:
        folder: the run folder, for :func:`bbq_torchrl.load_run`.
        result: the content of ``result.json``, such as ``success_rate``.
    """

    folder: Path
    result: RunResult


def train(overrides: Sequence[str] = (), *, options: Path | str | None = None) -> TrainedRun:
    """Trains an agent and evaluates it, as ``bbq train`` does.

    Signals, logging, the Hydra session, torch's threads and the state of its CPU generator are left
    unchanged. Ctrl-C raises KeyboardInterrupt, after which ``resume=<folder>`` continues from the
    last checkpoint. The run folder lacks ``.hydra`` and ``train.log``, which Hydra writes; messages
    go to the logger ``bbq_torchrl``.

    Args:
        overrides: as on the command line, such as ``["agent=dqn", "protocol=quick"]``;
            ``hydra.run.dir=<folder>`` names the run folder. A sweep is refused.
        options: a folder of your own options (``--config-dir``); it stays loaded.

    Raises:
        ValueError: one sentence on the fault and the allowed values, before anything runs.
        OSError: a file cannot be read or written.
        TrainingError: the training cannot continue, for example after a loss that is not finite.

    Examples:
        >>> from bbq_torchrl import load_run, train
        >>> folder, result = train(["agent=dqn", "protocol=quick"])  # doctest: +SKIP
        >>> env, policy, config, mode = load_run(folder)  # doctest: +SKIP
    """
    if options is not None:
        load_folder(options, "options")
    threads = torch.get_num_threads()
    try:
        with ExitStack() as locks, torch.random.fork_rng(devices=[]):
            with session():
                composed = compose_raw(overrides)
                if composed.hydra.mode is RunMode.MULTIRUN:
                    raise ConfigError("train runs one training: a sweep is bbq train --multirun")
                config = prepare_run(composed, locks)
            folder = Path(composed.hydra.run.dir).resolve()
            return TrainedRun(folder, run(config, folder))
    finally:
        torch.set_num_threads(threads)


def config_dir() -> str:
    """Registers the options, and returns the folder of ``config.yaml`` for Hydra's Compose API.

    Examples:
        >>> from hydra import compose, initialize_config_dir
        >>> with initialize_config_dir(config_dir(), version_base="1.3"):
        ...     compose("config", ["agent=dqn", "protocol=quick"]).protocol.rounds
        40
    """
    register_options()
    return str(conf_folder())
