"""Parts of a run other than the agent: domain, spike policy, evaluation, process setup."""

from __future__ import annotations

import logging
import os
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import torch
from tensordict import NestedKey
from torch import Tensor, nn
from torchrl.envs import EnvBase
from torchrl.modules import QValueActor

import bbq_torchrl
from bbq_torchrl.data.replay import TRANSITION_KEYS
from bbq_torchrl.domains import Domain
from bbq_torchrl.options import Config, EvaluateConfig, Task
from bbq_torchrl.options.task import action_mask_key, lists, spread
from bbq_torchrl.runs.folders import config_fingerprint, finished_result
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.trainers import (
    CheckpointDamagedError,
    CheckpointFolder,
    RoundEvaluator,
    RoundTrainer,
    TrainingError,
    episode_stats,
    rollouts,
)
from bbq_torchrl.trainers.learn import keep_freed_memory
from bbq_torchrl.trainers.recording import MetricRow
from bbq_torchrl.utils.files import CHECKPOINTS, METRICS, RESULT
from bbq_torchrl.utils.seeds import derive_seed
from bbq_torchrl.utils.text import FaultsError, shown

_LOG = logging.getLogger(__name__)

FORESEEN = (ConfigError, FaultsError, TrainingError, OSError)
"""Errors whose message says enough without a traceback."""

TRIED = 500
"""Dialogues after which a scripted policy without a success counts as unusable."""


def make_domain(config: Config | EvaluateConfig) -> Domain | None:
    """Loads the domain of a configuration; None if its environment has no domain.

    Raises:
        ValueError or OSError: the corpus is damaged or missing.
    """
    return config.domain.make() if config.env.has_domain else None


def check_resources(config: Config) -> None:
    """Checks what a configuration refers to: device, logger, domain, script and checkpoint.

    Raises:
        ConfigError: the device is absent, the logger cannot be used here, or the domain lacks the
            scripted policy.
        TrainingError: the run to resume has no usable checkpoint.
        ValueError or OSError: the domain is damaged or missing.
    """
    check_device(config.device)
    config.logger.check_ready()
    domain = make_domain(config)
    spike, policies = config.spike, config.env.policies(domain)
    if spike.dialogues and not policies:
        raise ConfigError(
            f"spike must be none with env={config.env.name}, where there are no scripted "
            f"policies, got {spike.name!r}"
        )
    if spike.policy not in (None, *policies):
        raise ConfigError(
            f"spike.policy must be one of {', '.join(policies)} or null, got {shown(spike.policy)}"
        )
    config.env.check_domain(domain)
    folder = None if config.resume is None else Path(config.resume)
    if folder is not None and finished_result(folder, config.protocol.rounds) is None:
        found = CheckpointFolder(folder / CHECKPOINTS).newest(config_fingerprint(config), "replay")
        if not found and any((folder / name).exists() for name in (METRICS, RESULT)):
            raise CheckpointDamagedError.gone(folder)


def check_device(device: str) -> None:
    """Raises ConfigError if a device is absent."""
    if device.startswith("cuda"):
        found = torch.cuda.device_count()
        if int(device.partition(":")[2] or 0) >= found:
            raise ConfigError(f"device={device} is absent: {found} CUDA devices found; use cpu")


def task_of(config: Config, env: EnvBase) -> Task:
    """Returns the shapes that networks and exploration depend on."""
    return Task(
        inputs=env.observation_spec["observation"].shape[-1],
        action_spec=env.action_spec_unbatched,
        replicas=config.replicas,
        rounds=config.protocol.rounds,
        device=env.device,
        action_mask_key=action_mask_key(env),
        inactive=config.env.inactive(env),
    )


def check_weights(policy: nn.Module, folder: Path) -> None:
    """Raises TrainingError if a run's policy has NaN or infinite weights."""
    for name, weight in policy.named_parameters():
        if not bool(weight.isfinite().all()):
            raise TrainingError(
                f"{folder} has weights that are NaN or infinite ({name}), so the agent cannot act: "
                "train again, with a smaller agent.lr if training diverged"
            )


@contextmanager
def float32_by_default() -> Iterator[None]:
    """Makes new tensors float32, as observations are, whatever the process's default dtype."""
    before = torch.get_default_dtype()
    torch.set_default_dtype(torch.float32)
    try:
        yield
    finally:
        torch.set_default_dtype(before)


def set_up_process(threads: int) -> None:
    """Sets torch's threads, keeps freed memory, and silences TorchRL's notices."""
    torch.set_num_threads(threads)
    keep_freed_memory()
    if "RL_LOGGING_LEVEL" not in os.environ:  # TorchRL's variable, set by the user
        logging.getLogger("torchrl").setLevel(logging.WARNING)


