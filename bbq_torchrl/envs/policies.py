"""The scripted policies of a domain as policies for its environment."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bbq_torchrl.envs.clairvoyant import ClairvoyantPolicy
from bbq_torchrl.envs.scripted import CarefulPolicy, SequencePolicy, UniformPolicy

if TYPE_CHECKING:
    from tensordict.nn import TensorDictModuleBase
    from torchrl.envs import EnvBase

    from bbq_torchrl.domains import Domain

__all__ = ["PRIVILEGED_POLICY", "RANDOM_POLICY", "scripted_policy"]

RANDOM_POLICY = "random"
"""The name of the policy that every domain has besides its own."""

PRIVILEGED_POLICY = "clairvoyant"
"""The name of the policy that reads the user's hidden goal, to set a ceiling beside agents."""


def scripted_policy(name: str, env: EnvBase) -> TensorDictModuleBase:
    """Returns a policy by name, on the environment's device.

    Args:
        name: one of the domain's policies (the movie domain has ``rule``, ``rule_inform``,
            ``careful_essential`` and ``careful``), ``"random"``, or the privileged
            ``"clairvoyant"``.
        env: a :class:`~bbq_torchrl.envs.DialogueEnv`, with or without transforms.

    Raises:
        ValueError: if there is no such policy.

    Example:
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
        policy = SequencePolicy([domain.action_index(step) for step in specification.steps])
    else:
        policy = CarefulPolicy(env, specification.steps)
    return policy.to(env.device)
