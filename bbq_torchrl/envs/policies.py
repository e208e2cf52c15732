"""Scripted policies: a fixed sequence, a form to fill in, random actions, and those of a domain."""

from __future__ import annotations

from operator import index
from typing import TYPE_CHECKING

import torch
from tensordict.nn import TensorDictModuleBase

from bbq_torchrl.domains.parts import PRIVILEGED_POLICY, RANDOM_POLICY
from bbq_torchrl.envs.clairvoyant import ClairvoyantPolicy
from bbq_torchrl.envs.repair import RepairPolicy, indices

if TYPE_CHECKING:
    from collections.abc import Sequence

    from tensordict import NestedKey, TensorDictBase
    from torchrl.envs import EnvBase

    from bbq_torchrl.domains import Domain


class SequencePolicy(TensorDictModuleBase):
    """Plays a fixed sequence of actions, then repeats the last one.

    Args:
        actions: the actions in order, at least one.
        turns_key: entry that counts the turns taken in the episode, int64 ``[*batch, 1]``.
        action_key: where the action is written, int64 ``[*batch]``.

    Raises:
        ValueError: if the sequence is empty, or an action is not an integer.

    Examples:
        >>> from tensordict import TensorDict
        >>> policy = SequencePolicy([4, 2, 7])
        >>> policy(TensorDict(turns=torch.tensor([[0], [1], [9]]), batch_size=[3]))["action"]
        tensor([4, 2, 7])
    """

    actions: torch.Tensor

    def __init__(
        self,
        actions: Sequence[int],
        *,
        turns_key: NestedKey = "turns",
        action_key: NestedKey = "action",
    ) -> None:
        super().__init__()
        if len(actions) == 0:
            raise ValueError("actions must have at least one action, got none")
        try:
            indices = [index(action) for action in actions]
        except TypeError:
            raise ValueError(f"actions must be indices, integers, got {actions!r}") from None
        self.turns_key, self.action_key = turns_key, action_key
        self.in_keys, self.out_keys = [turns_key], [action_key]
        self.register_buffer("actions", torch.tensor(indices, dtype=torch.int64))

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the action of this turn."""
        turns = tensordict.get(self.turns_key).squeeze(-1)
        action = self.actions[turns.clamp(max=self.actions.shape[0] - 1)]
        return tensordict.set(self.action_key, action)


class CarefulPolicy(TensorDictModuleBase):
    """Requests unfilled slots, answers requests, offers a booking and ends.

    It uses only flags of the observation. It makes its requests in order, without those of filled
    slots. Then it answers the first open question of each turn until all are answered, offers the
    booking, and ends. It skips illegal requests and answers.

    Args:
        env: a :class:`~bbq_torchrl.envs.DialogueEnv` with the domain's actions; transforms must not
            change the observation.
        slots: the slots that it requests, in order.

    Raises:
        ValueError: if the domain lacks an action that the policy needs.
    """

    def __init__(self, env: EnvBase, slots: Sequence[str]) -> None:
        super().__init__()
        self.in_keys, self.out_keys = ["observation", "action_mask"], ["action"]
        domain, layout = env.domain, env.layout
        answers = [
            slot
            for slot in domain.slots
            if slot not in domain.special_slots and f"inform({slot})" in domain.action_names
        ]
        offer = f"inform({domain.complete_slot})"
        plan = [*(f"request({slot})" for slot in slots), *(f"inform({slot})" for slot in answers)]
        self._plan = indices(domain.action_index(name) for name in (*plan, offer))
        self._requested = indices(layout.column("agent_requested", slot) for slot in slots)
        self._filled = indices(layout.column("filled", slot) for slot in slots)
        self._asked = indices(layout.column("user_requested", slot) for slot in answers)
        self._answered = layout.column("agent_act", "inform")
        self._offered = layout.column("agent_informed", domain.complete_slot)
        self._end = domain.action_index("thanks")

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the next action."""
        flags, is_legal = tensordict.get("observation") > 0, tensordict.get("action_mask")
        positions = torch.arange(len(self._filled), device=flags.device)
        position = torch.where(flags[..., self._requested], positions, -1).amax(-1, keepdim=True)
        has_answered = flags[..., self._answered, None]
        may_request = ~flags[..., self._filled] & (positions > position) & ~has_answered
        may_offer = torch.ones_like(has_answered)
        is_open = torch.cat([may_request, flags[..., self._asked], may_offer], -1)
        is_open = is_open & is_legal[..., self._plan]
        action = self._plan[is_open.to(torch.uint8).argmax(-1)]
        action = torch.where(flags[..., self._offered], self._end, action)
        return tensordict.set("action", action)


