"""Every agent with every exploration: trains, resumes and evaluates."""

from __future__ import annotations

import dataclasses
from itertools import cycle, product
from typing import TYPE_CHECKING

import pytest
import torch
from tiny import TINY

from bbq_torchrl import evaluate
from bbq_torchrl.cli.store import compose
from bbq_torchrl.cli.training import build_trainer, make_agent
from bbq_torchrl.evaluation.metrics import read_metrics
from bbq_torchrl.options import EvaluateConfig, explorations, schemas
from bbq_torchrl.run import run

if TYPE_CHECKING:
    from pathlib import Path

    from bbq_torchrl.evaluation import RunResult
    from bbq_torchrl.options import Config
    from bbq_torchrl.trainers import RoundTrainer

SHRUNKEN = (*TINY, "spike.policy=random", "replicas=2")
EXTENSION = ("env.start=1", "env.every=1")
NEEDED = {("dqn", "noisy"): ("agent.noisy=true", "agent.dropout=0")}
# Each pair once, its environment and reward in turn, so that each agent meets all four of them.
PAIRS = [(agent, explore) for agent, explores in explorations().items() for explore in explores]
CELLS = [
    (*pair, *surroundings)
    for pair, surroundings in zip(PAIRS, cycle(product(schemas()["env"], schemas()["intrinsic"])))
]
VARIANTS = {
    "BBQN-MC": ("agent=bbqn", "agent.target=mc"),
    "shared target noise": ("agent=bbqn", "agent.target=mc", "agent.target_noise=shared"),
    "separate networks with priors": (
        *("agent=bootstrap", "agent.trunk_layers=0"),
        *("agent.prior_scale=3", "agent.double=true"),
    ),
    "VIME-MC": ("agent=bbqn", "intrinsic=vime", "intrinsic.weights=mc"),
    "dynamics now and then": ("agent=dqn", "intrinsic=vime", "intrinsic.dynamics_every=3"),
}


pytestmark = pytest.mark.usefixtures("without_curves")


@pytest.fixture(scope="module")
def evaluation() -> EvaluateConfig:
    """An evaluation of a few dialogues, of which only the run is not given yet."""
    return compose(["policy=rule", "dialogues=6", "batch=6"], EvaluateConfig)


def command(*choices: str, domain: Path) -> list[str]:
    extension = EXTENSION if "env=domain_ext" in choices else ()
    return [*choices, *SHRUNKEN, *extension, "domain=folder", f"domain.path={domain}"]


def trained(config: Config, folder: Path) -> tuple[RunResult, dict[int, list[torch.Tensor]]]:
    """Runs a configuration. Returns its result, and what the loss holds after each round."""
    learned = {}

    def keep(trainer: RoundTrainer, rows: object) -> None:
        state = trainer.loss.state_dict().values()
        learned[trainer.rounds_done] = [tensor.clone() for tensor in state]

    return run(config, folder, [keep]), learned


def check_run(overrides: list[str], evaluation: EvaluateConfig, tmp_path: Path) -> None:
    """Trains at once and in two parts, which must end bitwise the same, and evaluates the run."""
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    config = compose(overrides)
    for folder in (whole, parts):
        folder.mkdir()
    result, at_once = trained(config, whole)
    one_round = dataclasses.replace(config.protocol, rounds=1)
    trained(dataclasses.replace(config, protocol=one_round), parts)
    resumed, later = trained(dataclasses.replace(config, resume=str(parts)), parts)

    assert len(result.per_replica) == 2
    assert resumed.success_rate == result.success_rate
    assert (list(at_once), list(later)) == ([1, 2], [2])
    for one, other in zip(at_once[2], later[2], strict=True):
        assert torch.equal(one, other)
    assert [item.while_training for item in resumed.per_replica] == [
        item.while_training for item in result.per_replica
    ]
    columns = [name for name in read_metrics(whole).columns if not name.startswith("seconds")]
    for name in columns:
        assert (read_metrics(whole)[name] == read_metrics(parts)[name]).all(), name

    line = evaluate.evaluation(
        dataclasses.replace(evaluation, policy=str(parts), env=config.env, domain=config.domain)
    )
    assert line["dialogues"] == 12
    assert 0 <= line["success_rate"] <= 1


