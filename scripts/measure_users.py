"""Measures agents on users they have and have not learned from: ``results/users.csv``.

    for agent in bbqn dqn bootstrap; do for users in people paper; do
    python train.py agent=$agent protocol=quick protocol.lr_final=1 env.users=$users \
        replicas=2 seed=910 hydra.run.dir=runs/users/${agent}_$users; done; done
    for users in people paper; do
    python train.py agent=bbqn protocol=quick protocol.lr_final=1 env.users=$users \
        replicas=2 seed=910 spike=imitate spike.dialogues=300 \
        hydra.run.dir=runs/users/imitate_$users; done
    python scripts/measure_users.py shipped:bbqn_map shipped:dqn runs/users/* [--dialogues 2000]

plays these runs and the scripted policy ``repair`` with the users of both kinds. ``answers`` is the
share of turns with a question in which the agent answers it at once, ``answers_after_offer`` the
same of the turns after an offer.
``warns_of_users`` is the probability that a dialogue with ``people`` is more uncertain than one
with ``paper`` of the same goal; ``warns_of_failure`` that a failure is more uncertain than a
success. A dialogue's uncertainty is the entropy of the best action over 20 draws of the weights
(or over the heads), the mean of its first five turns.
"""

from __future__ import annotations

import argparse
import csv
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from tensordict import TensorDict

from bbq_torchrl.bayes import weight_scope
from bbq_torchrl.exploration import MajorityVote
from bbq_torchrl.networks.q_actor import split_actor
from bbq_torchrl.options.env import FullDomain
from bbq_torchrl.runs.build import make_domain
from bbq_torchrl.runs.compose import compose
from bbq_torchrl.runs.folders import run_config, run_folder
from bbq_torchrl.runs.loading import trained_policy
from bbq_torchrl.trainers import episode_stats, evaluation_rollouts
from bbq_torchrl.utils import output

if TYPE_CHECKING:
    from collections.abc import Iterator

    from tensordict import TensorDictBase
    from tensordict.nn import TensorDictModuleBase

    from bbq_torchrl.envs import DialogueEnv
    from bbq_torchrl.options import Config

RESULT = Path(__file__).parents[1] / "results" / "users.csv"
PLAYED = ("paper", "people")
_TURNS, _DRAWS, _BATCH, _SEED = 5, 20, 500, 0
_HEAD = (
    *("agent", "trained_on", "rounds", "seed", "replica", "played_with", "dialogues"),
    *("success", "reward", "turns", "answers", "answers_after_offer"),
    *("warns_of_users", "warns_of_failure"),
)


def uncertainty(policy: TensorDictModuleBase, seen: torch.Tensor) -> torch.Tensor:
    """Returns the entropy of the best action, in nats, float32 ``[R, rows]``.

    Args:
        policy: of a Bayesian network, or the vote of heads.
        seen: observations ``[R, rows, F]``.
    """
    network, choice = split_actor(policy.actor)

    def values() -> torch.Tensor:
        tensordict = TensorDict({network.in_keys[0]: seen}, batch_size=seen.shape[:-1])
        key = "head_value" if isinstance(policy, MajorityVote) else choice.action_value_key
        return network(tensordict).get(key)

    if isinstance(policy, MajorityVote):
        drawn = values()
    else:
        with weight_scope("draw"):
            drawn = torch.stack([values() for _ in range(_DRAWS)], -2)
    best = torch.nn.functional.one_hot(drawn.argmax(-1), drawn.shape[-1]).float().mean(-2)
    return torch.special.entr(best).sum(-1)


def answers(env: DialogueEnv, batch: TensorDictBase) -> tuple[torch.Tensor, ...]:
    """Counts the turns with a question and the answers to it, each float32 ``[R, dialogues]``.

    Returns:
        Both for all turns, then both for those after an offer.
    """
    domain, layout, seen = env.simulator.domain, env.layout, batch["observation"] > 0
    asked = seen[..., layout["user_requested"]]
    asked[..., domain.ticket] = False
    told = domain.action_slot[batch["action"]].clamp(min=0)[..., None]
    is_inform = (domain.action_act == domain.act["inform"])[batch["action"]]
    has_asked = asked.any(-1) & batch["valid"]
    is_answer = has_asked & is_inform & asked.gather(-1, told).squeeze(-1)
    is_late = seen[..., layout["agent_informed"]][..., domain.complete]
    flags = (has_asked, is_answer, has_asked & is_late, is_answer & is_late)
    return tuple(flag.float().sum(-1) for flag in flags)


