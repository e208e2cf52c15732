"""A single dialogue as a Gymnasium environment, for agents of other libraries.

Importing this module registers ``bbq_torchrl/MovieDialogue-v0``. Gymnasium 1 does not search
installed packages for environments, but imports the module by itself for the id
``bbq_torchrl.envs.gymnasium:bbq_torchrl/MovieDialogue-v0``. The module needs the package gymnasium
(the extra ``gymnasium``).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeAlias

import gymnasium
import numpy as np
import torch
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, Dict, Discrete
from numpy.typing import NDArray
from tensordict import TensorDict

from bbq_torchrl.domains import Domain, load_domain, movie_domain
from bbq_torchrl.envs.dialogue import DialogueEnv
from bbq_torchrl.simulator import Transcript
from bbq_torchrl.simulator.features import COUNT_SCALE, TURN_SCALE
from bbq_torchrl.utils.seeds import checked_seed

Observation: TypeAlias = NDArray[np.float32] | dict[str, NDArray[Any]]

ENV_ID = "bbq_torchrl/MovieDialogue-v0"
"""The id of the environment for ``gymnasium.make``."""


class GymnasiumDialogue(gymnasium.Env[Any, Any]):
    """A dialogue of an agent with a simulated user.

    It plays the same dialogues as a :class:`~bbq_torchrl.envs.DialogueEnv` of one dialogue, with
    ``reset(seed=s)`` in place of ``set_seed(s)``. The observation is float32 [features]; the user's
    goal is only in ``info``, as a number, and in :attr:`goal`. An action is an index in
    ``env.unwrapped.domain.actions``. ``action_masks()`` returns the legal ones; illegal ones are
    played nevertheless.

    ===============  =====  =====================================================================
    key of ``info``  type   meaning
    ===============  =====  =====================================================================
    ``success``      bool   the dialogue has ended in success
    ``is_success``   bool   the same, only at the end of a dialogue, for Stable-Baselines3
    ``turns``        int    turns that the agent has taken
    ``goal_id``      int    index of the goal in the domain's goals
    ``action_mask``  array  int8 [actions], the legal actions, for ``action_space.sample``
    ===============  =====  =====================================================================

    Args:
        domain: a domain or its folder; None: movie tickets.
        render_mode: ``"ansi"``: ``render()`` returns the last turn as text.
        mask_in_observation: whether the observation is a dictionary of ``observation``, as above,
            and ``action_mask``, bool [actions], for TorchRL's ``GymEnv``.
        **settings: arguments of :class:`~bbq_torchrl.envs.DialogueEnv` except ``batch_size``, such
            as ``slot_error_prob``, ``max_turn``, the rewards, ``seed``, and ``schedule``, whose
            round is set by :meth:`set_round`.

    Raises:
        ValueError: if a setting is out of range, or the domain cannot be loaded.

    Examples:
        >>> import gymnasium
        >>> import bbq_torchrl.envs.gymnasium
        >>> env = gymnasium.make("bbq_torchrl/MovieDialogue-v0", slot_error_prob=0.1)
        >>> observation, info = env.reset(seed=0)
        >>> observation.shape, bool(info["success"])
        ((268,), False)
        >>> int(env.unwrapped.action_masks().sum())
        39
    """

    metadata = {"render_modes": ["ansi"], "render_fps": 1}  # noqa: RUF012 - as in Gymnasium

    def __init__(
        self,
        domain: Domain | Path | str | None = None,
        *,
        render_mode: str | None = None,
        mask_in_observation: bool = False,
        **settings: Any,
    ) -> None:
        if domain is None:
            domain = movie_domain()
        elif not isinstance(domain, Domain):
            domain = load_domain(Path(domain))
        self.render_mode = render_mode
        self._dialogue = DialogueEnv(domain, batch_size=(), **settings)
        self._transcript = Transcript(self._dialogue.simulator.domain)
        self._is_over = True
        self.action_space = Discrete(len(domain.actions))
        self._mask_in_observation = mask_in_observation
        # From 0 to 1 except for the numbers of acts and records. The last turn is at most two acts
        # beyond max_turn, and the first state counts one act.
        layout = self._dialogue.layout
        high = np.ones(layout.size, dtype=np.float32)
        high[layout["turn"]] = (2 * self._dialogue.max_agent_turns + 1) / TURN_SCALE
        high[layout["kb_count"]] = len(domain.records) / COUNT_SCALE
        self.observation_space = Box(np.zeros_like(high), high)
        if mask_in_observation:
            mask = Box(0, 1, (len(domain.actions),), dtype=np.bool_)  # type: ignore[arg-type]
            self.observation_space = Dict(observation=self.observation_space, action_mask=mask)

    @property
    def domain(self) -> Domain:
        """The domain of the dialogues."""
        return self._dialogue.domain

    @property
    def goal(self) -> str:
        """The user's goal, such as ``request(ticket) inform(moviename=...)``."""
        return self._transcript.goal(self._dialogue.dialogues)

    def set_round(self, round: int) -> None:
        """Enters a round of training: see :meth:`bbq_torchrl.envs.DialogueEnv.set_round`."""
        self._dialogue.set_round(round)

    def action_masks(self) -> NDArray[np.bool_]:
        """Returns the legal actions, bool [actions]."""
        legal = self._dialogue.simulator.action_mask(self._dialogue.active_slots)
        mask: NDArray[np.bool_] = legal.cpu().numpy().copy()
        return mask

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Starts a dialogue. Returns the first observation and ``info``.

        Args:
            seed: seed of this dialogue and the following ones; None: the generator continues.
            options: ``{"goal_id": n}`` gives the user the domain's goal n and leaves other random
                choices unchanged.

        Raises:
            ValueError: if the seed is not from 0 to 2**63 - 1, or an option is unknown or invalid.
        """
        if seed is not None:
            seed = checked_seed(seed)
        if not {*(options or ())} <= {"goal_id"}:
            raise ValueError(f"options must have no key but 'goal_id', got {[*(options or ())]}")
        super().reset(seed=seed)
        if seed is not None:
            self._dialogue.set_seed(seed)
        started = self._dialogue.reset(**(options or {}))
        self._is_over = False
        return self._observation(started), self._info(started)

    def step(self, action: np.int64 | int) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Plays one turn. Returns observation, reward, terminated, truncated and ``info``.

        Args:
            action: an index in ``domain.actions``.

        Raises:
            ValueError: if the index is out of range.
            gymnasium.error.ResetNeeded: before the first reset, and after a dialogue's end.
        """
        if self._is_over:
            raise ResetNeeded("no dialogue is in progress: call reset() first")
        index = np.asarray(action).squeeze()
        if not self.action_space.contains(index):
            last = len(self.domain.actions) - 1
            raise ValueError(f"action must be an integer from 0 to {last}, got {action!r}")
        played = self._dialogue.step(TensorDict({"action": torch.tensor(int(index))}))["next"]
        self._is_over = bool(played["terminated"])
        return (
            self._observation(played),
            float(played["reward"]),
            self._is_over,
            False,
            self._info(played),
        )

    def render(self) -> str | None:
        """Returns the last turn as text; None unless ``render_mode`` is ``"ansi"``."""
        if self.render_mode != "ansi":
            return None
        return "\n".join(self._transcript.lines(self._dialogue.dialogues))

    def _observation(self, step: TensorDict) -> Observation:
        features: NDArray[np.float32] = step["observation"].cpu().numpy()
        if not self._mask_in_observation:
            return features
        return {"observation": features, "action_mask": self.action_masks()}

    def _info(self, step: TensorDict) -> dict[str, Any]:
        # NumPy's types alone, which TorchRL's reader of info can stack
        success = np.bool_(bool(step["success"]))
        return {
            "success": success,
            **({"is_success": success} if self._is_over else {}),
            "turns": np.int64(int(step["turns"])),
            "goal_id": np.int64(int(step["goal_id"])),
            "action_mask": self.action_masks().astype(np.int8),
        }


if ENV_ID not in gymnasium.registry:
    gymnasium.register(id=ENV_ID, entry_point="bbq_torchrl.envs.gymnasium:GymnasiumDialogue")
