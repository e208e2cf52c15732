"""A trained agent that talks: its action in a state, its beliefs, and its reasons."""

from __future__ import annotations

import hashlib
import threading
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import torch
from tensordict import TensorDict
from torchrl.envs.utils import ExplorationType, set_exploration_type

from bbq_torchrl import __version__
from bbq_torchrl.envs import DialogueEnv
from bbq_torchrl.exploration.draws import path_draws, q_draws
from bbq_torchrl.people.dialogue import Belief, Beliefs
from bbq_torchrl.runs.loading import load_run
from bbq_torchrl.settings import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from torch import Tensor

    from bbq_torchrl.domains import Domain
    from bbq_torchrl.simulator import Simulator


DRAWS = 300
"""The number of draws of the Q-values behind bands and probabilities."""

_WHY_DRAWS = 40
_STEPS = 16  # of the path from the empty to the given observation
_BANDS = torch.tensor([0.05, 0.25, 0.75, 0.95])


@dataclass(frozen=True)
class Reason:
    """The contribution of one group of features to the difference of two Q-values.

    Attributes:
        group: the group; "nothing known" is the difference before anything is known.
        mean: the mean of its contribution.
        band90: lower and upper end of the middle 90 % of its posterior; the mean without one.
    """

    group: str
    mean: float
    band90: tuple[float, float]


@dataclass(frozen=True)
class Reasons:
    """The reasons for an action over the next best one, from the agent's network.

    Attributes:
        action: the action taken.
        other: the other action with the greatest mean.
        difference: the difference of their Q-values, the sum of all parts.
        parts: the contributions by group of features, the greatest first.
    """

    action: str
    other: str
    difference: Reason
    parts: tuple[Reason, ...]