def area(high: torch.Tensor, low: torch.Tensor, pairs: torch.Tensor) -> float:
    """Returns the share of pairs whose first score is higher, ties counting half."""
    wins = (torch.sign(high[:, None] - low) + 1) / 2
    return float(wins[pairs].mean())


@torch.no_grad()
def rows_of(config: Config, folder: Path | None, dialogues: int) -> Iterator[tuple[str, ...]]:
    """Yields the rows of a run, or of the policy ``repair`` without a folder."""
    assert isinstance(config.env, FullDomain)
    domain = make_domain(config)
    run: tuple[str, ...] = ("repair", "", "", "")
    if folder is not None:
        numbers = (str(config.protocol.rounds), str(config.seed))
        imitates = ", imitating" if config.spike.name == "imitate" else ""
        run = (f"{config.agent.name}{imitates}", str(config.env.users), *numbers)
    known: dict[str, list[torch.Tensor]] = {}
    for users in PLAYED:
        env_option = replace(config.env, users=users)
        env = env_option.make(domain, (config.replicas, min(_BATCH, dialogues)))
        if folder is None:
            policy = env_option.make_policy("repair", env)
        else:
            policy, _ = trained_policy(config, folder, env)
        is_uncertain = folder is not None and config.agent.name in ("bbqn", "bootstrap")
        found = []
        for batch in evaluation_rollouts(
            env, policy, dialogues, seed=_SEED, max_steps=env_option.steps()
        ):
            stats, entropy = episode_stats(batch), torch.zeros(batch.shape[:-1])
            if is_uncertain:
                soon, valid = batch["observation"][..., :_TURNS, :], batch["valid"][..., :_TURNS]
                of_turns = uncertainty(policy, soon.flatten(1, 2)).view(valid.shape)
                entropy = (of_turns * valid).sum(-1) / valid.sum(-1)
            goal = batch["goal_id"][..., 0, 0]
            found.append((*stats, entropy, goal, *answers(env, batch)))
        known[users] = [torch.cat(parts, -1) for parts in zip(*found, strict=True)]
        success, reward, turns, entropy, goal, *counts = known[users]
        asked, told, asked_late, told_late = (count.sum(-1) for count in counts)
        for replica in range(config.replicas):
            warns = ["", ""]
            if is_uncertain:
                own, has = entropy[replica], success[replica]
                every = torch.ones(int((~has).sum()), int(has.sum()), dtype=torch.bool)
                warns[1] = f"{area(own[~has], own[has], every):.4f}"
                if users == "people":
                    before, goals = known["paper"][3][replica], known["paper"][4][replica]
                    same = goal[replica][:, None] == goals
                    warns[0] = f"{area(own, before, same):.4f}"
            means = (part[replica].double().mean() for part in (success, reward, turns))
            yield (
                *(*run, str(replica), users, str(dialogues)),
                *(f"{float(mean):.4f}" for mean in means),
                f"{float(told[replica] / asked[replica]):.4f}",
                f"{float(told_late[replica] / asked_late[replica]):.4f}",
                *warns,
            )


def main() -> None:
    """Runs the command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("runs", nargs="+", help="run folders, or shipped:<name>")
    parser.add_argument("--dialogues", type=int, default=2_000)
    given = parser.parse_args()
    torch.set_num_threads(1)
    rows = list(rows_of(compose(["agent=dqn"]), None, given.dialogues))
    for folder in map(run_folder, given.runs):
        rows += rows_of(run_config(folder), folder, given.dialogues)
        output.write(f"{','.join(rows[-1])}\n")
    with RESULT.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows((_HEAD, *rows))


if __name__ == "__main__":
    main()
