"""What a run is made of, from its configuration: domain, agent and trainer."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import torch
from torch import nn
from torchrl.envs import Compose
from torchrl.objectives import HardUpdate

from bbq_torchrl.data import ReplicaReplay
from bbq_torchrl.data.replay import TRANSITION_KEYS
from bbq_torchrl.evaluation.while_training import RoundEvaluator
from bbq_torchrl.options import ConfigError, Task
from bbq_torchrl.options.settings import walk
from bbq_torchrl.options.task import action_mask_key, check_env
from bbq_torchrl.options.values import replica_values
from bbq_torchrl.runs.resume import description
from bbq_torchrl.trainers import RoundTrainer, derive_seed, episode_stats, rollouts

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from pathlib import Path

    from tensordict import NestedKey
    from tensordict.nn import TensorDictModuleBase
    from torch import Tensor
    from torchrl.envs import EnvBase, Transform
    from torchrl.modules import QValueActor
    from torchrl.objectives import LossModule
    from torchrl.record.loggers import Logger

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.options import Config, EvaluateConfig, Option
    from bbq_torchrl.trainers import ReplicaOptimizer
    from bbq_torchrl.trainers.hooks import RoundCallback

TRIED = 500
"""The most dialogues that a scripted policy plays before it counts as one that never succeeds."""


class Agent(NamedTuple):
    """What learns and acts.

    Attributes:
        actor: the Q-network and its choice of an action.
        loss: what is learned.
        optimizer: moves the loss's parameters.
        policy: acts with exploration.
        metrics: what of the exploration is worth a column of the metrics; one number, or
            [replicas].
        transform: what the replay buffer does to transitions, if anything.
    """

    actor: QValueActor
    loss: LossModule
    optimizer: ReplicaOptimizer
    policy: TensorDictModuleBase
    metrics: dict[str, Callable[[], float | Tensor]]
    transform: Transform | None


def make_domain(config: Config | EvaluateConfig) -> Domain | None:
    """Loads the domain of a configuration; None where its environment has none.

    Raises:
        ValueError or OSError: the corpus is damaged or not there.
    """
    return config.domain.make() if config.env.has_domain else None


def spike_policy(config: Config, domain: Domain | None) -> str:
    """Returns the scripted policy that spikes: the one given, else the first that succeeds.

    Each plays with the same seed until a dialogue succeeds, whatever the run's seed, so that all
    runs of a setting are spiked alike. A script that cannot be played in the first round is left
    out.

    Raises:
        ConfigError: none succeeds in :data:`TRIED` dialogues.
    """
    if config.spike.policy is not None:
        return config.spike.policy
    names = config.env.policies(domain)
    env = config.env.make(domain, (1, TRIED // 5), device=config.device)
    for name in names:
        try:
            policy = config.env.make_policy(name, env)
        except ValueError:  # a script that needs a slot which comes later
            continue
        torch.manual_seed(derive_seed(0, "torch", "spike tried"))
        env.set_seed(derive_seed(0, "env", "spike tried"))
        played = rollouts(env, policy, TRIED, max_steps=config.env.steps())
        if any(bool(episode_stats(rollout).success.any()) for rollout in played):
            return name
    raise ConfigError(
        f"spike.policy must be a scripted policy that succeeds, and none of {', '.join(names)} "
        f"does in {TRIED} dialogues: mend the policies of the domain, make it easier (fewer "
        "errors, more turns), or learn without them by spike=none"
    )


def make_agent(config: Config, env: EnvBase) -> Agent:
    """Makes networks, loss and exploration; the weights start from the run's seed."""
    torch.manual_seed(derive_seed(config.seed, "init"))
    inputs, actions = config.env.inactive(env) or (None, None)
    task = Task(
        inputs=env.observation_spec["observation"].shape[-1],
        action_spec=env.action_spec_unbatched,
        replicas=config.replicas,
        rounds=config.protocol.rounds,
        device=env.device,
        action_mask_key=action_mask_key(env),
        inactive_inputs=inputs,
        inactive_actions=actions,
    )
    actor = config.agent.make_actor(task)
    loss = config.agent.make_loss(actor, task)
    policy, metrics = _checked(
        config.explore,
        config.explore.make(actor, config.agent.make_greedy(actor), task),
        "a policy and a dict of metrics",
        *(nn.Module, Mapping),
    )
    loss, transforms = _checked(
        config.intrinsic,
        config.intrinsic.make(loss, task),
        "a loss and a list of transforms",
        *(nn.Module, (Iterable, Compose)),
    )
    transforms = [*config.agent.make_transforms(task), *transforms]
    loss = loss.to(env.device)
    return Agent(
        actor,
        loss,
        config.agent.make_optimizer(actor, loss.parameters(), task),
        policy.to(env.device),
        metrics,
        Compose(*transforms).to(env.device) if transforms else None,
    )