def find_spike_policy(config: Config, domain: Domain | None) -> str | None:
    """Returns the script for the spike: ``spike.policy``, else the first that succeeds or the best.

    The policies are tried with a fixed seed, so that all runs of a setting get the same spike. A
    policy that cannot be played in the first round is skipped. Without a spike returns None.

    Raises:
        ConfigError: no policy succeeds in :data:`TRIED` dialogues.
    """
    spike = config.spike
    if not spike.dialogues or spike.policy is not None:
        return spike.policy if spike.dialogues else None
    names = config.env.policies(domain)
    env = config.env.make(domain, (1, TRIED // 5), device=config.device)
    booked = {}
    for name in names:
        try:
            policy = config.env.make_policy(name, env)
        except ValueError:  # it needs a slot that is added later
            continue
        torch.manual_seed(derive_seed(0, "torch", "spike tried"))
        env.set_seed(derive_seed(0, "env", "spike tried"))
        played = rollouts(env, policy, TRIED, max_steps=config.env.steps())
        successes = (int(episode_stats(rollout).success.sum()) for rollout in played)
        if spike.takes_best:
            booked[name] = sum(successes)
        elif any(successes):
            _LOG.info("spiking with the policy %s, the first that succeeds", name)
            return name
    if any(booked.values()):
        best = max(booked, key=booked.__getitem__)
        _LOG.info("spiking with the policy %s, the domain's best", best)
        return best
    raise ConfigError(
        f"spike.policy must be a scripted policy that succeeds, and none of {', '.join(names)} "
        f"does in {TRIED} dialogues: fix the policies of the domain, make it easier (fewer "
        "errors, more turns), or learn without them by spike=none"
    )


def log_domain(config: Config, domain: Domain) -> None:
    """Logs skipped parts of the corpus, and slots that are never active."""
    for text in domain.skipped:
        _LOG.warning("left out of the domain %s: %s", domain.name, text)
    active = {*(domain.essential + domain.extension_order if config.env.extends else domain.slots)}
    inactive = {*domain.slots} - active
    named = [{*goal.constraints, *goal.requests} for goal in domain.goals]
    if cut := sum(bool(inactive & slots) for slots in named):
        _LOG.info(
            "domain extension never activates %s: %d of %d goals are without them",
            ", ".join(sorted(inactive.intersection(set().union(*named)))),
            cut,
            len(domain.goals),
        )


def transition_keys(env: EnvBase) -> list[NestedKey]:
    """Returns the keys of the environment's transitions."""
    masks = () if action_mask_key(env) else ("action_mask", ("next", "action_mask"))
    return [key for key in TRANSITION_KEYS if key not in masks]


def round_evaluator(
    config: Config, domain: Domain | None, actor: QValueActor
) -> RoundEvaluator | None:
    """Returns the evaluator used during training; None with ``protocol.eval_every=0``."""
    protocol = config.protocol
    if not protocol.eval_every:
        return None
    parallel = protocol.parallel_dialogues(protocol.eval_every_dialogues, config.replicas)
    return RoundEvaluator(
        config.env.make(domain, (config.replicas, parallel), device=config.device),
        lambda: config.agent.make_evaluation(actor)[1],
        every=protocol.eval_every,
        dialogues=protocol.eval_every_dialogues,
        seed=config.seed,
        max_steps=config.env.steps(),
        changes=config.env.additions(domain),
    )


def values_as_metrics(config: Config) -> dict[str, Callable[[], Tensor]]:
    """Returns a metric for each key with a list: the values of the replicas."""
    return {
        key: torch.tensor(spread(values, config.replicas), dtype=torch.float64).clone
        for key, values in lists(config)
    }


def divergence(config: Config, rows: Sequence[MetricRow]) -> dict[int, str]:
    """Returns a sentence by replica, for those whose mean Q left the range of returns.

    Without a known range, as with an intrinsic reward, nothing is found.
    """
    found: dict[int, str] = {}
    gammas = spread(config.agent.gamma, config.replicas)
    ranges = [config.env.returns(gamma) for gamma in gammas]
    for row in rows if config.intrinsic.name == "none" else ():
        replica, value = int(row["replica"]), row.get("q_value", 0.0)
        low, high = ranges[replica] or (value, value)
        if replica not in found and (value < low or value > high):
            found[replica] = (
                f"learning diverges: the mean Q of replica {replica} is {value:.4g} in round "
                f"{row['round']}, and returns are from {low:.4g} to {high:.4g}; "
                f"{config.agent.remedy}"
            )
    return found


def divergence_warning(config: Config) -> Callable[[RoundTrainer, Sequence[MetricRow]], None]:
    """Returns a callback of the trainer that logs the first of each :func:`divergence`."""
    logged: set[int] = set()

    def warn(trainer: RoundTrainer, rows: Sequence[MetricRow]) -> None:
        for replica, text in divergence(config, rows).items():
            if replica not in logged:
                logged.add(replica)
                _LOG.warning("%s", text)

    return warn


_SECONDS = 30.0  # git on a network drive is slow, but must not block a run


class Checkout(NamedTuple):
    """The state of the code.

    Attributes:
        commit: the hash of the commit checked out; None outside a checkout.
        clean: whether no tracked file is changed; None outside a checkout.
    """

    commit: str | None = None
    clean: bool | None = None


def checkout(folder: Path | None = None) -> Checkout:
    """Returns the commit of a package's code, and whether the working tree is clean.

    Args:
        folder: the package's folder; this package's by default. If git does not track its
            ``__init__.py``, the package is installed and perhaps lies in another checkout.
    """
    folder = Path(bbq_torchrl.__file__).parent if folder is None else folder
    if _git(folder, "ls-files", "--error-unmatch", "__init__.py") is None:
        return Checkout()
    found = _git(folder, "describe", "--always", "--exclude=*", "--abbrev=40", "--dirty=?")
    return Checkout(found.removesuffix("?"), not found.endswith("?")) if found else Checkout()


def _git(folder: Path, *command: str) -> str | None:
    """Returns git's output; None if git is missing or fails."""
    # GIT_DIR and the like, set if a git hook starts the run, name another repository.
    environment = {key: value for key, value in os.environ.items() if not key.startswith("GIT_")}
    try:
        # Without locks, so that jobs that start together do not block one another.
        done = subprocess.run(
            ["git", "--no-optional-locks", "-C", str(folder), *command],
            capture_output=True,
            check=True,
            encoding="utf-8",
            errors="replace",
            env=environment,
            stdin=subprocess.DEVNULL,
            timeout=_SECONDS,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()
