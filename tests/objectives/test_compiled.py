"""Draws and losses as one graph of torch.compile."""

import pytest
import torch
from q_transitions import bayes_loss, heads_loss, noisy_loss, plain_loss, transitions

pytestmark = [
    pytest.mark.slow,
    # torch.compile's own, of a custom autograd function
    pytest.mark.filterwarnings("ignore:.*should not be instantiated:DeprecationWarning"),
]


@pytest.mark.parametrize(
    ("make", "settings"),
    [
        (plain_loss, {"dropout": 0.5}),
        (plain_loss, {"double_dqn": True}),
        (bayes_loss, {"cache": True}),
        (bayes_loss, {"target": "mc", "kl": "sampled"}),
        (bayes_loss, {"target": "mc", "target_noise": "shared"}),
        (heads_loss, {}),
        (noisy_loss, {}),
    ],
)
def test_a_loss_with_its_gradient_is_one_graph(make, settings):
    (loss, update), td = make((2,), **settings), transitions((2,))
    update.step()
    # Tracing is what may break; a backend that generates code would only take longer.
    compiled = torch.compile(lambda td: loss(td)["loss"], fullgraph=True, backend="aot_eager")
    found = compiled(td.clone())
    found.backward()
    assert found.isfinite()
    assert all(p.grad.isfinite().all() and p.grad.any() for p in loss.parameters())
    if "double_dqn" in settings:  # has no noise
        torch.testing.assert_close(found, loss(td)["loss"])
