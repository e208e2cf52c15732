"""BBQN in one file: its mathematics is the library's, and its loop does what the file says."""

import sys

import pytest
import torch
from q_transitions import ACTIONS, FEATURES, transitions
from tiny import rows
from torchrl.data import Categorical
from torchrl.objectives import HardUpdate

from bbq_torchrl.bayes import BayesMLP
from bbq_torchrl.networks import q_actor
from bbq_torchrl.objectives import BBQNLoss
from bbq_torchrl.runs.compose import compose


@pytest.fixture
def example(names_of):
    return names_of("bbqn_from_scratch")


@pytest.fixture
def nets(example):
    """The example's network and the library's, with the same means and standard deviations."""
    ours = example["BayesQNetwork"](FEATURES, ACTIONS)
    theirs = BayesMLP(
        FEATURES,
        ACTIONS,
        example["HIDDEN"],
        prior_std=example["PRIOR_STD"],
        mean_init="kaiming",
        std_init=example["STD_INIT"],
    )
    torch.testing.assert_close(flat(ours, lambda layer: layer.sigma), theirs.posterior.sigma)
    with torch.no_grad():
        for layer in ours.layers:
            layer.rho.uniform_(-5, -1)
        theirs.posterior.mu.copy_(flat(ours, lambda layer: layer.mu))
        theirs.posterior.rho.copy_(flat(ours, lambda layer: layer.rho))
    return ours, theirs


def flat(net, entry):
    # With the bias as its last row a layer lies in memory as it does in the library's one vector.
    return torch.cat([entry(layer).flatten() for layer in net.layers])


def test_kl_mean_and_draws_are_the_librarys(nets):
    ours, theirs = nets
    ours.kl().backward()
    kl = theirs.posterior.kl()
    kl.backward()
    torch.testing.assert_close(ours.kl(), kl.squeeze())
    torch.testing.assert_close(flat(ours, lambda layer: layer.mu.grad), theirs.posterior.mu.grad)
    torch.testing.assert_close(flat(ours, lambda layer: layer.rho.grad), theirs.posterior.rho.grad)

    x = torch.rand(7, FEATURES)
    torch.testing.assert_close(ours(x, "mean"), theirs(x, "mean"))

    def same_noise(draw):
        torch.manual_seed(1)
        return draw()

    torch.testing.assert_close(
        same_noise(lambda: ours(x, "draws")), same_noise(lambda: theirs(x, "local"))
    )
    noise = same_noise(lambda: flat(ours, lambda layer: torch.randn_like(layer.mu)))
    weights = theirs.posterior.mu + theirs.posterior.sigma * noise
    torch.testing.assert_close(same_noise(lambda: ours(x, "draw")), theirs(x, weights=weights))


def test_target_and_loss_are_the_librarys(example, nets):
    ours, theirs = nets
    with torch.no_grad():  # so narrow that every draw is the mean
        theirs.posterior.rho.fill_(-20)
        for layer in ours.layers:
            layer.rho.fill_(-20)
    loss = BBQNLoss(
        q_actor(theirs, Categorical(ACTIONS)),
        noise_std=example["NOISE_STD"],
        kl_temperature=example["KL_TEMPERATURE"],
        gamma=example["GAMMA"],
        num_data=1000,
    )
    HardUpdate(loss, value_network_update_interval=0).step()
    data = transitions((), (7,))
    expected = loss(data.clone())["loss"].item()
    targets = example["targets_of"](ours, data)
    found = example["loss_of"](ours, data["observation"], data["action"], targets, 1000)
    assert found.item() == pytest.approx(expected, rel=1e-4)


def test_the_numbers_are_those_of_the_quick_protocol(example):
    config = compose(["+experiment=agents/bbqn_map", "env=full", "protocol=quick"])
    agent, protocol = config.agent, config.protocol
    assert example["HIDDEN"] == tuple(agent.hidden)
    for name in ("prior_std", "std_init", "noise_std", "kl_temperature", "gamma"):
        assert example[name.upper()] == getattr(agent, name)
    for name in ("rounds", "dialogues", "freezes", "epochs", "batch_size", "capacity"):
        assert example[name.upper()] == getattr(protocol, name)
    assert example["EVALUATION_DIALOGUES"] == protocol.eval_dialogues
    assert example["SPIKE_DIALOGUES"] == config.spike.dialogues
    assert (example["LEARNING_RATE"], example["FINAL_RATE"]) == (agent.lr, protocol.lr_final)
    for number in range(protocol.rounds):
        rate = example["rate_of"](number, protocol.rounds)
        assert rate == pytest.approx(protocol.lr_share(number))


def test_a_tiny_training_adds_a_line(example, tmp_path, monkeypatch, capsys):
    names = example["train"].__globals__
    for name, value in {"SPIKE_DIALOGUES": 4, "DIALOGUES": 2, "HIDDEN": (8,)}.items():
        monkeypatch.setitem(names, name, value)
    file = tmp_path / "results.csv"
    file.write_text("seed,rounds,final_success\n7,40,0.5\n")
    options = ["--seed=1", "--rounds=2", "--dialogues=4", f"--file={file}"]
    monkeypatch.setattr(sys, "argv", ["bbqn_from_scratch.py", *options])
    example["main"]()
    lines = rows(file)
    assert [(line["seed"], line["rounds"]) for line in lines] == [("7", "40"), ("1", "2")]
    assert float(lines[1]["final_success"]) in {0, 0.25, 0.5, 0.75, 1}
    assert "in 4 dialogues" in capsys.readouterr().out
