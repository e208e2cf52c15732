"""``bbq train`` and ``python train.py``: one page from the configuration to the trained agent.

Hydra composes the configuration, and calls :class:`~bbq_torchrl.runs.prepare.Preparation`, which
checks it before a folder exists. This page has the rest: environment, actor, exploration, loss,
replay with its spike, trainer, evaluation. Each part is made by the option that the command line
chose (:mod:`bbq_torchrl.options`). torch and TorchRL are imported in functions, so that ``--help``
is fast.
"""

from __future__ import annotations

import dataclasses
import logging
import re
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import CompactHydraException
from hydra.types import RunMode

from bbq_torchrl.options import Config
from bbq_torchrl.options.logger import RunLogger
from bbq_torchrl.options.registry import conf_folder
from bbq_torchrl.options.root import register_options
from bbq_torchrl.runs.compose import quoted, take_config_dir, train_command, usage
from bbq_torchrl.runs.folders import (
    config_fingerprint,
)
from bbq_torchrl.runs.prepare import final_config, run_job
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.utils import interruption, output
from bbq_torchrl.utils.files import CONFIG
from bbq_torchrl.utils.text import sentence

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from omegaconf import DictConfig
    from tensordict.nn import TensorDictModuleBase
    from torch import Tensor, nn
    from torchrl.envs import EnvBase, Transform
    from torchrl.modules import QValueActor

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.evaluation.run_result import RunResult
    from bbq_torchrl.protocols import ReplicaOptimizer
    from bbq_torchrl.trainers import RoundTrainer
    from bbq_torchrl.trainers.round_trainer import RoundCallback

_LOG = logging.getLogger(__name__)


def main() -> None:
    """Runs the command line: registers the options, of ``--config-dir`` too, and calls Hydra."""
    output.escape()
    logging.raiseExceptions = False  # a full disk is reported once, not for every message
    with output.refusals():
        arguments = take_config_dir(sys.argv[1:])
        if {"-h", "--help"} & {*arguments}:
            output.write(usage([word for word in arguments if not word.startswith("-")]))
            return
        register_options()
    try:
        hydra_main()
    finally:
        interruption.exit_if_interrupted()
        output.write("")  # flushes what Hydra printed


@hydra.main(version_base="1.3", config_path=str(conf_folder()), config_name="config")
def hydra_main(composed: DictConfig) -> float:
    """Trains and evaluates. Returns the final success rate, for sweepers."""
    from bbq_torchrl.runs import build

    job = HydraConfig.get()
    folder = Path(job.runtime.output_dir)
    interruption.tell(how_to_continue=lambda: _how_to_continue(folder))
    if job.mode is RunMode.MULTIRUN:
        return run_job(composed, folder, run)
    try:
        return run(final_config(composed, job.overrides.task), folder).success_rate
    except build.FORESEEN as error:
        raise CompactHydraException(sentence(error)) from error  # printed without a traceback


def run(config: Config, folder: Path, callbacks: Sequence[RoundCallback] = ()) -> RunResult:
    """Trains, evaluates and writes configuration, metrics, result, curve and checkpoints.

    The folder is locked during the run.

    Args:
        config: the configuration; with ``resume``, the run in the folder continues.
        folder: the run folder.
        callbacks: called after every round; their exceptions end the run.

    Raises:
        NonFiniteLossError: a loss is NaN or infinite.
        RunFolderGoneError: the folder was moved or removed during the run.
        CheckpointDamagedError: a run to resume has no readable checkpoint.
        CheckpointMismatchError: its checkpoint has another seed or configuration.
        ConfigError: another process is at work in the folder.
        Interrupted: a signal came; all rounds are saved.
    """
    from bbq_torchrl.runs import build, folders

    with (
        folders.run_lock(folder),
        RunLogger(config, folder) as logger,
        build.float32_by_default(),
    ):
        _LOG.info("run folder: %s", folder)
        code = build.checkout()  # at the start, since the code may change during the run
        build.set_up_process(config.threads)
        folders.save_config(dataclasses.replace(config, resume=None), folder / CONFIG)
        domain = build.make_domain(config)
        spike_policy = build.find_spike_policy(config, domain)

        trainer, agent = build_trainer(
            config, folder, callbacks, domain=domain, spike_policy=spike_policy, logger=logger
        )
        # A run killed before its last file, the curve, has a result already.
        result = config.resume and folders.finished_result(folder, config.protocol.rounds)
        if not result:
            if domain is not None:
                build.log_domain(config, domain)
            interruption.tell(lambda: _progress(trainer))
            with interruption.on_interrupt(trainer.stop):
                trainer.train(resume=config.resume is not None)
            interruption.check()

        from bbq_torchrl.runs import final  # not earlier: Matplotlib takes a second

        if not result:
            result = final.final_result(config, folder, domain, agent.actor, trainer, code)
        if config.protocol.keep_checkpoints == "weights":
            trainer.checkpoints.keep_only("loss", "best")
        final.draw_curve(config, folder, result, trainer, domain, spike_policy)  # the last file
        final.log_result(config, result, logger)
    return result


