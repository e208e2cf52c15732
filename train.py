"""Trains an agent and evaluates it: configuration in, result out. See ``--help``."""

from __future__ import annotations

if __name__ == "__main__":  # before anything that takes time to import
    from bbq_torchrl.utils import interruption

    interruption.listen()

from bbq_torchrl.runs.train import main

if __name__ == "__main__":
    main()
