"""Draws of the Q-values of one state, of whatever a policy is uncertain by."""

from __future__ import annotations

from typing import TYPE_CHECKING

from tensordict import TensorDict

from bbq_torchrl.bayes import GaussianPosterior
from bbq_torchrl.bayes.layers import local_weight_scope
from bbq_torchrl.bayes.scope import weight_scope
from bbq_torchrl.exploration import EvaluationPolicy, Greedy, MajorityVote
from bbq_torchrl.networks import BootstrapMLP, FlatMLP
from bbq_torchrl.networks.q_actor import split_actor

if TYPE_CHECKING:
    from collections.abc import Callable

    from tensordict.nn import TensorDictModuleBase
    from torch import Tensor


def q_draws(policy: TensorDictModuleBase, inputs: Tensor, draws: int) -> Tensor | None:
    """Returns draws of the Q-values in one state, ``[*replicas, draws, N]``.

    Of a Bayesian network they are rows of local reparameterization, which for one state have
    exactly the distribution of as many draws of all weights; of bootstrapped heads they are the
    heads; of a network that has learned with dropout they are draws of its units (Gal and
    Ghahramani, 2016). ``None`` for a policy that is not uncertain.

    Args:
        policy: the policy that a run reports.
        inputs: the observation, ``[*replicas, 1, F]``.
        draws: how many; heads are as many as there are.
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

    Along a path the weights must stay, which local reparameterization does not give: these are
    draws of all weights. The function takes ``[*replicas, K, F]`` and returns
    ``[*replicas, K, N]``, a network a row, and can be differentiated. ``None`` for a policy of
    another kind than ours.

    Args:
        policy: the policy that a run reports.
        inputs: an observation, ``[*replicas, 1, F]``.
        draws: how many; heads are as many as there are, and a network without posterior is one.
    """
    if isinstance(policy, MajorityVote):
        heads = _mean_values(policy, inputs).shape[-2]
        # Heads pass their trunk a gradient divided by their number, which is undone here.
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
    assert choice is not None  # policies of ours choose by their values
    tensordict = TensorDict({network.in_keys[0]: rows}, batch_size=rows.shape[:-1])
    values: Tensor = network(tensordict).get(choice.action_value_key)
    return values


def _mean_values(policy: TensorDictModuleBase, rows: Tensor) -> Tensor:
    with weight_scope("mean"):
        return _values(policy, rows)
