"""The tools that stand in for a CUDA device find what they are there to find."""

import pytest
import torch

from benchmarks.parts.host_waits import HostWaitError, NeverWaits

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
