"""The large-margin loss of demonstrated transitions, against its definition."""

import pytest
import torch
from q_transitions import heads_loss, plain_loss, result, transitions

MARGIN, FACTOR = 2.0, 7.0


def by_definition(values, td):
    """The loss of one network, row by row."""
    total = 0.0
    for q, row in zip(values, td, strict=True):
        if row["protected"]:
            ahead = (q + MARGIN).index_copy(0, row["action"].view(1), q[row["action"]].view(1))
            total = total + ahead[row["action_mask"]].max() - q[row["action"]]
    return FACTOR * total / len(td)


def added(loss, td, key):
    """What imitation adds to a value of the loss."""
    before = loss(td)[key]
    loss.imitate(MARGIN, FACTOR)
    return loss(td)[key] - before


def marked(replicas=(), batch=(12,), **settings):
    td = transitions(replicas, batch, dtype=torch.double, **settings)
    td["protected"] = torch.rand(*td.shape) < 0.5
    return td


@pytest.mark.parametrize("rows", [9, 12])
def test_a_loss_adds_it_to_the_mean_squared_error_of_each_replica(rows):
    loss, td = plain_loss((3,), dtype=torch.double)[0], marked((3,))
    if rows < 12:
        td["valid"] = torch.arange(12).expand(3, 12) < rows
    values = loss.value_network[0].module(td["observation"])
    expected = [by_definition(q[:rows], one[:rows]) for q, one in zip(values, td, strict=True)]
    torch.testing.assert_close(added(loss, td, "loss_value"), torch.stack(expected).detach())


def test_each_head_prefers_the_demonstrated_actions_by_itself():
    loss, td = heads_loss(dtype=torch.double)[0], marked()
    learns = torch.rand(12, 3) < 0.7
    learns[-1] = True
    td["bootstrap_mask"] = learns
    values = loss.value_network[0].module(td["observation"])
    expected = [by_definition(values[own, head], td[own]) for head, own in enumerate(learns.T)]
    torch.testing.assert_close(added(loss, td, "loss"), sum(expected))


def test_every_loss_learns_the_margin_and_only_from_marked_rows(make):
    loss, td = make(dtype=torch.double, data_only=True), marked()
    before = result(loss, td)
    loss.imitate(2.0, 7.0)
    unmarked = td.clone().set("protected", torch.zeros(12, dtype=torch.bool))
    for other in (unmarked, td.exclude("protected")):
        assert torch.equal(result(loss, other)["loss"], before["loss"])
    assert result(loss, td)["loss"] > before["loss"]
    loss.set_keys(demonstrated="mine")
    assert torch.equal(result(loss, td)["loss"], before["loss"])
