"""The dialogue environment: the simulator as a TorchRL environment, and domain extension."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import index
from typing import Any, SupportsIndex

import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Binary, Bounded, Categorical, Composite, Unbounded
from torchrl.envs import EnvBase, Transform

from bbq_torchrl.domains import Domain, tensorize
from bbq_torchrl.simulator import (
    Channel,
    ErrorModel,
    Rewards,
    Simulator,
    SlotErrorMode,
)
from bbq_torchrl.simulator.profiles import Users
from bbq_torchrl.utils.seeds import checked_seed, seed_of_process, unshared_seed

_LOADED = 0  # in place of a process: the state is that of an environment that nobody seeded


@dataclass(frozen=True)
class ExtensionSchedule:
    """A schedule that starts with a domain's essential slots and adds others one at a time.

    Lipton et al. (2018) train 40 rounds on the essential slots and then add a slot every 10 rounds.
    The domain's ``extension_order`` has the order.

    Args:
        start: the round, counted from 0, that adds the first slot.
        every: rounds from one addition to the next.

    Raises:
        ValueError: if ``start`` is below 0 or ``every`` below 1.

    Examples:
        >>> from bbq_torchrl.domains import movie_domain
        >>> schedule = ExtensionSchedule(start=40, every=10)
        >>> len(schedule.active(movie_domain(), 39))
        8
        >>> "genre" in schedule.active(movie_domain(), 40)
        True
    """

    start: int = 40
    every: int = 10

    def __post_init__(self) -> None:
        # Not settings.check: any integer will do, of NumPy or of torch too.
        if self.start < 0:
            raise ValueError(f"start must be a round from 0 on, got {self.start}")
        if self.every < 1:
            raise ValueError(f"every must be at least 1 round, got {self.every}")

    def active(self, domain: Domain, round: int) -> tuple[str, ...]:
        """Returns the slots active in a round, in the order of the domain's slots.

        Args:
            domain: the domain.
            round: the round, counted from 0.
        """
        added = {slot for start, slot in self.additions(domain).items() if start <= round}
        return tuple(slot for slot in domain.slots if slot in added or slot in domain.essential)

    def never_active(self, domain: Domain) -> tuple[str, ...]:
        """Returns the slots that no round activates; goals are restricted to the others.

        Raises:
            ValueError: if the agent has actions for one of them, which could never be played.
        """
        active = {*domain.essential, *domain.extension_order}
        never = tuple(slot for slot in domain.slots if slot not in active)
        dead = [slot for slot in never if any(action.slot == slot for action in domain.actions)]
        if dead:
            raise ValueError(
                f"domain extension would never activate {', '.join(dead)}, for which the agent has "
                f"actions: domain {domain.name!r} must have them in essential or in extension_order"
            )
        return never

    def additions(self, domain: Domain) -> dict[int, str]:
        """Returns the added slot by round."""
        order = enumerate(domain.extension_order)
        return {self.start + index * self.every: slot for index, slot in order}


class DialogueEnv(EnvBase):
    """A batch of dialogues between an agent and agenda-based users.

    ================  =============  =======================================================
    key               shape          meaning
    ================  =============  =======================================================
    ``observation``   ``*B, F``      float32 features; ``env.layout`` has their positions
    ``action_mask``   ``*B, N``      bool, the legal actions
    ``action``        ``*B``         int64, index in ``env.domain.actions``; other integer dtypes
                                     are accepted
    ``reward``        ``*B, 1``      float32
    ``done``          ``*B, 1``      bool; always ``terminated``, never ``truncated``
    ``success``       ``*B, 1``      bool, the dialogue has ended in success
    ``turns``         ``*B, 1``      int64, turns that the agent has taken
    ``goal_id``       ``*B, 1``      int64, index of the user's goal in ``env.domain.goals``
    ================  =============  =======================================================

    The environment has the state of its dialogues (``env.dialogues``) and the generator of all its
    random choices. Its ``state_dict`` contains both; that of a ``TransformedEnv`` around it needs
    :class:`~bbq_torchrl.envs.EnvState` among the transforms.

    - ``reset(resume=True)`` returns the observation of the current dialogues without changing them,
      for instance after loading.
    - ``reset(goal_id=5)`` gives this goal of the domain to the users of all dialogues that it
      starts, and leaves other random choices unchanged.
    - A dialogue that has ended does not change until it is reset. A dialogue whose entry ``_step``
      is False does not change in that turn, with a reward of 0 (TorchRL's ``ConditionalSkip``).
    - Actions that the mask forbids are played nevertheless.
    - Each turn and each reset draws random numbers for the whole batch, so that no dialogue
      affects the random numbers of another.

    Args:
        domain: the domain of the dialogues.
        batch_size: the shape of the batch, of positive numbers.
        slot_error_prob: probability that an informed slot is misunderstood; ``None`` for the
            domain's reference difficulty.
        slot_error_mode: effect of such an error, see :class:`~bbq_torchrl.simulator.ErrorModel`.
        intent_error_prob: probability that the user's act is misunderstood.
        max_turn: acts of both sides after which a dialogue fails.
        success_reward: reward of the turn that ends a dialogue in success.
        failure_reward: reward of the turn that ends a dialogue otherwise.
        turn_reward: reward of every other turn.
        schedule: domain extension; ``None``: all slots are active from the start.
        seed: seed of the generator; ``None`` draws one from torch's global generator, a different
            one in each process.
        device: device of the dialogues.
        channel: the channel between user and tracker, made for the domain's tensors, instead of the
            errors above.
        users: the name of a mix of users (``"people"``), or its
            :class:`profiles <bbq_torchrl.simulator.Profile>`.

    Attributes:
        layout: the layout of the observation's features.
        max_agent_turns: the largest number of agent turns in a dialogue.
        round: the domain extension's round of training.
        active_slots: the slots active in this round, bool ``[S]``.

    Raises:
        ValueError: if a setting is out of range, the schedule never adds a slot that the agent has
            actions for, or the device is absent.

    Examples:
        >>> from bbq_torchrl.domains import movie_domain
        >>> env = DialogueEnv(movie_domain(), batch_size=(50,), seed=0)
        >>> rollout = env.rollout(5, break_when_any_done=False)
        >>> rollout["observation"].shape
        torch.Size([50, 5, 268])
        >>> rollout["next", "reward"].shape
        torch.Size([50, 5, 1])
    """

    def __init__(
        self,
        domain: Domain,
        *,
        batch_size: Sequence[int] = (),
        slot_error_prob: float | None = None,
        slot_error_mode: SlotErrorMode = "value",
        intent_error_prob: float = 0.0,
        max_turn: int = 40,
        success_reward: float = Rewards.success,
        failure_reward: float = Rewards.failure,
        turn_reward: float = Rewards.turn,
        schedule: ExtensionSchedule | None = None,
        seed: int | None = None,
        device: torch.device | str = "cpu",
        channel: Channel | None = None,
        users: Users = "paper",
    ) -> None:
        super().__init__(device=torch.empty(0, device=device).device, batch_size=batch_size)
        if slot_error_prob is None:
            slot_error_prob = domain.reference_slot_error_prob
        tensors = tensorize(domain)
        self.domain = domain
        self.schedule = schedule
        if schedule is not None:
            schedule.never_active(domain)
        if channel is None:
            channel = ErrorModel(tensors, slot_error_prob, slot_error_mode, intent_error_prob)
        rewards = Rewards(success_reward, failure_reward, turn_reward)
        simulator = Simulator(
            tensors, errors=channel, rewards=rewards, max_turn=max_turn, users=users
        )
        self.simulator = simulator.to(self.device)
        self.layout, self.max_agent_turns = simulator.layout, simulator.max_agent_turns
        self._dialogues: TensorDict | None = None
        self._generator = torch.Generator(self.device)
        self._set_seed(seed)
        self._make_specs()
        self.set_round(0)

    # -- properties ------------------------------------------------------------------------------

    @property
    def active_features(self) -> torch.Tensor:
        """The features that can differ from 0 in this round, bool ``[F]``."""
        return self.layout.active(self.active_slots)

    @property
    def dialogues(self) -> TensorDict:
        """The state of the dialogues, see :class:`~bbq_torchrl.simulator.Simulator`.

        Raises:
            RuntimeError: before the first reset.
        """
        if self._dialogues is None:
            raise RuntimeError("no dialogue has started yet: call reset() first")
        return self._dialogues

    def set_round(self, round: int) -> None:
        """Enters a round of training, which activates the slots of the domain extension.

        Dialogues that have started keep their goals. Without a schedule every slot is active in
        every round. ``rand_action`` respects the new slots at once; in a ``TransformedEnv``, which
        copies the action spec, it needs TorchRL's ``ActionMask`` for that.

        Args:
            round: the round, counted from 0.

        Raises:
            ValueError: if the round is below 0.
        """
        if round < 0:
            raise ValueError(f"round must be 0 or later, got {round}")
        self.round = index(round)
        slots = self.domain.slots
        schedule = self.schedule
        active = slots if schedule is None else schedule.active(self.domain, self.round)
        self.active_slots = torch.tensor([slot in active for slot in slots], device=self.device)
        legal = self.simulator.action_mask(self.active_slots)
        self._action_mask = legal.expand(*self.batch_size, -1)
        # rand_action draws from the spec, whose mask keeps random actions legal.
        self.action_spec = Categorical(
            len(self.domain.actions),
            self.batch_size,
            device=self.device,
            dtype=torch.int64,
            mask=None if self.schedule is None else self._action_mask,
        )

    # -- TorchRL's interface ---------------------------------------------------------------------

    def _make_specs(self) -> None:
        batch, device = self.batch_size, self.device
        tensors, one = self.simulator.domain, (*self.batch_size, 1)
        self.observation_spec = Composite(
            observation=Unbounded((*batch, self.layout.size), device=device, dtype=torch.float32),
            action_mask=Binary(
                tensors.n_actions, (*batch, tensors.n_actions), device=device, dtype=torch.bool
            ),
            success=Binary(1, one, device=device, dtype=torch.bool),
            turns=Bounded(0, self.max_agent_turns, one, device=device, dtype=torch.int64),
            goal_id=Bounded(0, len(self.domain.goals) - 1, one, device=device, dtype=torch.int64),
            shape=batch,
        )
        self.reward_spec = Unbounded(one, device=device, dtype=torch.float32)
        flag = Binary(1, one, device=device, dtype=torch.bool)
        self.done_spec = Composite(
            done=flag, terminated=flag.clone(), truncated=flag.clone(), shape=batch
        )

    def set_seed(self, seed: SupportsIndex | None = None, static_seed: bool = False) -> int | None:
        """Seeds the generator. Returns a seed for another environment, as in TorchRL.

        Args:
            seed: an integer; ``None`` draws one from torch's global generator.
            static_seed: whether to return the same seed instead.

        Raises:
            ValueError: if the seed is not an integer from 0 to 2**63 - 1.
        """
        number = None if seed is None else checked_seed(seed)
        following: int | None = super().set_seed(number, static_seed)
        return following

    def _set_seed(self, seed: SupportsIndex | None) -> None:
        # The process that a drawn seed is for, or _LOADED; None if the caller gave the seed.
        self._unseeded_in = os.getpid() if seed is None else None
        if seed is None:
            seed = unshared_seed(int(torch.randint(1 << 62, ())))
        self._generator.manual_seed(checked_seed(seed))

    def _reset(
        self,
        tensordict: TensorDictBase | None = None,
        *,
        resume: bool = False,
        goal_id: int | None = None,
        **_: Any,
    ) -> TensorDict:
        if resume:
            if bool(self.dialogues["done"].any()):
                text = "resume=True needs dialogues in progress, got some that have ended"
                raise ValueError(text)
            return self._emit(self.dialogues)
        goals = len(self.domain.goals)
        if goal_id is not None and (isinstance(goal_id, bool) or goal_id not in range(goals)):
            raise ValueError(f"goal_id must be an integer from 0 to {goals - 1}, got {goal_id!r}")
        which = None if tensordict is None else tensordict.get("_reset", None)
        is_copy = self._unseeded_in not in (None, os.getpid())  # by fork, pickle or a loaded state
        if is_copy and (self._unseeded_in != _LOADED or which is None):
            drawn = self._draw_seed() ^ int(torch.randint(1 << 62, ()))
            self._generator.manual_seed(seed_of_process(drawn))
            self._unseeded_in = os.getpid()
        draws = self.simulator.draw_reset(self.batch_size, self._generator)
        if goal_id is not None:  # replaces the drawn number by one that selects this goal
            draws["goal"].fill_((goal_id + 0.5) / goals)
        started = self.simulator.reset(draws, self.active_slots)
        if which is not None and self._dialogues is not None:
            started = started.where(which.view(self.batch_size), self._dialogues)
        self._dialogues = started
        return self._emit(started)

    def _draw_seed(self) -> int:
        generator = self._generator
        return int(torch.randint(1 << 62, (), generator=generator, device=generator.device))

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        before, count = self.dialogues, len(self.domain.actions)
        action = _indices(tensordict["action"], self.batch_size, count)
        draws = self.simulator.draw_turn(self.batch_size, self._generator)
        after = self.simulator.turn(before, action, draws, self.active_slots)
        which = tensordict.get("_step", None)
        if which is not None:
            is_played = which.view(self.batch_size) | before["done"]  # ended ones stay as they are
            if not bool(is_played.all()):
                reward = torch.where(is_played, after["reward"], 0.0)
                after = after.where(is_played, before).set("reward", reward)
        self._dialogues = after
        return self._emit(after).set("reward", after["reward"][..., None].clone())

    def _emit(self, state: TensorDict) -> TensorDict:
        """Returns the observation of the dialogues, without sharing memory with their state."""
        done = state["done"][..., None]
        return TensorDict(
            {
                "observation": self.simulator.observe(state, self.active_slots),
                "action_mask": self._action_mask.clone(),
                "success": state["success"][..., None].clone(),
                # The simulator counts the acts of both sides.
                "turns": state["turn"][..., None] // 2,
                "goal_id": state["goal_id"][..., None].clone(),
                "done": done.clone(),
                "terminated": done.clone(),
                "truncated": torch.zeros_like(done),
            },
            batch_size=self.batch_size,
            device=self.device,
        )

    # -- moving and saving -----------------------------------------------------------------------

    def to(self, device: torch.device | str) -> DialogueEnv:
        """Moves the environment to a device. Returns itself.

        A generator belongs to a device, so the environment gets a new one, seeded from the old one.
        """
        device = torch.empty(0, device=device).device
        if device != self.device:
            seed = self._draw_seed()
            super().to(device)
            self._generator = torch.Generator(self.device).manual_seed(seed)
            self.simulator = self.simulator.to(self.device)
            if self._dialogues is not None:
                self._dialogues = self._dialogues.to(self.device)
            self.set_round(self.round)
        return self

    def get_extra_state(self) -> dict[str, Any]:
        """Returns the dialogues, the generator and the round, for ``state_dict``."""
        dialogues = self._dialogues
        return {
            "domain": self.domain.name,
            "dialogues": None if dialogues is None else dialogues.clone().to_dict(),
            "generator": self._generator.get_state(),
            "seeded": self._unseeded_in is None,
            "round": self.round,
        }

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Loads the result of :meth:`get_extra_state`, whose dialogues then continue.

        If nobody seeded the environment that saved it, a complete reset draws a new seed: TorchRL
        loads a template's state into every worker, and workers play different dialogues.

        Raises:
            ValueError: if the saved dialogues have another domain or batch size.
        """
        saved = state["dialogues"]
        if saved is not None:
            batch, slots = saved["done"].shape, saved["held"].shape[-1]
            name = state["domain"]
            if (batch, name, slots) != (self.batch_size, self.domain.name, len(self.domain.slots)):
                raise ValueError(
                    f"the saved dialogues have batch size {list(batch)} and are of domain {name} "
                    f"with {slots} slots, the environment has {list(self.batch_size)} and is of "
                    f"{self.domain.name} with {len(self.domain.slots)}"
                )
            saved = TensorDict(saved, batch_size=batch).to(self.device).clone()
        self._dialogues = saved
        self._generator.set_state(state["generator"].cpu())
        self._unseeded_in = None if state["seeded"] else _LOADED
        self.set_round(state["round"])

    def load_state_dict(self, state_dict: Mapping[str, Any], *args: Any, **kwargs: Any) -> Any:
        """Loads the result of ``state_dict``.

        Raises:
            ValueError: if it is empty, such as the one that a ``Collector`` saves.
        """
        if not state_dict:
            raise ValueError(
                "the state to load must be that of the environment, got an empty one: a Collector "
                "saves it only for TransformedEnv(env, EnvState())"
            )
        return super().load_state_dict(state_dict, *args, **kwargs)


def _indices(action: torch.Tensor, batch_size: Sequence[int], count: int) -> torch.Tensor:
    """Returns indices of actions as int64, shape [*batch].

    Raises:
        ValueError: if shape or dtype differ, as for one-hot actions.
    """
    is_integer = not (action.is_floating_point() or action.is_complex())
    if not is_integer or action.dtype == torch.bool or action.shape != torch.Size(batch_size):
        raise ValueError(
            f"action must be Categorical: indices from 0 to {count - 1}, of an integer dtype and "
            f"shape {list(batch_size)}, got {action.dtype} of shape {list(action.shape)}"
        )
    return action.long()


class EnvState(Transform):
    """Adds the state of the base environment to the ``state_dict`` of a ``TransformedEnv``.

    TorchRL saves only the transforms of a ``TransformedEnv``, and so of a ``Collector`` and a
    ``Trainer``. This transform saves and loads a :class:`~bbq_torchrl.envs.DialogueEnv` (or a
    ``SerialEnv`` or ``ParallelEnv`` of them) along with them: dialogues, random generator and
    round. It has no other effect.

    A ``Collector`` does not save its last observation. Get it again after loading by
    ``collector.reset(resume=True)``, which restarts the counts of other transforms, such as
    ``StepCounter``. The ``MultiSyncCollector`` cannot pass on ``resume``: its dialogues continue,
    but each worker chooses its next actions from the observation before loading. A ``ParallelEnv``
    needs ``use_buffers=False``: with buffers, that of torchrl 0.14.1 responds too early after
    loading.

    Examples:
        >>> from torchrl.envs import TransformedEnv
        >>> from bbq_torchrl.domains import movie_domain
        >>> from bbq_torchrl.envs import DialogueEnv, EnvState
        >>> one, other = (
        ...     TransformedEnv(DialogueEnv(movie_domain(), seed=seed), EnvState())
        ...     for seed in (0, 1)
        ... )
        >>> observed = one.reset()
        >>> _ = other.load_state_dict(one.state_dict())
        >>> bool((other.reset(resume=True) == observed).all())
        True
    """

    def __init__(self) -> None:
        super().__init__(in_keys=[], out_keys=[])

    def get_extra_state(self) -> dict[str, Any]:
        """Returns the environment's ``state_dict``; empty outside an environment."""
        container = self.container
        return {} if container is None else dict(container.base_env.state_dict())

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Loads the result of :meth:`get_extra_state` into the environment."""
        if self.container is not None:
            self.container.base_env.load_state_dict(state)

    def _call(self, next_tensordict: TensorDictBase) -> TensorDictBase:
        return next_tensordict

    def _reset(
        self, tensordict: TensorDictBase, tensordict_reset: TensorDictBase
    ) -> TensorDictBase:
        return tensordict_reset
