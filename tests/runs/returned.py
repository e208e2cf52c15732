"""A Hydra callback that keeps what ``train.py`` returns, as a sweeper gets it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.experimental.callback import Callback

if TYPE_CHECKING:
    from hydra.core.utils import JobReturn


class KeepReturned(Callback):
    def on_job_end(self, config: Any, job_return: JobReturn, **_: Any) -> None:
        folder = Path(config.hydra.runtime.output_dir)
        (folder / "returned.txt").write_text(repr(job_return.return_value))
