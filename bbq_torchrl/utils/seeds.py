"""Seeds of every training phase and process, derived from a single seed."""

from __future__ import annotations

import hashlib
import multiprocessing
import os
from operator import index
from typing import SupportsIndex

import torch

LARGEST_SEED = 2**63 - 1

# The last fork of this process or an ancestor: the forking process's id, and torch's seed.
_at_fork: tuple[int, int] | None = None
_imported_in = os.getpid()


def _note_seed() -> None:
    global _at_fork
    _at_fork = os.getpid(), torch.initial_seed()


os.register_at_fork(before=_note_seed)


def checked_seed(seed: SupportsIndex) -> int:
    """Returns a seed as a Python integer; NumPy's and torch's integers are accepted too.

    Raises:
        ValueError: it is not an integer from 0 to 2**63 - 1.

    Examples:
        >>> import numpy as np
        >>> checked_seed(np.int64(3))
        3
        >>> checked_seed(0.5)
        Traceback (most recent call last):
        ValueError: seed must be an integer from 0 to 2**63 - 1, got 0.5
    """
    try:
        number = index(seed)
    except TypeError:
        number = -1
    if not 0 <= number <= LARGEST_SEED:
        raise ValueError(f"seed must be an integer from 0 to 2**63 - 1, got {seed!r}")
    return number


def derive_seed(seed: SupportsIndex, *path: str | SupportsIndex) -> int:
    """Returns the seed of a phase of a run, in [0, 2**63): a hash of the run's seed and a path.

    A phase with a separate seed does not depend on how many random numbers earlier phases drew. So
    a replica with shorter dialogues or epochs does not shift other draws, and a resumed run needs
    no generator states.

    Args:
        seed: the seed of the run.
        *path: names the phase, for example ``("collect", round)``.

    Examples:
        >>> derive_seed(0, "collect", 1) == derive_seed(0, "collect", 1)
        True
        >>> len({derive_seed(0, "collect", r) for r in range(1000)})
        1000
    """
    # The type is part of the text, so that ("a", 1) and ("a", "1") are different paths.
    parts = (part if isinstance(part, str) else index(part) for part in path)
    text = repr((index(seed), *parts)).encode()
    return int.from_bytes(hashlib.blake2b(text, digest_size=8).digest(), "big") >> 1


def unshared_seed(drawn: int) -> int:
    """Returns a seed drawn from torch's global generator, made unique in a forked process.

    Forked processes have copies of the same generator, which draw the same numbers until they are
    seeded (``torch.manual_seed``).
    """
    is_copy = (
        _at_fork is not None and os.getpid() != _at_fork[0] and torch.initial_seed() == _at_fork[1]
    )
    return seed_of_process(drawn) if is_copy else drawn


def seed_of_process(seed: int) -> int:
    """Returns a seed for this process, derived from one that several processes share."""
    process = multiprocessing.current_process().name
    if multiprocessing.parent_process() is None and os.getpid() != _imported_in:
        process = str(os.getpid())  # os.fork keeps the parent's name
    return derive_seed(seed, process)
