"""The tools that stand in for a CUDA device find what they are there to find."""

from __future__ import annotations

import pytest
import torch
from host_waits import HostWaitError, NeverWaits, use_tapes
from tensordict import TensorDict

from bbq_torchrl.modules import CudaGraph

WAITING = {
    "a number": lambda x: float(x.sum()),
    "a condition": lambda x: bool((x > 0).any()),
    "a mask as an index": lambda x: x[x > 0],
    "a mask as an index to write to": lambda x: x.clone().__setitem__(x > 0, x[:1]),
    "places of a mask": lambda x: (x > 0).nonzero(),
    "rows of a mask": lambda x: torch.masked_select(x, x > 0),
    "different values": lambda x: x.unique(),
    "a tensor from a list": lambda x: x + torch.tensor([1.0, 2.0, 3.0]),
    "a comparison": lambda x: torch.equal(x, x),
    "another device": lambda x: x.to("meta"),
}
NOT_WAITING = {
    "arithmetic with numbers": lambda x: torch.where(x > 0, 2 * x, 0.0),
    "an index": lambda x: x[x.argsort()],
    "filling": lambda x: torch.zeros_like(x).masked_fill_(x > 0, 1.0),
    "random numbers": lambda x: torch.randperm(3).to(x.dtype) + torch.rand(3),
}


@pytest.mark.parametrize("what", WAITING)
def test_what_waits_is_refused(what):
    with NeverWaits(), pytest.raises(HostWaitError):
        WAITING[what](torch.arange(3.0))


@pytest.mark.parametrize("what", NOT_WAITING)
def test_what_does_not_wait_is_let_through(what):
    with NeverWaits():
        NOT_WAITING[what](torch.arange(3.0))


def test_a_graph_takes_in_new_inputs_and_draws_new_numbers(monkeypatch):
    (made, total) = use_tapes(monkeypatch), torch.zeros(3)

    def add(inputs):
        drawn = torch.rand(3)
        total.add_(inputs["x"] * drawn)
        return TensorDict(drawn=drawn)

    graph = CudaGraph(add, torch.device("cpu"))
    torch.manual_seed(0)
    outputs = [graph(TensorDict(x=torch.full((3,), n)))["drawn"].clone() for n in (1.0, 2.0, 3.0)]
    assert graph.is_captured
    assert made[0].launches == 1
    torch.manual_seed(0)
    drawn = [torch.rand(3) for _ in range(3)]
    torch.testing.assert_close(torch.stack(outputs), torch.stack(drawn), rtol=0, atol=0)
    torch.testing.assert_close(total, drawn[0] + 2 * drawn[1] + 3 * drawn[2])


def test_what_is_put_in_the_place_of_a_tensor_is_lost_on_a_graph(monkeypatch):
    use_tapes(monkeypatch)
    held = {"x": torch.zeros(1)}
    graph = CudaGraph(lambda inputs: held["x"] + inputs["y"], torch.device("cpu"))
    inputs = TensorDict(y=torch.ones(1))
    graph(inputs), graph(inputs)
    held["x"] = torch.ones(1)
    assert graph(inputs).item() == 1.0


def test_inputs_of_another_shape_are_refused(monkeypatch):
    use_tapes(monkeypatch)
    graph = CudaGraph(lambda inputs: inputs["x"] + 1, torch.device("cpu"))
    graph(TensorDict(x=torch.ones(3)))
    with pytest.raises(ValueError, match=r"'x' must have the shape \[3\] .* got \[1\]"):
        graph(TensorDict(x=torch.ones(1)))
