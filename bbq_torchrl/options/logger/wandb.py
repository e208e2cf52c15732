"""``logger=wandb``: Weights & Biases."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options import LoggerOption, register
from bbq_torchrl.options.settings import ANY_TEXT, option, setting
from bbq_torchrl.run_folder import write_text

if TYPE_CHECKING:
    from pathlib import Path

    from torchrl.record.loggers import Logger


@register
@dataclass
class WandB(LoggerOption):
    """Weights & Biases."""

    name: str = option("wandb")
    project: str = setting("bbq-torchrl", ANY_TEXT, "project that the run is listed under")
    package: ClassVar[str] = "wandb"

    def make(self, run_folder: Path, *, resume: bool = False) -> list[Logger]:
        """Makes a logger that writes ``wandb/``, with the id by which a resumed run is the same."""
        from torchrl.record.loggers.wandb import WandbLogger

        folder = run_folder.resolve()
        run_id = folder / "wandb" / "run_id.txt"
        run_id.parent.mkdir(parents=True, exist_ok=True)
        same = (
            {"id": run_id.read_text().strip(), "resume": "must"}
            if resume and run_id.is_file()
            else {}
        )
        logger = WandbLogger(folder.name, log_dir=str(folder), project=self.project, **same)
        write_text(run_id, str(logger.experiment.id))
        return [logger]
