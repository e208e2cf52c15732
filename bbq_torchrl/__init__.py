"""BBQ-Networks (AAAI 2018) as native TorchRL parts.

The sub-packages bear TorchRL's names: ``envs``, ``modules``, ``objectives``, ``data``,
``trainers``. ``domains`` and ``simulator`` hold what a dialogue is about and how the user in it
behaves; ``evaluation`` measures trained agents.
"""

from __future__ import annotations

__all__ = ["__version__"]

__version__ = "0.1.0"
