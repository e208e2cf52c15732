"""One dialogue at a time as a Gymnasium environment, for agents of other libraries.

Importing this module registers ``bbq_torchrl/MovieDialogue-v0``. Gymnasium 1 asks no installed
package for its environments; with the id
``bbq_torchrl.envs.gymnasium:bbq_torchrl/MovieDialogue-v0`` it imports the module by itself. The
module needs the package gymnasium (the extra ``gymnasium``).
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
import torch
from gymnasium.error import ResetNeeded
from gymnasium.spaces import Box, Dict, Discrete
from tensordict import TensorDict

from bbq_torchrl.domains import Domain, load_domain, movie_domain
from bbq_torchrl.envs.dialogue import DialogueEnv
from bbq_torchrl.simulator import Transcript
from bbq_torchrl.simulator.features import COUNT_SCALE, TURN_SCALE
from bbq_torchrl.utils.seeds import LARGEST_SEED, checked_seed, seed_of_process

if TYPE_CHECKING:
    from typing import TypeAlias

    from numpy.typing import NDArray

    Observation: TypeAlias = NDArray[np.float32] | dict[str, NDArray[Any]]

ENV_ID = "bbq_torchrl/MovieDialogue-v0"
"""The id of the environment for ``gymnasium.make``."""


class GymnasiumDialogue(gymnasium.Env[Any, Any]):
    """A dialogue of an agent with a simulated user.

    It plays what a :class:`~bbq_torchrl.envs.DialogueEnv` of one dialogue plays: after
    ``reset(seed=s)`` the same dialogues as after its ``set_seed(s)``. The observation is what the
    agent has heard and said, [features], float32; the user's goal is in ``info`` only. An action is
    the index of one of ``env.unwrapped.domain.actions``; ``action_masks()`` says which are legal;
    another one is played all the same.

    ===============  =====  =====================================================================
    key of ``info``  type   meaning
    ===============  =====  =====================================================================
    ``success``      bool   the dialogue has ended in success
    ``is_success``   bool   the same, at the end of a dialogue only: where Stable-Baselines3 looks
    ``turns``        int    turns that the agent has taken
    ``goal``         str    what the user wants, such as ``request(ticket) inform(moviename=...)``
    ``goal_id``      int    which of the domain's goals that is
    ``action_mask``  array  int8 [actions], the legal actions, as ``action_space.sample`` takes it
    ===============  =====  =====================================================================

    Args:
        domain: what the dialogues are about: a domain, or its folder; None: movie tickets.
        render_mode: ``"ansi"``: ``render()`` returns the last turn as text.
        mask_in_observation: whether the observation is a dictionary of ``observation``, as above,
            and ``action_mask``, bool [actions], where TorchRL's ``GymEnv`` finds it.
        **settings: those of :class:`~bbq_torchrl.envs.DialogueEnv` but ``batch_size`` (it is one
            dialogue), such as ``slot_error_prob``, ``max_turn``, the rewards, ``seed``, and
            ``schedule``, whose round :meth:`set_round` enters.

    Raises:
        ValueError: if a setting is out of range, or the domain's folder holds none.

    Examples:
        >>> import gymnasium
        >>> import bbq_torchrl.envs.gymnasium
        >>> env = gymnasium.make("bbq_torchrl/MovieDialogue-v0", slot_error_prob=0.1)
        >>> observation, info = env.reset(seed=0)
        >>> observation.shape, info["success"]
        ((268,), False)
        >>> int(env.unwrapped.action_masks().sum())
        39
    """

    metadata = {"render_modes": ["ansi"], "render_fps": 1}  # noqa: RUF012 - Gymnasium has it so

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
        # The process that numbers which nobody chose are for, None where somebody did.
        self._unseeded_in = 0 if settings.get("seed") is None else None
        self._is_over = True
        self.action_space = Discrete(len(domain.actions))
        self._mask_in_observation = mask_in_observation
        self.observation_space = _feature_space(self._dialogue)
        if mask_in_observation:
            mask = Box(0, 1, (len(domain.actions),), dtype=np.bool_)  # type: ignore[arg-type]
            self.observation_space = Dict(observation=self.observation_space, action_mask=mask)

    @property
    def domain(self) -> Domain:
        """The domain of the dialogues."""
        return self._dialogue.domain

    def set_round(self, round: int) -> None:
        """Enters a round of training: see :meth:`bbq_torchrl.envs.DialogueEnv.set_round`."""
        self._dialogue.set_round(round)

    def action_masks(self) -> NDArray[np.bool_]:
        """Returns which actions are legal, bool [actions]."""
        legal = self._dialogue.simulator.action_mask(self._dialogue.active_slots)
        mask: NDArray[np.bool_] = legal.cpu().numpy().copy()
        return mask

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Begins a dialogue. Returns the first observation, and ``info``.

        Args:
            seed: of this dialogue and those that follow; None continues with the random numbers.
            options: ``{"goal_id": n}``: the user has the domain's goal n, and all else is as it
                would have been.

        Raises:
            ValueError: if the seed is not from 0 to 2**63 - 1, or for options of another name or
                value.
        """
        if seed is not None:
            seed, self._unseeded_in = checked_seed(seed), None
        if not {*(options or ())} <= {"goal_id"}:
            raise ValueError(f"options must have no key but 'goal_id', got {[*(options or ())]}")
        super().reset(seed=seed)
        if self._unseeded_in not in (None, os.getpid()):
            seed = seed_of_process(int(self.np_random.integers(LARGEST_SEED)))
            self._unseeded_in = os.getpid()
        if seed is not None:
            self._dialogue.set_seed(seed)
        begun = self._dialogue.reset(**(options or {}))
        self._is_over = False
        return self._observation(begun), self._info(begun)

    def step(self, action: np.int64 | int) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Plays one turn. Returns observation, reward, terminated, truncated and ``info``.

        Args:
            action: an index of ``domain.actions``.

        Raises:
            ValueError: if it is none.
            gymnasium.error.ResetNeeded: before the first reset, and after a dialogue's end.
        """
        if self._is_over:
            raise ResetNeeded("there is no dialogue under way: call reset() first")
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

    def _observation(self, told: TensorDict) -> Observation:
        features: NDArray[np.float32] = told["observation"].cpu().numpy()
        if not self._mask_in_observation:
            return features
        return {"observation": features, "action_mask": self.action_masks()}

    def _info(self, told: TensorDict) -> dict[str, Any]:
        success = bool(told["success"])
        return {
            "success": success,
            **({"is_success": success} if self._is_over else {}),
            "turns": int(told["turns"]),
            "goal": self._transcript.goal(self._dialogue.dialogues),
            "goal_id": int(told["goal_id"]),
            "action_mask": self.action_masks().astype(np.int8),
        }


def _feature_space(env: DialogueEnv) -> Box:
    """Returns the space of the features: all between 0 and 1, but for numbers of acts and rows."""
    layout = env.layout
    high = np.ones(layout.size, dtype=np.float32)
    # The last turn counts two acts beyond max_turn at most; the first state has one already.
    high[layout["turn"]] = (2 * env.max_agent_turns + 1) / TURN_SCALE
    high[layout["kb_count"]] = len(env.domain.records) / COUNT_SCALE
    return Box(np.zeros_like(high), high)


if ENV_ID not in gymnasium.registry:
    gymnasium.register(id=ENV_ID, entry_point="bbq_torchrl.envs.gymnasium:GymnasiumDialogue")