class UniformPolicy(TensorDictModuleBase):
    """Plays uniformly random legal actions. Unlike TorchRL's ``RandomPolicy`` it reads the mask.

    Args:
        mask_key: bool ``[*batch, N]``, the legal actions, at least one.
        action_key: where the action is written, int64 ``[*batch]``.

    Examples:
        >>> from tensordict import TensorDict
        >>> mask = torch.tensor([[False, True, False]])
        >>> UniformPolicy()(TensorDict(action_mask=mask, batch_size=[1]))["action"]
        tensor([1])
    """

    def __init__(
        self, *, mask_key: NestedKey = "action_mask", action_key: NestedKey = "action"
    ) -> None:
        super().__init__()
        self.mask_key, self.action_key = mask_key, action_key
        self.in_keys, self.out_keys = [mask_key], [action_key]

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Writes the action."""
        mask = tensordict.get(self.mask_key)
        uniform = torch.rand(mask.shape, device=mask.device)
        return tensordict.set(self.action_key, torch.where(mask, uniform, -1.0).argmax(-1))


def scripted_policy(name: str, env: EnvBase) -> TensorDictModuleBase:
    """Returns a policy by name, on the environment's device.

    Args:
        name: one of the domain's policies (the movie domain has ``rule``, ``rule_inform``,
            ``careful_essential``, ``careful`` and ``repair``), ``"random"``, or the privileged
            ``"clairvoyant"``.
        env: a :class:`~bbq_torchrl.envs.DialogueEnv`; transforms must not change the observation
            and the mask.

    Raises:
        ValueError: if the policy does not exist, or a step of its script is illegal in the
            environment's round.

    Examples:
        >>> from bbq_torchrl.domains import movie_domain
        >>> from bbq_torchrl.envs import DialogueEnv
        >>> env = DialogueEnv(movie_domain(), batch_size=(3,), seed=0)
        >>> rollout = env.rollout(2, scripted_policy("rule", env))
        >>> [env.domain.action_names[action] for action in rollout["action"][0]]
        ['request(moviename)', 'request(starttime)']
    """
    domain: Domain = env.domain
    if name == RANDOM_POLICY:
        return UniformPolicy()
    if name == PRIVILEGED_POLICY:
        return ClairvoyantPolicy(env)
    if name not in domain.policies:
        names = (RANDOM_POLICY, *domain.policies, PRIVILEGED_POLICY)
        raise ValueError(f"policy must be one of {', '.join(names)}, got {name!r}")
    specification = domain.policies[name]
    policy: TensorDictModuleBase
    if specification.kind == "script":
        steps = [domain.action_index(step) for step in specification.steps]
        is_legal = env.simulator.action_mask(env.active_slots)
        for step in steps:
            if not is_legal[step]:
                action = domain.actions[step]
                raise ValueError(
                    f"policy {name} cannot be played in round {env.round}: the slot "
                    f"{action.slot} of its step {action} is added later"
                )
        policy = SequencePolicy(steps)
    elif specification.kind == "careful":
        policy = CarefulPolicy(env, specification.steps)
    else:
        policy = RepairPolicy(env, specification.steps)
    return policy.to(env.device)