def build_trainer(
    config: Config,
    run_folder: Path,
    callbacks: Sequence[RoundCallback] = (),
    *,
    domain: Domain | None = None,
    spiking: str | None = None,
    loggers: Sequence[Logger] = (),
) -> tuple[RoundTrainer, Agent]:
    """Makes the trainer of a run, and its agent; callbacks are called after every round.

    The domain is loaded, and the policy that spikes is found, unless they are given. Loggers are
    those of :func:`opened_loggers`; without them the metrics are logged nowhere but in the run
    folder.
    """
    protocol, spike = config.protocol, config.spike
    domain = make_domain(config) if domain is None else domain
    batch = (config.replicas, protocol.dialogues)
    env = config.env.make(domain, batch, seed=config.seed, device=config.device)
    check_env(env, config.env.name, batch)
    if spike.dialogues and spiking is None:
        spiking = spike_policy(config, domain)
    agent = make_agent(config, env)
    trainer = RoundTrainer(
        env,
        agent.policy,
        agent.loss,
        ReplicaReplay(
            protocol.capacity,
            replicas=config.replicas,
            keys=_transition_keys(env),
            transform=agent.transform,
            device=config.device,
        ),
        agent.optimizer,
        HardUpdate(agent.loss, value_network_update_interval=0),
        run_folder,
        rounds=protocol.rounds,
        dialogues=protocol.dialogues,
        batch_size=protocol.batch_size,
        freezes=protocol.freezes,
        epochs=protocol.epochs,
        updates_per_round=protocol.updates_per_round,
        checkpoint_every=protocol.checkpoint_every,
        keep_checkpoints=None if protocol.keep_checkpoints == "all" else 2,
        lr_share=None if protocol.lr_final == 1 else protocol.lr_share,
        max_steps=config.env.steps(),
        seed=config.seed,
        spike=spike.make(config.env.make_policy(spiking, env)) if spiking else None,
        loggers=loggers,
        callbacks=callbacks,
        evaluator=_evaluator(config, domain, agent),
        round_metrics={**agent.metrics, **_own_values(config)},
        described=description(config),
    )
    return trainer, agent


@contextmanager
def opened_loggers(config: Config, run_folder: Path) -> Iterator[Sequence[Logger]]:
    """Loggers of a run, which have its configuration. They are closed however the run ends.

    Raises:
        ConfigError: the option has made no list of loggers, or they cannot be used.
    """
    option = config.logger
    made = option.make(run_folder, resume=config.resume is not None)
    (given,) = _checked(option, (made,), "a list of loggers", Iterable)
    loggers, finished = tuple(given), False
    try:
        flat = {key: value for key, _, value in walk(config) if key != "resume"}
        option.log_config(loggers, flat)
        yield loggers
        finished = True
    finally:
        option.close(loggers, finished=finished)


def _checked(option: Option, made: Any, what: str, *kinds: type | tuple[type, ...]) -> Any:
    """Returns the parts that an option's ``make`` has made.

    Raises:
        ConfigError: they are not of these kinds.
    """
    parts = made if isinstance(made, (tuple, list)) else (made,)
    if len(parts) != len(kinds) or not all(map(isinstance, parts, kinds)):
        got = ", ".join(type(part).__name__ for part in parts)
        raise ConfigError(f"make of {option.group}={option.name} must return {what}, got {got}")
    return parts


def _transition_keys(env: EnvBase) -> list[NestedKey]:
    """Returns the entries of a transition that the environment has."""
    masks = () if action_mask_key(env) else ("action_mask", ("next", "action_mask"))
    return [key for key in TRANSITION_KEYS if key not in masks]


def _evaluator(config: Config, domain: Domain | None, agent: Agent) -> RoundEvaluator | None:
    """Returns what evaluates the agent while it is trained, if anything does."""
    protocol = config.protocol
    if not protocol.eval_every:
        return None
    places = protocol.places(protocol.eval_every_dialogues, config.replicas)
    return RoundEvaluator(
        config.env.make(
            domain,
            (config.replicas, places),
            device=config.device,
        ),
        lambda: config.agent.make_evaluation(agent.actor)[1],
        every=protocol.eval_every,
        dialogues=protocol.eval_every_dialogues,
        seed=config.seed,
        max_steps=config.env.steps(),
        changes=config.env.additions(domain),
    )


def _own_values(config: Config) -> dict[str, Callable[[], Tensor]]:
    """Returns the keys that have a list as metrics, which say whose value is which."""
    per_replica = replica_values(config)
    columns = {
        key: torch.tensor([values[key] for values in per_replica], dtype=torch.float64)
        for key in per_replica[0]
    }
    return {key: column.clone for key, column in columns.items()}
