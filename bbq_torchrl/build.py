"""From configuration to objects: the only module that knows every part."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import torch
from tensordict.nn import TensorDictModuleBase, TensorDictSequential
from torchrl.modules import EGreedyModule, QValueActor
from torchrl.objectives import HardUpdate, LossModule

from bbq_torchrl.config.schema import (
    BBQNConfig,
    BoltzmannConfig,
    Config,
    DomainConfig,
    DomainExtensionConfig,
    DQNConfig,
    EnvConfig,
    EpsilonGreedyConfig,
    FolderDomainConfig,
    MiuLabDomainConfig,
    ThompsonConfig,
    ThompsonEpsilonConfig,
    WandbLoggerConfig,
)
from bbq_torchrl.config.settings import ConfigError
from bbq_torchrl.data import ReplicaReplay
from bbq_torchrl.domains import Domain, load_domain, load_miulab, movie_domain
from bbq_torchrl.envs import DialogueEnv, ExtensionSchedule, scripted_policy
from bbq_torchrl.modules import (
    MLP,
    BayesMLP,
    Boltzmann,
    EvaluationPolicy,
    Greedy,
    ThompsonSampling,
    q_network,
    reset_inactive_,
)
from bbq_torchrl.objectives import BBQNLoss, DropoutDQNLoss
from bbq_torchrl.trainers import (
    ReplicaAdam,
    RoundSettings,
    RoundTrainer,
    SpikeSettings,
    check_logger,
    derive_seed,
    make_loggers,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from torchrl.data import TensorSpec

__all__ = [
    "Agent",
    "build_agent",
    "build_domain",
    "build_env",
    "build_trainer",
    "check",
    "evaluation_policy",
]


@dataclass
class Agent:
    """What learns and acts.

    Attributes:
        actor: the Q-network and its greedy choice.
        policy: acts with exploration.
        loss: what is learned.
        gauges: what of the exploration is worth a column of the metrics.
    """

    actor: QValueActor
    policy: TensorDictModuleBase
    loss: LossModule
    gauges: dict[str, Callable[[], float]] = field(default_factory=dict)


def build_domain(config: DomainConfig) -> Domain:
    """Loads the domain.

    Raises:
        ValueError or OSError: the corpus is damaged or not there.
    """
    if isinstance(config, MiuLabDomainConfig):
        return load_miulab(config.path, goals=config.goals, kb=config.kb, values=config.values)
    if isinstance(config, FolderDomainConfig):
        return load_domain(config.path)
    return movie_domain()


def build_env(
    config: EnvConfig,
    domain: Domain,
    batch_size: Sequence[int],
    *,
    seed: int = 0,
    device: torch.device | str = "cpu",
) -> DialogueEnv:
    """Makes the environment with a batch of dialogues, such as [replicas, dialogues]."""
    schedule = None
    if isinstance(config, DomainExtensionConfig):
        schedule = ExtensionSchedule(start=config.start, every=config.every)
    return DialogueEnv(
        domain,
        batch_size=tuple(batch_size),
        slot_error_prob=config.slot_error_prob,
        slot_error_mode=config.slot_error_mode,  # type: ignore[arg-type]
        intent_error_prob=config.intent_error_prob,
        max_turn=config.max_turn,
        success_reward=config.success_reward,
        failure_reward=config.failure_reward,
        turn_reward=config.turn_reward,
        schedule=schedule,
        seed=seed,
        device=device,
    )


def build_agent(config: Config, env: DialogueEnv) -> Agent:
    """Makes networks, exploration and loss; the weights start from the run's seed.

    What the domain extension has not activated yet starts as if it were added only later
    (:func:`~bbq_torchrl.modules.reset_inactive_`).
    """
    spec = env.action_spec_unbatched
    inputs, actions = env.layout.size, spec.n
    agent, stack = config.agent, (config.replicas,)
    torch.manual_seed(derive_seed(config.seed, "init"))
    network: BayesMLP | MLP
    if isinstance(agent, BBQNConfig):
        network = BayesMLP(
            inputs,
            actions,
            agent.hidden,
            stack=stack,
            prior_std=agent.prior_std,  # type: ignore[arg-type]
            mean_init=agent.mean_init,  # type: ignore[arg-type]
            std_init=agent.std_init,
            device=env.device,
        )
    else:
        assert isinstance(agent, DQNConfig)
        network = MLP(
            inputs, actions, agent.hidden, stack=stack, dropout=agent.dropout, device=env.device
        )
    if env.schedule is not None:
        reset_inactive_(
            network,
            inputs=~env.active_features,
            outputs=~env.simulator.action_mask(env.active_slots),
        )
    actor = q_network(network, spec)
    loss: LossModule
    if isinstance(agent, BBQNConfig):
        loss = BBQNLoss(
            actor,
            target=agent.target,  # type: ignore[arg-type]
            kl=agent.kl,  # type: ignore[arg-type]
            noise_std=agent.noise_std,
            kl_temperature=agent.kl_temperature,
            gamma=agent.gamma,
        )
    else:
        loss = DropoutDQNLoss(actor, gamma=agent.gamma, double_dqn=agent.double)
    policy, gauges = _exploration(config, actor, spec)
    return Agent(actor, policy.to(env.device), loss.to(env.device), gauges)


def _exploration(
    config: Config, actor: QValueActor, spec: TensorSpec
) -> tuple[TensorDictModuleBase, dict[str, Callable[[], float]]]:
    """Returns the policy that explores, and its gauges."""
    explore = config.explore
    base: TensorDictModuleBase = Greedy(actor)
    if isinstance(explore, (ThompsonConfig, ThompsonEpsilonConfig)):
        base = ThompsonSampling(actor, per=explore.per, shared=explore.shared)  # type: ignore[arg-type]
    if isinstance(explore, (EpsilonGreedyConfig, ThompsonEpsilonConfig)):
        epsilon = EGreedyModule(
            spec,
            eps_init=explore.eps_init,
            eps_end=explore.eps_end,
            annealing_num_steps=explore.anneal_rounds,
            action_mask_key="action_mask",
        )
        return TensorDictSequential(base, epsilon), {"epsilon": lambda: float(epsilon.eps)}
    if isinstance(explore, BoltzmannConfig):
        boltzmann = Boltzmann(
            explore.temperature_init, explore.temperature_end, explore.anneal_rounds
        )
        return (
            TensorDictSequential(base, boltzmann),
            {"temperature": lambda: float(boltzmann.temperature)},
        )
    return base, {}


def evaluation_policy(
    config: Config, actor: QValueActor, mode: str | None = None
) -> tuple[str, TensorDictModuleBase]:
    """Returns the name of the policy that is evaluated, and the policy.

    Args:
        config: of the run.
        actor: the trained actor.
        mode: ``mean``, ``average`` or ``draw`` for a Bayesian agent; ``None`` for its own.

    Raises:
        ConfigError: a mode was given and the agent has no posterior.
    """
    agent = config.agent
    if isinstance(agent, BBQNConfig):
        mode = agent.evaluate if mode is None else mode
        return mode, EvaluationPolicy(actor, mode=mode, num_draws=agent.evaluate_draws)  # type: ignore[arg-type]
    if mode is not None:
        raise ConfigError(f"mode must be null for agent={agent.name}, got {mode!r}")
    return "greedy", Greedy(actor)


def build_trainer(config: Config, run_folder: Path) -> tuple[RoundTrainer, Agent]:
    """Makes the trainer of a run, and its agent."""
    protocol, spike = config.protocol, config.spike
    env = build_env(
        config.env,
        build_domain(config.domain),
        (config.replicas, protocol.dialogues),
        seed=config.seed,
        device=config.device,
    )
    agent = build_agent(config, env)
    logger = config.logger
    trainer = RoundTrainer(
        env,
        agent.policy,
        agent.loss,
        ReplicaReplay(protocol.capacity, replicas=config.replicas, device=config.device),
        ReplicaAdam(agent.loss.parameters(), config.replicas, lr=config.agent.lr),
        HardUpdate(agent.loss, value_network_update_interval=0),
        RoundSettings(
            rounds=protocol.rounds,
            dialogues=protocol.dialogues,
            batch_size=protocol.batch_size,
            freezes=protocol.freezes,
            epochs=protocol.epochs,
            checkpoint_every=protocol.checkpoint_every,
            seed=config.seed,
            max_steps=env.max_agent_turns,
        ),
        run_folder,
        spike_policy=scripted_policy(spike.policy, env),
        spike=SpikeSettings(
            dialogues=spike.dialogues,
            protect=spike.protect,
            drop_above=spike.drop_above,
            drop_window=spike.drop_window,
        ),
        loggers=make_loggers(
            [logger.name],  # type: ignore[list-item]
            run_folder,
            resume=config.resume is not None,
            **({"wandb_project": logger.project} if isinstance(logger, WandbLoggerConfig) else {}),
        ),
        gauges=agent.gauges,
    )
    return trainer, agent


def check(config: Config) -> None:
    """Checks what the configuration alone does not tell: device, logger, corpus, scripted policy.

    Raises:
        ConfigError: the device is absent, the logger's package is not installed, or the domain has
            no such scripted policy.
        ValueError or OSError: the corpus is damaged or not there.
    """
    check_device(config.device)
    try:
        check_logger(config.logger.name)
    except ImportError as error:
        raise ConfigError(str(error)) from error
    domain = build_domain(config.domain)
    if config.spike.policy not in domain.policies:
        raise ConfigError(
            f"spike.policy must be one of {', '.join(domain.policies)}, got {config.spike.policy!r}"
        )


def check_device(device: str) -> None:
    """Raises ConfigError if a device is absent."""
    if device.startswith("cuda"):
        found = torch.cuda.device_count()
        if int(device.partition(":")[2] or 0) >= found:
            raise ConfigError(f"device={device} is absent: {found} CUDA devices found; use cpu")
