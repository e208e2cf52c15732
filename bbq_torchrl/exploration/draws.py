"""Draws of the Q-values of a policy, from whatever uncertainty it has."""

from __future__ import annotations

from collections.abc import Callable

from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from bbq_torchrl.bayes import GaussianPosterior
from bbq_torchrl.bayes.layers import local_weight_scope
from bbq_torchrl.bayes.scope import weight_scope
from bbq_torchrl.exploration.base import EvaluationPolicy, Greedy
from bbq_torchrl.exploration.bootstrap import MajorityVote
from bbq_torchrl.networks import BootstrapMLP, FlatMLP
from bbq_torchrl.networks.q_actor import split_actor


def q_draws(policy: TensorDictModuleBase, inputs: Tensor, draws: int) -> Tensor | None:
    """Returns draws of the Q-values in one state, ``[*replicas, draws, N]``.

    For a Bayesian network, they are rows of local reparameterization, which for one state have
    exactly the distribution of as many draws of all weights. For bootstrapped heads, they are the
    heads. For a network trained with dropout, they are draws of its units (Gal and Ghahramani,
    2016). ``None`` for a policy without uncertainty.

    Args:
        policy: the policy that a run reports.
        inputs: the observation, ``[*replicas, 1, F]``.
        draws: the number of draws; bootstrapped heads ignore it.
    """
    if isinstance(policy, MajorityVote):
        return _mean_values(policy, inputs).squeeze(-3)
    if not isinstance(policy, (EvaluationPolicy, Greedy)) or not any(
        isinstance(module, GaussianPosterior) or (isinstance(module, FlatMLP) and module.dropout)
        for module in policy.modules()
    ):
        return None
    rows = inputs.expand(*inputs.shape[:-2], draws, inputs.shape[-1])
    with local_weight_scope(policy, rows.shape[:-1]):
        return _values(policy, rows)


def path_draws(
    policy: TensorDictModuleBase, inputs: Tensor, draws: int
) -> tuple[int, Callable[[Tensor], Tensor]] | None:
    """Returns the number of networks, and the function that evaluates them between two states.

    The weights must stay fixed along a path, which local reparameterization does not allow, so
    these are draws of all weights. The function takes ``[*replicas, K, F]`` and returns
    ``[*replicas, K, N]``, one row per network, and is differentiable. ``None`` for a policy of
    another kind.

    Args:
        policy: the policy that a run reports.
        inputs: an observation, ``[*replicas, 1, F]``.
        draws: the number of draws; heads and networks without a posterior ignore it.
    """
    if isinstance(policy, MajorityVote):
        heads = _mean_values(policy, inputs).shape[-2]
        # The heads divide the gradient to their trunk by their number, which this undoes.
        networks = [module for module in policy.modules() if isinstance(module, BootstrapMLP)]
        scale = heads if any(network.trunk is not None for network in networks) else 1

        def of_heads(rows: Tensor) -> Tensor:
            rows = rows + (scale - 1) * (rows - rows.detach())
            return _mean_values(policy, rows).diagonal(dim1=-3, dim2=-2).movedim(-1, -2)

        return heads, of_heads
    if not isinstance(policy, (EvaluationPolicy, Greedy)):
        return None
    found = [module for module in policy.modules() if isinstance(module, GaussianPosterior)]
    if not found:
        return 1, lambda rows: _mean_values(policy, rows)
    weights = {one: one.sample((draws,)).detach() for one in found}

    def of_draws(rows: Tensor) -> Tensor:
        with weight_scope(weights=weights):
            return _values(policy, rows)

    return draws, of_draws


def _values(policy: TensorDictModuleBase, rows: Tensor) -> Tensor:
    """Returns the values of the network behind a policy, ``[*replicas, rows, ..., N]``."""
    network, choice = split_actor(policy.actor)
    assert choice is not None  # our policies choose by their values
    tensordict = TensorDict({network.in_keys[0]: rows}, batch_size=rows.shape[:-1])
    values: Tensor = network(tensordict).get(choice.action_value_key)
    return values


def _mean_values(policy: TensorDictModuleBase, rows: Tensor) -> Tensor:
    with weight_scope("mean"):
        return _values(policy, rows)
