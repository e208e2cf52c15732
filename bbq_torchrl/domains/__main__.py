"""``python -m bbq_torchrl.domains calibrate | import``; see :mod:`bbq_torchrl.cli.calibrate`."""

from __future__ import annotations

if __name__ == "__main__":  # before anything that takes time to import
    from bbq_torchrl.utils import interruption

    interruption.listen()

import sys

# The one import from a layer above: people look for the command here.
from bbq_torchrl.cli.calibrate import main

if __name__ == "__main__":
    sys.exit(main())
