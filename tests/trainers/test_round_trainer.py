"""The round trainer on an environment of a few lines, and with losses of several kinds."""

import csv
from unittest.mock import MagicMock

import pytest
import torch
from q_transitions import bayes_loss, dynamics_loss, plain_loss, transitions
from tensordict import TensorDict
from torch.optim import Adam
from torchrl.envs import ExcludeTransform, TransformedEnv
from torchrl.modules import EGreedyModule
from trainer_parts import GuessEnv, make_trainer

from bbq_torchrl.data import Batch
from bbq_torchrl.trainers import Learner, ReplicaAdam, TrainingError
from bbq_torchrl.utils.seeds import derive_seed
from bbq_torchrl.vime import vime_losses


def test_it_learns(tmp_path):
    trainer = make_trainer(tmp_path, places=50, rounds=12, capacity=400, checkpoint_every=12)

    rates = [row["success_rate"] for row in trainer.train()]

    # Guessing at random succeeds in half of the dialogues; who has learned to wait for the hint,
    # in 127 of 128 (7 turns). The last five rounds are 750 dialogues: standard error .011 at .9.
    assert sum(rates[:6]) / 6 < 0.7
    assert sum(rates[-15:]) / 15 > 0.9


def test_metrics_are_what_was_played_and_learned(tmp_path):
    trainer = make_trainer(tmp_path, rounds=3, replicas=2, spike=None)
    trainer.env = GuessEnv(2, places=3)  # a round's eight dialogues are played in three batches
    trainer.learner.loss.set_num_data = set_num_data = MagicMock()

    rows = trainer.train()

    with (tmp_path / "metrics.csv").open(newline="") as file:
        table = [{k: float(v) for k, v in line.items()} for line in csv.DictReader(file)]
    assert table == rows
    assert list(rows[0]) == [
        *("round", "replica", "dialogues", "success_rate", "reward", "turns"),
        *("td_error", "q_value", "loss", "buffer", "updates", "epsilon"),
        *("seconds", "seconds_collect", "seconds_learn"),
    ]
    assert [(row["round"], row["replica"]) for row in rows] == [
        (r, i) for r in range(3) for i in (0, 1)
    ]
    for replica in range(2):
        own = rows[replica::2]
        turns = [round(row["turns"] * row["dialogues"]) for row in own]
        assert [row["buffer"] for row in own] == [sum(turns[: i + 1]) for i in range(3)]
        assert [row["updates"] for row in own] == [4 * -(-int(row["buffer"]) // 16) for row in own]
        assert set_num_data.call_args_list[0].args[0][replica] == own[0]["buffer"]
        assert int(trainer.replay.buffers[replica][:]["next", "done"].sum()) == 3 * 8
    assert all(0.0 <= row["success_rate"] <= 1.0 for row in rows)


def test_rounds_follow_the_protocol_and_move_schedules_and_environment(tmp_path, monkeypatch):
    trainer = make_trainer(tmp_path, rounds=2, replicas=1)
    learner, events = trainer.learner, MagicMock()
    for name in ("resample", "see_success"):
        monkeypatch.setattr(EGreedyModule, name, getattr(events, name), raising=False)
    for owner, name in ((learner.target_updater, "step"), (learner.loss, "forward")):
        getattr(events, name).side_effect = getattr(owner, name)
        monkeypatch.setattr(owner, name, getattr(events, name))

    rows = trainer.train()

    expected = []
    for row in rows:
        learning = ["step", *["forward"] * (int(row["updates"]) // 2)]
        expected += ["resample", "see_success", *2 * learning]
    assert [name for name, *_ in events.mock_calls] == expected
    seen = [float(call.args[0]) for call in events.see_success.mock_calls]
    assert seen == [row["success_rate"] for row in rows]
    assert [row["epsilon"] for row in rows] == pytest.approx([0.8, 0.6])
    assert trainer.env.rounds_seen == [0, 0, 1]  # the spike plays in the state of round 0


def test_every_phase_and_epoch_of_every_replica_has_a_separate_seed(tmp_path, monkeypatch):
    trainer = make_trainer(tmp_path, rounds=2, replicas=3)
    of_torch, of_env, of_replay = [], [], []
    monkeypatch.setattr(torch, "manual_seed", of_torch.append)
    monkeypatch.setattr(trainer.env, "set_seed", of_env.append)
    monkeypatch.setattr(trainer.replay, "seed", of_replay.extend)
    trainer.train()
    phases = 1 + 2 * (1 + 2 * 2)  # the spike; in a round: collect, two epochs after each freeze
    assert [len(set(seeds)) for seeds in (of_torch, of_env, of_replay)] == [phases, 3, 3 * phases]


def test_seeds_differ_by_run_and_path_and_stay_the_same_in_every_version():
    paths = [(0, 1), (0, "1"), (0, 1, 1), (0, 11), (1, 1), (0, "1", 1), (0, "a", 1), (0, "b", 1)]
    assert len({derive_seed(*path) for path in paths}) == len(paths)
    assert derive_seed(7, "collect", 3) == 3145391869347424827


def test_a_round_learns_at_its_share_of_the_rate_also_where_it_is_resumed(tmp_path, monkeypatch):
    scale_lr, shares = MagicMock(), [1.0, 0.5, 0.1]
    monkeypatch.setattr(ReplicaAdam, "scale_lr", scale_lr)
    for rounds in (2, 3):
        trainer = make_trainer(tmp_path, rounds=rounds, lr_share=shares.__getitem__)
        trainer.train(resume=True)
    assert [call.args[0] for call in scale_lr.mock_calls] == shares


def test_what_the_parts_must_not_do_ends_the_first_round(tmp_path):
    doubled, lacking = (make_trainer(tmp_path / n, rounds=1, spike=None) for n in ("a", "b"))
    doubled.round_metrics = {"td_error": lambda: 3.0}
    lacking.env = TransformedEnv(lacking.env, ExcludeTransform("success"))
    for trainer, name in ((doubled, "td_error"), (lacking, "success")):
        with pytest.raises((TrainingError, TypeError), match=f"'?{name}'?"):
            trainer.train()
        assert not trainer.metrics.path.exists()


def test_a_folder_that_contains_a_run_is_not_overwritten(tmp_path):
    make_trainer(tmp_path, rounds=1).train()
    before = (tmp_path / "metrics.csv").read_text()

    with pytest.raises(ValueError, match="contains a run already"):
        make_trainer(tmp_path, rounds=1).train()

    assert (tmp_path / "metrics.csv").read_text() == before


@pytest.mark.parametrize("changed", [{"env": GuessEnv(2, 8)}, {"optimizer": Adam([torch.ones(1)])}])
def test_parts_that_do_not_fit_are_refused(tmp_path, changed):
    with pytest.raises(ValueError, match=r"batch size|optimizer"):
        make_trainer(tmp_path, **changed)


def gradients(*losses):
    return [p.grad for loss in losses for p in loss.parameters() if p.requires_grad]


@pytest.mark.parametrize("q", [lambda r: plain_loss(r, dropout=0.5), bayes_loss])
def test_an_update_has_the_gradients_and_the_metrics_of_each_loss(q):
    q_loss, dynamics = q((2,))[0], dynamics_loss((2,))
    learned = Batch(transitions((2,)), (True, True))
    torch.manual_seed(0)
    for loss in (q_loss, dynamics):
        loss(learned.transitions)["loss"].backward()
    expected = [gradient.clone() for gradient in gradients(q_loss, dynamics)]
    names = {*q_loss.out_keys, *dynamics.out_keys} - {"loss"}

    for gradient in gradients(q_loss, dynamics):
        gradient.zero_()
    torch.manual_seed(0)
    losses = vime_losses(q_loss, dynamics)
    learner = Learner(losses, None, MagicMock(replicas=2), None, batch_size=2, freezes=1, epochs=1)
    learner.update(learned)

    torch.testing.assert_close(gradients(q_loss, dynamics), expected)
    assert learner.sums.means().keys() == names


@pytest.mark.parametrize("only_fits", [True, False])
def test_a_round_ends_with_a_fit_to_all_transitions(only_fits, tmp_path):
    trainer = make_trainer(tmp_path, replicas=2, rounds=1)
    fitted = {"loss_value": torch.tensor([7.0, 8.0]), "fitted": torch.tensor([1.0, 2.0])}
    loss = trainer.learner.loss
    loss.only_fits, loss.fit = only_fits, MagicMock(return_value=TensorDict(fitted))
    rows = trainer.train()

    (stored,) = loss.fit.call_args.args
    assert stored["valid"].sum(-1).tolist() == list(trainer.replay.lengths)
    for replica, buffer in enumerate(trainer.replay.buffers):
        seen = stored["observation"][replica][stored["valid"][replica]]
        kept = buffer.storage.get(slice(0, len(buffer)))["observation"]
        assert torch.equal(seen.unique(dim=0), kept.unique(dim=0))
        assert not torch.equal(seen, kept)  # they are shuffled
    assert [row["loss"] for row in rows] == [7.0, 8.0]
    assert [row["fitted"] for row in rows] == [1.0, 2.0]
    assert ("td_error" in rows[0]) is not only_fits
    assert (rows[0]["updates"] > 0) is not only_fits
