"""``bbq domains calibrate``: finds the slot error probability of a given difficulty.

Difficulty is measured by a scripted policy: at the reference probability it has a given success
rate. A root finder searches with the same users and random numbers, so that success falls with the
probability almost without noise. The result is then measured with other users.
"""

from __future__ import annotations

import dataclasses
import functools
import sys
from collections.abc import Callable, Sequence

from bbq_torchrl.domains import miulab
from bbq_torchrl.options import CalibrateConfig
from bbq_torchrl.runs.compose import compose, take_config_dir
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.utils import interruption, output
from bbq_torchrl.utils.output import page
from bbq_torchrl.utils.text import as_typed, shown

USAGE = f"""\
usage: bbq domains calibrate [<key>=<value> ...]
       bbq domains import --help    a domain folder from a corpus in MiuLab's form

Finds the slot error probability at which a scripted policy has a given success rate, and prints the
line for domain.yaml, with standard errors.

  domain=, domain.path=   the domain, as in bbq train
  policy=     a scripted policy of the domain; rule by default
  success=    the success rate to reach; 0.183 by default, that of the paper's rule agent
  dialogues=  dialogues for each probability that is tried
  env=, env.<key>=  turn limit, error mode and so on, as in bbq train; with env=domain_ext only the
              essential slots are active, as in round 0
  batch=, seed=, device=, threads=

Meaning and allowed values of a key: {page("configuration")}
"""

_PRECISION = 5e-5
_STEP = 0.02  # difference of probabilities for the slope


@output.refusing
def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line. Returns the exit code."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    if arguments[:1] == ["import"]:
        return miulab.main(arguments[1:])
    interruption.tell(lambda: "in a calibration", lambda: "the same command starts again")
    if not arguments or {"-h", "--help"} & set(arguments):
        output.write(USAGE)
        return 0
    if arguments[0] != "calibrate":
        raise ConfigError(f"the command must be calibrate or import, got {shown(arguments[0])}")
    arguments = take_config_dir(arguments)
    config = compose(arguments[1:], CalibrateConfig)
    probability, error, rate, rate_error = calibrate(config, output.print_error)
    output.write(
        f"reference_slot_error_prob: {probability:g}"
        f"  # ± {error:.4f}; {config.policy} succeeds in {rate:.4f} ± "
        f"{rate_error:.4f} of {config.dialogues} dialogues\n"
    )
    return 0


def calibrate(
    config: CalibrateConfig, tell: Callable[[str], object]
) -> tuple[float, float, float, float]:
    """Finds the slot error probability.

    Args:
        config: domain, policy and the success rate to reach.
        tell: called with a line for every probability that is tried.

    Returns:
        The probability, to four decimals; its standard error, that of the success rates divided by
        the slope; the success at that probability, with users not used in the search; and the
        standard error of that rate.

    Raises:
        ConfigError: no probability gives that success rate, or the domain lacks the policy.
        ValueError or OSError: the corpus is damaged or missing.
    """
    from scipy.optimize import brentq

    from bbq_torchrl.envs import scripted_policy
    from bbq_torchrl.options.env import FullDomain
    from bbq_torchrl.runs.build import check_device, set_up_process
    from bbq_torchrl.trainers import evaluate
    from bbq_torchrl.utils.seeds import derive_seed
    from bbq_torchrl.utils.statistics import binomial_standard_error

    option = config.env
    if not isinstance(option, FullDomain):
        raise ConfigError(
            f"env must be one of full, domain_ext, whose error level can be set, got "
            f"{option.name!r}"
        )
    for key, needed in {"level": "act", "errors": "drawn", "slot_error_prob": None}.items():
        if (given := getattr(option, key)) != needed:
            wanted = as_typed(needed)
            raise ConfigError(f"env.{key} must be {wanted} in a calibration, got {given!r}")
    check_device(config.device)
    set_up_process(config.threads)
    domain = config.domain.make()
    if config.policy not in domain.policies:
        names = ", ".join(domain.policies) or "the domain's scripted policies, but it has no policy"
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
    return probability, uncertain, rate, error(rate)
