"""``bbq evaluate``: plays dialogues, prints one line of JSON, and writes transcripts."""

from __future__ import annotations

import json
import sys
import time
from contextlib import suppress
from os.path import expanduser
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bbq_torchrl.options import EvaluateConfig
from bbq_torchrl.options.task import replica_values
from bbq_torchrl.runs.compose import compose, take_config_dir, value_of
from bbq_torchrl.runs.folders import run_config, run_folder
from bbq_torchrl.settings import ConfigError
from bbq_torchrl.utils import interruption, output
from bbq_torchrl.utils.files import RESULT, write_text
from bbq_torchrl.utils.output import page
from bbq_torchrl.utils.text import as_typed, shown

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tensordict import TensorDictBase
    from tensordict.nn import TensorDictModuleBase

    from bbq_torchrl.envs import DialogueEnv
    from bbq_torchrl.simulator import Transcript
    from bbq_torchrl.trainers import Policy

USAGE = f"""\
usage: bbq evaluate policy=<policy> [<key>=<value> ...]

Plays dialogues and prints one line of JSON: success_rate, standard_error, reward, turns,
dialogues, turns_per_second.

  policy=      random, a scripted policy of the domain (rule, careful, ...), clairvoyant
               (privileged: it reads the user's hidden goal), a run folder, or shipped:<name>, an
               agent that comes with the package. In env=domain_ext a trained agent plays in the
               round in which it was saved, the other policies in round 0.
  dialogues=   number of dialogues, for each replica of a run folder
  batch=       number of dialogues played in parallel
  env=, domain=  as in bbq train; a run folder keeps its options, and env.<key>= or domain.<key>=
               changes a key
  env.level=   text: users speak in sentences, which the agent has to understand; see
               {page("your_domain")}
  mode=        mean, average, draw or thompson, for a Bayesian agent
  weights=     last, or best: each replica's weights at its best evaluation during training
  log=<file>   writes the first log_dialogues= dialogues as readable acts
  seed=, device=, threads=
  --config-dir <folder>   folder of your own options, as in bbq train; its Python files are run

Meaning and allowed values of a key: {page("configuration")}
"""


