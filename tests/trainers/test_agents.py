"""Updates of all agents: they never wait for a device, and targets last for a freeze."""

import pytest
import torch
from tiny import TINY, composed, nightly

from bbq_torchrl.options import Task
from bbq_torchrl.runs.train import build_trainer
from bbq_torchrl.trainers import losses_of
from benchmarks.parts.host_waits import NeverWaits, drawn_as_on_a_device

SHRUNKEN = (
    *TINY,
    "protocol.batch_size=6",
    "protocol.epochs=1",
    "protocol.eval_every=0",
    "spike.policy=random",
    "env.max_turn=16",
    "replicas=3",
)
# Every loss, and both weights of VIME's dynamics; how an agent explores is no part of an update.
AGENTS = {
    **{
        name: (f"+experiment=agents/{name}",)
        for name in (
            *("bbqn_map", "bbqn_mc", "bbqn_vime_mc", "noisy_dqn", "double_dqn"),
            *("dqn", "dqn_bootstrap", "dqn_vime_map"),
        )
    },
    "shared target noise": ("agent=bbqn", "agent.target=mc", "agent.target_noise=shared"),
    "sampled KL": ("agent=bbqn", "agent.kl=sampled"),
    "dynamics now and then": ("agent=bbqn", "intrinsic=vime", "intrinsic.dynamics_every=3"),
}


DAILY = ("bbqn_mc", "dqn_bootstrap", "noisy_dqn")


@pytest.mark.filterwarnings("ignore:No target network updater")  # on a device without numbers
@pytest.mark.parametrize("agent", nightly(AGENTS, DAILY))
def test_a_rounds_updates_never_wait_and_find_all_on_their_device(agent, tmp_path):
    config = composed(*AGENTS[agent], *SHRUNKEN)
    trainer, _ = build_trainer(config, tmp_path)
    with drawn_as_on_a_device():
        trainer.begin()
        trainer.train_round()
        with NeverWaits():
            trainer.learner.update_all(1)

    trainer.learner.compute_targets()
    batch = trainer.replay.epoch(8)[0].transitions.to("meta")
    # Tensors on the device "meta" have no numbers: whatever asks for one, or mixes them with
    # tensors of the CPU, fails.
    env, device = trainer.env, torch.device("meta")
    task = Task(env.layout.size, env.action_spec_unbatched, replicas=3, rounds=2, device=device)
    q_loss = config.agent.make_loss(config.agent.make_actor(task), task)
    loss, _ = config.intrinsic.make(q_loss, task)
    for part in losses_of(loss):
        if hasattr(part, "set_num_data"):
            part.set_num_data(10)
    with NeverWaits():
        sum(part(batch)["loss"] for part in losses_of(loss)).backward()
    gradients = [p.grad for p in loss.parameters() if p.requires_grad]
    assert {gradient.device for gradient in gradients} == {device}