def _progress(trainer: RoundTrainer) -> str:
    return f"after {trainer.rounds_done} of {trainer.rounds} rounds, {trainer.rounds_saved} saved"


def _how_to_continue(folder: Path) -> str:
    if not (folder / CONFIG).is_file():
        return "the same command starts again"
    is_plain = re.fullmatch(r"[\w./~@%+:-]+", str(folder)) is not None
    override = f"resume={folder if is_plain else quoted(folder)}"
    return f"{shlex.join([*train_command(), override])} continues it"


def build_trainer(
    config: Config,
    run_folder: Path,
    callbacks: Sequence[RoundCallback] = (),
    *,
    domain: Domain | None = None,
    spike_policy: str | None = None,
    logger: RunLogger | None = None,
) -> tuple[RoundTrainer, Agent]:
    """Makes the trainer of a run and its agent; callbacks are called after every round.

    Domain and spike policy are loaded unless given. Without a logger metrics go to the run folder
    only.
    """
    from torchrl.objectives import HardUpdate

    from bbq_torchrl.data import ReplicaReplay
    from bbq_torchrl.options.task import check_env
    from bbq_torchrl.runs import build
    from bbq_torchrl.trainers import Learner, RoundTrainer, losses_of

    protocol, spike = config.protocol, config.spike
    domain = build.make_domain(config) if domain is None else domain
    batch = (config.replicas, protocol.dialogues)
    env = config.env.make(domain, batch, seed=config.seed, device=config.device)
    check_env(env, config.env.name, batch)
    spike_policy = spike_policy or build.find_spike_policy(config, domain)
    agent = make_agent(config, env)
    replay = ReplicaReplay(
        protocol.capacity,
        replicas=config.replicas,
        keys=build.transition_keys(env),
        transform=agent.transform,
        successes=spike.successes,
        device=config.device,
    )
    learner = Learner(
        agent.loss,
        replay,
        agent.optimizer,
        HardUpdate(losses_of(agent.loss)[0], value_network_update_interval=0),
        batch_size=protocol.batch_size,
        freezes=protocol.freezes,
        epochs=protocol.epochs,
        lr_share=None if protocol.lr_final == 1 else protocol.lr_share,
    )
    log = () if logger is None else (logger.log_round,)
    trainer = RoundTrainer(
        env,
        agent.policy,
        learner,
        run_folder,
        rounds=protocol.rounds,
        dialogues=protocol.dialogues,
        checkpoint_every=protocol.checkpoint_every,
        keep_checkpoints=None if protocol.keep_checkpoints == "all" else 2,
        max_steps=config.env.steps(),
        seed=config.seed,
        spike=spike.make(config.env.make_policy(spike_policy, env)) if spike_policy else None,
        evaluator=build.round_evaluator(config, domain, agent.actor),
        round_metrics={**agent.metrics, **build.values_as_metrics(config)},
        callbacks=(*log, *callbacks, build.divergence_warning(config)),
        remedy=config.agent.remedy,
        config_fingerprint=config_fingerprint(config),
    )
    return trainer, agent


class Agent(NamedTuple):
    """The learning and acting parts of a run.

    Attributes:
        actor: the Q-network with greedy actions.
        loss: the loss, or several in a ``ModuleDict``.
        optimizer: the optimizer of the loss's parameters.
        policy: the exploring policy.
        metrics: metrics of the exploration: a number, or shape [replicas].
        transform: the replay buffer's transform, if any.
    """

    actor: QValueActor
    loss: nn.Module
    optimizer: ReplicaOptimizer
    policy: TensorDictModuleBase
    metrics: dict[str, Callable[[], float | Tensor]]
    transform: Transform | None


def make_agent(config: Config, env: EnvBase) -> Agent:
    """Makes actor, loss and exploration; the run's seed determines the initial weights."""
    import torch
    from torchrl.envs import Compose

    from bbq_torchrl.runs import build
    from bbq_torchrl.trainers import losses_of
    from bbq_torchrl.utils.seeds import derive_seed

    torch.manual_seed(derive_seed(config.seed, "init"))
    task = build.task_of(config, env)
    actor = config.agent.make_actor(task)
    loss = config.agent.make_loss(actor, task)
    policy, metrics = config.explore.make(actor, config.agent.make_greedy(actor), task)
    if "action" not in policy.out_keys:
        raise ConfigError(
            f"explore={config.explore.name} must make a policy that writes the entry 'action', got "
            f"one that writes {', '.join(map(str, policy.out_keys)) or 'nothing'}"
        )
    loss, rewards = config.intrinsic.make(loss, task)
    config.spike.imitate(losses_of(loss)[0])
    transforms = [*config.agent.make_transforms(task), *rewards]
    loss = loss.to(env.device)
    optimizer = config.agent.make_optimizer(actor, loss.parameters(), task)
    transform = Compose(*transforms).to(env.device) if transforms else None
    return Agent(actor, loss, optimizer, policy.to(env.device), metrics, transform)