@output.refusing
def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line. Returns the exit code."""
    arguments = sys.argv[1:] if arguments is None else list(arguments)
    interruption.tell(lambda: "in an evaluation", lambda: "the same command starts again")
    if not arguments or {"-h", "--help"} & set(arguments):
        output.write(USAGE)
        return 0
    arguments = take_config_dir(arguments)
    config = composed(arguments)
    from bbq_torchrl.evaluation.run_result import read_result

    line = evaluation(config)
    with suppress(ValueError):  # a policy without a result, or a damaged one
        said = read_result(run_folder(config.policy))
        output.print_error(
            f"{RESULT} has {said.success_rate:.4f} ± {said.standard_error:.4f}, from the "
            f"{said.dialogues} dialogues of seed {said.seed} at the end of training"
        )
    output.write(json.dumps(line) + "\n")
    return 0


def composed(overrides: Sequence[str]) -> EvaluateConfig:
    """Returns the configuration of a command line, based on the environment of the run it names.

    Raises:
        ConfigError: a wrong key or value, or a folder that is not a run folder.
    """
    policy = value_of(overrides, "policy")
    folder = run_folder(policy) if policy else None
    run = run_config(folder) if folder is not None and folder.is_dir() else None
    return compose(overrides, EvaluateConfig, run)


def evaluation(config: EvaluateConfig) -> dict[str, Any]:
    """Plays the dialogues of a configuration. Returns the values to print.

    Raises:
        ValueError or OSError: a missing policy, corpus or device.
    """
    from bbq_torchrl.domains.domain import RANDOM_POLICY
    from bbq_torchrl.runs.build import check_device, make_domain, set_up_process
    from bbq_torchrl.runs.loading import trained_policy
    from bbq_torchrl.trainers import evaluate
    from bbq_torchrl.utils.statistics import binomial_standard_error

    check_device(config.device)
    set_up_process(config.threads)
    folder = run_folder(config.policy)
    run = run_config(folder) if folder.is_dir() else None
    domain = make_domain(config)
    if run is None:
        names = (*config.env.policies(domain), RANDOM_POLICY, *config.env.references(domain))
        if config.policy not in names:
            raise ConfigError(
                f"policy must be a run folder or one of {', '.join(names)}, "
                f"got {shown(config.policy)}"
            )
        for key, needed in {"mode": None, "weights": "last"}.items():
            if (given := getattr(config, key)) != needed:
                wanted = f"{as_typed(needed)} for policy={config.policy}"
                raise ConfigError(f"{key} must be {wanted}, got {given!r}")
    is_privileged = run is None and config.policy in config.env.references(domain)
    replicas = 1 if run is None else run.replicas
    values = [] if run is None else replica_values(run)
    parallel = min(config.batch, config.dialogues)
    env = config.env.make(domain, (replicas, parallel), device=config.device)
    mode: str | None = None
    policy: TensorDictModuleBase
    if run is None:
        policy = config.env.make_policy(config.policy, env)
    else:
        policy, mode = trained_policy(run, folder, env, mode=config.mode, weights=config.weights)
    if config.log is not None:
        if domain is None:
            raise ConfigError(f"log must be null with env={config.env.name}, got {config.log!r}")
        _write_log(config, env, policy)
    started = time.perf_counter()
    played = evaluate(env, policy, config.dialogues, seed=config.seed, max_steps=config.env.steps())
    seconds = time.perf_counter() - started
    rate = played.success.double().mean().item()
    turns = int(played.turns.sum())
    per_replica = played.success.double().mean(-1).tolist()
    line = {
        "policy": config.policy,
        "mode": mode,
        "weights": None if run is None else config.weights,
        "privileged": True if is_privileged else None,
        "env": config.env.name,
        "domain": None if domain is None else domain.name,
        "seed": config.seed,
        "success_rate": rate,
        "standard_error": round(binomial_standard_error(rate, played.success.numel()), 4),
        "reward": played.reward.mean().item(),
        "turns": turns / played.success.numel(),
        "dialogues": played.success.numel(),
        "turns_per_second": round(turns / seconds),
        "success_rate_per_replica": per_replica if replicas > 1 else None,
        "values_per_replica": values if any(values) else None,
        "skipped": None if domain is None else domain.skipped or None,
    }
    return {key: value for key, value in line.items() if value is not None}


def _write_log(config: EvaluateConfig, env: DialogueEnv, policy: TensorDictModuleBase) -> None:
    """Writes the first dialogues of the evaluation as readable acts."""
    assert config.log is not None
    file = Path(expanduser(config.log))
    dialogues = min(config.log_dialogues, config.dialogues)
    texts = transcripts(env, policy, dialogues, seed=config.seed)
    try:
        write_text(file, "\n".join(texts))
    except OSError as error:
        raise ConfigError(f"log={config.log} cannot be written: {error.strerror}") from error


def transcripts(env: DialogueEnv, policy: Policy, dialogues: int, *, seed: int = 0) -> list[str]:
    """Plays dialogues and returns them as texts, a line for each turn.

    They are the first dialogues of :func:`evaluate` with the same environment and seed, of the
    first replica.

    Args:
        env: batch size [replicas, dialogues in parallel].
        policy: writes an action.
        dialogues: number of dialogues.
        seed: seed of policy and environment.
    """
    from torch import nn

    from bbq_torchrl.simulator import Transcript
    from bbq_torchrl.trainers import evaluation_rollouts

    transcript = Transcript(env.simulator.domain)
    states: list[TensorDictBase] = []
    texts: list[str] = []

    def recorded(tensordict: TensorDictBase) -> TensorDictBase:
        states.append(env.dialogues[0].cpu())
        return policy(tensordict)

    if isinstance(policy, nn.Module):
        policy.eval()
    for rollout in evaluation_rollouts(env, recorded, dialogues, seed=seed):
        states.append(env.dialogues[0].cpu())
        for place in range(rollout.batch_size[-2]):
            texts.append(_text(transcript, len(texts), [state[place] for state in states]))
        states.clear()
    return texts


def _text(transcript: Transcript, number: int, states: list[TensorDictBase]) -> str:
    """Returns the text of a dialogue: goal, turns and outcome."""
    lines = [f"dialogue {number + 1}: {transcript.goal(states[0])}"]
    for state in states:
        lines += [f"  {line}" for line in transcript.lines(state)]
        if bool(state["done"]):
            lines.append("  success" if bool(state["success"]) else "  failure")
            break
    return "\n".join(lines) + "\n"
