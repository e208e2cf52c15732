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
        lr_final: the share of the learning rate that is left in the last round; 1: it stays.
        lr_decay_from: the share of the rounds after which it falls, linearly.
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
    lr_final: float = 1.0
    lr_decay_from: float = 0.5
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
        for name, value in (("lr_final", self.lr_final), ("lr_decay_from", self.lr_decay_from)):
            if not 0.0 <= value <= 1.0:
                raise ValueError(f"{name} must be in [0, 1], got {value}")

    def lr_share(self, round_number: int) -> float:
        """Returns the share of the learning rate that a round, counted from 0, learns with.

        Example:
            >>> settings = RoundSettings(rounds=8, lr_final=0.2, lr_decay_from=0.5)
            >>> [round(settings.lr_share(number), 2) for number in range(8)]
            [1.0, 1.0, 1.0, 1.0, 0.8, 0.6, 0.4, 0.2]
        """
        start = self.lr_decay_from * self.rounds
        since = round_number + 1 - start
        return 1.0 if since <= 0 else 1.0 - (1.0 - self.lr_final) * since / (self.rounds - start)


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