class TrainedAgent:
    """An agent from a run folder.

    Its methods may be called from several threads, and each call seeds its random draws.

    Args:
        folder: the run folder, or ``shipped:<name>``.
        replica: the index of the run's replica that talks.
        mode: the policy of a Bayesian agent, as in :func:`~bbq_torchrl.load_run`.
        weights: the last weights, or those of the best evaluation during training.

    Attributes:
        domain: the domain.
        simulator: the domain's simulator, as in the agent's training.
        active: bool ``[S]``, the slots active for the agent.
        legal: bool ``[A]``, the actions that the agent has.
        name: the name of the policy, such as ``mean`` or ``greedy``.

    Raises:
        ValueError: no run folder, one without dialogues, or no such replica.
    """

    def __init__(
        self,
        folder: Path | str,
        *,
        replica: int = 0,
        mode: str | None = None,
        weights: Literal["last", "best"] = "last",
    ) -> None:
        env, policy, config, self.name = load_run(folder, dialogues=1, mode=mode, weights=weights)
        if not isinstance(env, DialogueEnv):
            raise ConfigError(f"{folder} is a run of env={config.env.name}, which has no dialogues")
        if not 0 <= replica < config.replicas:
            raise ConfigError(
                f"replica must be between 0 and {config.replicas - 1} for {folder}, got {replica}"
            )
        self.domain: Domain = env.domain
        self.simulator: Simulator = env.simulator
        self.active = env.active_slots
        self.legal: Tensor = env.simulator.action_mask(env.active_slots)
        self._replicas, self._replica = config.replicas, replica
        self._policy = policy.eval()
        self._lock = threading.Lock()

    def fingerprint(self) -> str:
        """Returns a hash of the weights and of everything else that determines the actions."""
        digest = hashlib.sha256(f"{__version__} {self.name} {self._replica}".encode())
        for key, value in sorted(self._policy.state_dict().items()):
            if isinstance(value, torch.Tensor):
                digest.update(key.encode())
                digest.update(value.detach().cpu().contiguous().numpy().tobytes())
        digest.update(repr(self.legal.tolist()).encode())
        digest.update(repr(self.domain).encode())
        return digest.hexdigest()

    def decide(self, observation: Tensor, seed: int, allowed: Tensor | None = None) -> int:
        """Returns the action that the policy takes, an index into the domain's actions.

        Args:
            observation: float32 ``[F]``.
            seed: the seed of the policy's random choices.
            allowed: bool ``[A]``, the actions to choose from; ``None`` for all legal ones.
        """
        return int(self._acted(observation, seed, allowed)["action"])

    @torch.no_grad()
    def beliefs(self, observation: Tensor, seed: int) -> Beliefs | None:
        """Returns the agent's beliefs about its legal actions, the best first.

        Args:
            observation: float32 ``[F]``.
            seed: the seed of the draws.

        Returns:
            ``None`` for an agent without a posterior.
        """
        with self._seeded(seed):
            found = q_draws(self._policy, self._rows(observation), DRAWS)
        if found is None:
            return None
        values = found[self._replica].masked_fill(~self.legal, -torch.inf)
        chances = torch.bincount(values.argmax(-1), minlength=values.shape[-1]) / len(values)
        legal = self.legal.nonzero().flatten()
        bands = values[:, legal].quantile(_BANDS, dim=0)
        means = values[:, legal].mean(0)
        actions = []
        for rank in means.argsort(descending=True).tolist():
            low90, low50, high50, high90 = bands[:, rank].tolist()
            action, mean = int(legal[rank]), float(means[rank])
            name, chance = self.domain.action_names[action], float(chances[action])
            actions.append(Belief(name, mean, (low50, high50), (low90, high90), chance))
        return Beliefs(tuple(actions), float(torch.special.entr(chances).sum()))

    def values(self, observation: Tensor, seed: int) -> dict[str, float]:
        """Returns the values that the policy acts on, by legal action, the greatest first."""
        values = self._acted(observation, seed)["action_value"]
        values = values.masked_fill(~self.legal, -torch.inf)
        return {
            self.domain.action_names[action]: float(values[action])
            for action in values.argsort(descending=True)[: int(self.legal.sum())].tolist()
        }

    def reasons(self, observation: Tensor, seed: int) -> Reasons | None:
        """Returns the reasons for the agent's action over the next best one, by group of features.

        Integrated gradients (Sundararajan et al., 2017) of the difference of the two Q-values from
        an empty observation to the given one, for each draw of the weights: the parts of a draw add
        up to its difference.

        Args:
            observation: float32 ``[F]``.
            seed: the seed of the draws.

        Returns:
            ``None`` for a policy with an unknown network, or if only one action is legal.
        """
        inputs, names = self._rows(observation), self.domain.action_names
        best = self.decide(observation, seed)
        beliefs = self.beliefs(observation, seed)
        if beliefs is None:
            ranked = list(self.values(observation, seed))
        else:
            ranked = [belief.action for belief in beliefs.actions]
        others = [name for name in ranked if name != names[best]]
        with self._seeded(seed):
            found = path_draws(self._policy, inputs, _WHY_DRAWS)
            if found is None or not others:
                return None
            second = self.domain.action_index(others[0])
            draws, values = found
            shape = (self._replicas, draws, observation.shape[-1])
            with torch.no_grad():
                ends = [values(rows.expand(shape))[self._replica] for rows in (inputs * 0, inputs)]
            total = torch.zeros(draws, observation.shape[-1])
            for step in range(_STEPS):
                rows = (inputs * ((step + 0.5) / _STEPS)).expand(shape).clone().requires_grad_()
                with torch.enable_grad():
                    q = values(rows)[self._replica]
                    difference = (q[:, best] - q[:, second]).sum()
                (slope,) = torch.autograd.grad(difference, rows)
                total += slope[self._replica] / _STEPS
        added = total * observation
        layout = self.simulator.layout
        parts = {name: added[:, layout[name]].sum(-1) for name in layout}
        at_start, at_end = (end[:, best] - end[:, second] for end in ends)
        # The small error of the finite path goes to no group: any split would be arbitrary.
        parts["nothing known"] = at_start
        reasons = (_reason(name, part) for name, part in parts.items())
        return Reasons(
            names[best],
            names[second],
            _reason("all", at_end),
            tuple(sorted(reasons, key=lambda reason: -abs(reason.mean))),
        )

    @torch.no_grad()
    def _acted(self, observation: Tensor, seed: int, allowed: Tensor | None = None) -> TensorDict:
        """Returns the output of the policy for one observation."""
        mask = self.legal if allowed is None else allowed
        tensordict = TensorDict(
            {
                "observation": self._rows(observation),
                "action_mask": mask.expand(self._replicas, 1, -1),
            },
            batch_size=[self._replicas, 1],
        )
        with self._seeded(seed), set_exploration_type(ExplorationType.DETERMINISTIC):
            return self._policy(tensordict)[self._replica, 0]

    def _rows(self, observation: Tensor) -> Tensor:
        return observation.expand(self._replicas, 1, -1)

    @contextmanager
    def _seeded(self, seed: int) -> Iterator[None]:
        """Seeds torch's global generator, for one thread at a time, and restores it."""
        with self._lock, torch.random.fork_rng(devices=()):
            torch.manual_seed(seed)
            yield


def _reason(group: str, draws: Tensor) -> Reason:
    low, high = draws.quantile(torch.tensor([0.05, 0.95])).tolist()
    return Reason(group, float(draws.mean()), (low, high))
