"""``python -m bbq_torchrl.domains calibrate``: how many errors make a domain how difficult.

A domain is as difficult as one of its scripted policies finds it: the reference setting is the slot
error probability at which the policy has a wanted success rate. It is found by a root finder on
the success of the same users with the same dice, which falls with the probability almost without
noise, and then measured with other users.
"""

from __future__ import annotations

import dataclasses
import functools
import sys
from typing import TYPE_CHECKING, NamedTuple

from bbq_torchrl.domains import importing
from bbq_torchrl.options import CalibrateConfig, ConfigError
from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.overrides import take_config_dir
from bbq_torchrl.utils import interruption, output
from bbq_torchrl.utils.output import page
from bbq_torchrl.utils.text import shown

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

USAGE = f"""\
usage: python -m bbq_torchrl.domains calibrate [<key>=<value> ...]
       python -m bbq_torchrl.domains import --help    a domain folder from a corpus of MiuLab's form

Finds the slot error probability at which a scripted policy succeeds in a wanted share of dialogues,
and prints the line to write into domain.yaml, with standard errors.

  domain=, domain.path=   the domain, as in bbq train
  policy=     a scripted policy of the domain; rule by default
  success=    the wanted success rate; 0.183 by default, that of the paper's rule agent
  dialogues=  how many are played for each probability that is tried
  env=, env.<key>=  turn limit, error mode and the like, as in bbq train; with env=domain_ext the
              essential slots alone, as in round 0
  batch=, seed=, device=, threads=

Meaning and allowed values of a key: {page("reference/keys")}
"""

_PRECISION = 5e-5
_STEP = 0.02  # of the probability, over which the slope is taken


class Calibration(NamedTuple):
    """A calibrated error probability.

    Attributes:
        slot_error_prob: four decimals.
        error: its standard error: that of the success rates that it was found by, over the slope.
        success_rate: at that probability, of users that were not there when it was looked for.
        success_error: standard error of that rate.
    """

    slot_error_prob: float
    error: float
    success_rate: float
    success_error: float


@output.refusing
def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line. Returns the exit code."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    if arguments[:1] == ["import"]:
        return importing.main(arguments[1:])
    interruption.tell(lambda: "in a calibration", lambda: "the same command starts again")
    if not arguments or {"-h", "--help"} & set(arguments):
        output.write(USAGE)
        return 0
    if arguments[0] != "calibrate":
        raise ConfigError(f"the command must be calibrate or import, got {shown(arguments[0])}")
    arguments = take_config_dir(arguments)
    config = compose(arguments[1:], CalibrateConfig)
    found = calibrate(config, output.print_error)
    output.write(
        f"reference_slot_error_prob: {found.slot_error_prob:g}"
        f"  # ± {found.error:.4f}; {config.policy} succeeds in {found.success_rate:.4f} ± "
        f"{found.success_error:.4f} of {config.dialogues} dialogues\n"
    )
    return 0


def calibrate(config: CalibrateConfig, tell: Callable[[str], object]) -> Calibration:
    """Finds the probability.

    Args:
        config: domain, policy and success rate wanted.
        tell: takes a line for every probability that was tried.

    Raises:
        ConfigError: no probability gives that success rate, or the domain has no such policy.
        ValueError or OSError: the corpus is damaged or not there.
    """
    import torch
    from scipy.optimize import brentq

    from bbq_torchrl.envs import scripted_policy
    from bbq_torchrl.evaluation.rollouts import evaluate
    from bbq_torchrl.options.env import FullDomain
    from bbq_torchrl.runs.checks import check_device
    from bbq_torchrl.trainers import derive_seed, keep_freed_memory
    from bbq_torchrl.utils.statistics import binomial_standard_error

    option = config.env
    if not isinstance(option, FullDomain):
        raise ConfigError(
            f"env must be one of full, domain_ext, whose error level can be set, got "
            f"{option.name!r}"
        )
    if option.level != "act" or option.errors != "drawn":
        raise ConfigError(
            f"env.level must be act and env.errors drawn, whose probability is looked for, got "
            f"{option.level!r} and {option.errors!r}"
        )
    if option.slot_error_prob is not None:
        raise ConfigError(
            "env.slot_error_prob must be null: it is what is looked for, got "
            f"{option.slot_error_prob}"
        )
    check_device(config.device)
    torch.set_num_threads(config.threads)
    keep_freed_memory()
    domain = config.domain.make()
    if config.policy not in domain.policies:
        names = ", ".join(domain.policies) or "the domain's scripted policies, of which it has none"
        raise ConfigError(f"policy must be one of {names}, got {shown(config.policy)}")

    @functools.cache
    def success(probability: float, seed: int) -> float:
        env = dataclasses.replace(option, slot_error_prob=probability).make(
            domain,
            (1, min(config.batch, config.dialogues)),
            device=config.device,
        )
        policy = scripted_policy(config.policy, env)
        played = evaluate(env, policy, config.dialogues, seed=seed)
        rate = played.success.double().mean().item()
        tell(f"slot_error_prob={probability:.5f}: {config.policy} succeeds in {rate:.4f}")
        return rate

    def error(rate: float) -> float:
        return binomial_standard_error(rate, config.dialogues)

    for end, beyond in ((0.0, "more"), (1.0, "less")):
        rate = success(end, config.seed)
        if (rate < config.success) if end == 0 else (rate > config.success):
            raise ConfigError(
                f"success={config.success} cannot be reached: with slot_error_prob={end:g}, "
                f"{config.policy} succeeds in no {beyond} than {rate:.4f} ± {error(rate):.4f}"
            )
    root = brentq(lambda p: success(p, config.seed) - config.success, 0, 1, xtol=_PRECISION)
    probability = round(float(root), 4)
    aside = probability + (_STEP if probability + _STEP <= 1 else -_STEP)
    other = derive_seed(config.seed, "calibrated")
    rate = success(probability, other)
    slope = abs(success(aside, other) - rate) / _STEP
    uncertain = error(config.success) / slope if slope else float("inf")
    return Calibration(probability, uncertain, rate, error(rate))
