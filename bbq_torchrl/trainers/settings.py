"""What a training does, in numbers."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["RoundSettings", "SpikeSettings"]


@dataclass(frozen=True)
class RoundSettings:
    """The protocol of a training (the paper, "Experiments": 50 dialogues a round, 2 x 2 epochs).

    Attributes:
        rounds: how many rounds are trained.
        dialogues: how many dialogues each replica plays in a round. More than the environment
            has places are played in turns; a policy that keeps something for a dialogue then needs
            TorchRL's ``InitTracker`` in the environment, to know where the next one begins.
        batch_size: transitions of a mini-batch, for each replica.
        freezes: how often in a round the target is frozen and learned against.
        epochs: how many epochs over the buffer follow each freeze.
        checkpoint_every: rounds between two checkpoints.
        keep_checkpoints: how many of the newest are kept; ``None``: all.
        seed: what every random number of the training derives from.
        max_steps: the most agent turns of a dialogue; one that is longer is an error.
    """

    rounds: int
    dialogues: int = 50
    batch_size: int = 32
    freezes: int = 2
    epochs: int = 2
    checkpoint_every: int = 10
    keep_checkpoints: int | None = 2
    seed: int = 0
    max_steps: int = 1000

    def __post_init__(self) -> None:
        lower = {
            "rounds": 0,
            "dialogues": 1,
            "batch_size": 1,
            "freezes": 1,
            "epochs": 1,
            "checkpoint_every": 1,
            "max_steps": 1,
        }
        for name, least in lower.items():
            value = getattr(self, name)
            if value < least:
                raise ValueError(f"{name} must be at least {least}, got {value}")


@dataclass(frozen=True)
class SpikeSettings:
    """How the buffer is filled before the first round (replay buffer spiking).

    Attributes:
        dialogues: how many dialogues of the spike policy each replica's buffer starts with.
        protect: whether their transitions are never evicted. Default: ``True``.
        drop_above: a success rate. Once the mean over the last ``drop_window`` rounds of a replica
            is above it, its protected transitions are dropped for good. ``None``: never. (The paper
            leaves this heuristic to future work and gives no number.)
        drop_window: the number of rounds that the mean is taken over. One round of 50 dialogues
            has a standard error of up to .07: five rounds have .03.
    """

    dialogues: int = 100
    protect: bool = True
    drop_above: float | None = None
    drop_window: int = 5

    def __post_init__(self) -> None:
        if self.dialogues < 0:
            raise ValueError(f"spike dialogues must not be negative, got {self.dialogues}")
        if self.drop_window < 1:
            raise ValueError(f"drop_window must be at least 1, got {self.drop_window}")
        if self.drop_above is not None:
            if not 0.0 <= self.drop_above < 1.0:
                raise ValueError(f"drop_above must be in [0, 1) or None, got {self.drop_above}")
            if not self.protect:
                raise ValueError(
                    "drop_above needs protect=True: unprotected spiked transitions leave by "
                    f"themselves, got protect={self.protect} and drop_above={self.drop_above}"
                )
