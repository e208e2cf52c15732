"""The losses on which every convention is tested."""

import pytest
from q_transitions import bayes_loss, heads_loss, noisy_loss, plain_loss

LOSSES = {
    "dqn": plain_loss,
    "bbqn": bayes_loss,
    "bootstrap": heads_loss,
    "noisy": noisy_loss,
}


@pytest.fixture(params=LOSSES)
def make(request):
    """Makes a loss of each kind; with ``data_only`` it has no KL."""

    def loss(*args, data_only=False, **settings):
        if data_only and request.param == "bbqn":
            settings["kl_temperature"] = 0.0
        return LOSSES[request.param](*args, **settings)[0]

    return loss
