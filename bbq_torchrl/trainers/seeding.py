"""Seeds for every phase of a training, from one seed."""

from __future__ import annotations

import hashlib


def derive_seed(seed: int, *path: str | int) -> int:
    """Returns the seed of one phase of a run, in [0, 2**63): a hash of the run's seed and a path.

    A phase that starts from a seed of its own does not depend on how many random numbers the
    phases before it used: a replica whose dialogues or epochs are shorter shifts nobody's draws,
    and a resumed run needs no generator's state.

    Args:
        seed: the seed of the run.
        *path: what the seed is for, for example ``("collect", round)``.

    Examples:
        >>> derive_seed(0, "collect", 1) == derive_seed(0, "collect", 1)
        True
        >>> len({derive_seed(0, "collect", r) for r in range(1000)})
        1000
    """
    # The type is part of the text, so that ("a", 1) and ("a", "1") are different paths.
    text = repr((int(seed), *path)).encode()
    return int.from_bytes(hashlib.blake2b(text, digest_size=8).digest(), "big") >> 1
