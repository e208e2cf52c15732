"""A finished run as parts: environment, policy and configuration."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Literal, NamedTuple

from bbq_torchrl.bayes.settings import check_choice
from bbq_torchrl.options import ConfigError
from bbq_torchrl.options.registry import load_folder
from bbq_torchrl.run_folder import CHECKPOINTS
from bbq_torchrl.runs.build import make_domain
from bbq_torchrl.runs.resume import description, run_config
from bbq_torchrl.runs.shipped import is_shipped, run_folder
from bbq_torchrl.runs.train import make_agent
from bbq_torchrl.trainers import BestWeights, CheckpointFolder, NonFiniteWeightsError
from bbq_torchrl.trainers.hooks import enter_round

if TYPE_CHECKING:
    from pathlib import Path

    import torch
    from tensordict.nn import TensorDictModuleBase
    from torchrl.envs import EnvBase

    from bbq_torchrl.options import Config


class LoadedRun(NamedTuple):
    """A loaded run.

    Attributes:
        env: the run's environment, in the round in which the training ended, with as many
            replicas as the run: batch size [replicas, dialogues].
        policy: the policy that the run reports, on the environment's TensorDict.
        config: the run's configuration.
        mode: the name of the policy, such as ``mean`` or ``vote``.
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
        dialogues: how many run side by side in the environment, of each replica.
        mode: the policy of a Bayesian agent: ``mean``, ``average``, ``draw`` or ``thompson``;
            None for the run's own.
        weights: the newest, or each replica's at its best evaluation while training.
        seed: of the environment.
        device: where the environment and the weights are.
        options: the folder of options of your own that the run was trained with
            (``--config-dir``); its Python files are run, and it stays loaded.

    Raises:
        ValueError: no run folder, or none whose checkpoint can be read; a folder of options that
            cannot be loaded.

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

    The environment enters the round in which that was saved.

    Raises:
        ConfigError: a mode that the agent lacks, or no checkpoint of such weights.
        TrainingError: no checkpoint that can be read, one of another configuration, or weights
            that are not finite.
    """
    config.agent.check_mode(mode)
    check_choice("weights", weights, ("last", "best"))
    agent = make_agent(config, env)
    name, policy = config.agent.make_evaluation(agent.actor, mode)
    best = None
    if weights == "best":
        if is_shipped(folder):
            raise ConfigError(f"weights must be last for shipped:{folder.name}, got 'best'")
        not_evaluated = ConfigError(
            f"weights must be last for {folder}, which was not evaluated while it was trained "
            f"(protocol.eval_every={config.protocol.eval_every}), got 'best'"
        )
        if not config.protocol.eval_every:
            raise not_evaluated
        best = BestWeights(policy, config.replicas)
    saved: dict[str, Any] = {"loss": agent.loss} if best is None else {"best": best}
    if is_shipped(folder):
        saved = {"actor": agent.actor}
    found = CheckpointFolder(folder / CHECKPOINTS, **saved).restore(description(config))
    if found is None:
        raise ConfigError(f"{folder} has no checkpoint yet")
    enter_round(env, max(int(found[1]["round"]) - 1, 0))
    if best is not None:
        if bool((best.round < 0).any()):
            raise not_evaluated
        best.put_back()
    NonFiniteWeightsError.check(policy, folder)
    return policy, name