@pytest.mark.parametrize(("agent", "explore", "env", "intrinsic"), CELLS)
def test_a_cell_trains_resumes_and_evaluates(
    agent, explore, env, intrinsic, evaluation, restaurant_folder, tmp_path
):
    choices = (f"agent={agent}", f"explore={explore}", f"env={env}", f"intrinsic={intrinsic}")
    needed = NEEDED.get((agent, explore), ())
    check_run(command(*choices, *needed, domain=restaurant_folder), evaluation, tmp_path)


@pytest.mark.parametrize("variant", VARIANTS)
def test_a_variant_trains_resumes_and_evaluates(variant, evaluation, restaurant_folder, tmp_path):
    choices = (*VARIANTS[variant], "env=domain_ext")
    check_run(command(*choices, domain=restaurant_folder), evaluation, tmp_path)


def test_an_intrinsic_reward_is_learned_from_and_never_reported(restaurant_folder, tmp_path):
    """Before anything is learned the two play alike, so whatever differs would be the bonus."""
    rounds = {}
    for name in ("none", "vime"):
        choices = ["agent=dqn", f"intrinsic={name}", "protocol.rounds=1"]
        if name == "vime":
            choices.append("intrinsic.eta=1000")
        config = compose([*command(domain=restaurant_folder), *choices])
        (tmp_path / name).mkdir()
        result = run(config, tmp_path / name)
        rounds[name] = read_metrics(tmp_path / name)
        assert result.reward <= config.env.success_reward

    for column in ("reward", "success_rate", "turns"):
        assert (rounds["none"][column] == rounds["vime"][column]).all()
    assert (rounds["vime"]["td_error"] > 10 * rounds["none"]["td_error"]).all()


def test_the_dynamics_of_what_does_not_exist_yet_stay_at_the_prior(restaurant_folder, tmp_path):
    choices = ["agent=dqn", "intrinsic=vime", "intrinsic.prior_std=0.2", "env=domain_ext"]
    late = ["env.start=1", "env.every=1", "protocol.rounds=1"]
    config = compose([*command(*choices, domain=restaurant_folder), *late])
    trainer, _ = build_trainer(config, tmp_path)
    inputs, _ = trainer.loss.dynamics_loss.dynamics.network.layout.shapes[0]
    network = trainer.loss.dynamics_loss.dynamics.network
    inactive = ~torch.cat(
        [
            trainer.env.active_features,
            trainer.env.simulator.action_mask(trainer.env.active_slots),
        ]
    )
    assert inactive.shape == (inputs,)
    assert inactive.any()

    trainer.train()

    first = network.layout.unflatten(network.posterior.mu)[0][0]
    rho = network.layout.unflatten(network.posterior.rho)[0][0]
    assert not first[..., inactive, :].any()
    assert (rho[..., inactive, :] == network.posterior.prior_rho).all()
    assert first[..., ~inactive, :].any()


@pytest.mark.parametrize(
    ("fraction", "epsilons"),
    [(0, [0.5, 0.1, 0.1, 0.1]), (0.5, [0.5, 0.3, 0.1, 0.1]), (1, [0.5, 0.4, 0.3, 0.2])],
)
def test_a_schedule_falls_over_its_share_of_the_rounds(fraction, epsilons):
    given = ["explore.eps_init=.5", "explore.eps_end=.1", f"explore.anneal_fraction={fraction}"]
    config = compose(["agent=dqn", "protocol.rounds=4", *given])
    env = config.env.make(config.domain.make(), (1, 2))
    agent = make_agent(config, env)
    seen = []
    for _ in range(4):
        seen.append(float(agent.metrics["epsilon"]()))
        for module in agent.policy.modules():
            if hasattr(module, "step"):
                module.step(1)
    assert seen == pytest.approx(epsilons)
