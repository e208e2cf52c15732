"""``logger=wandb``: Weights & Biases."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from bbq_torchrl.options import LoggerOption, register
from bbq_torchrl.options.settings import ANY_TEXT, ConfigError, option, setting
from bbq_torchrl.run_folder import write_text
from bbq_torchrl.text import sentence

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping
    from pathlib import Path

    from torchrl.record.loggers import Logger

_HOST = "https://api.wandb.ai"
"""W&B's own server, whose key W&B takes for the other names of it."""


@register
@dataclass
class WandB(LoggerOption):
    """Weights & Biases."""

    name: str = option("wandb")
    project: str = setting("bbq-torchrl", ANY_TEXT, "project that the run is listed under")
    package: ClassVar[str] = "wandb"

    def make(self, run_folder: Path, *, resume: bool = False) -> list[Logger]:
        """Makes a logger that writes ``wandb/``, with the id by which a resumed run is the same."""
        import wandb
        from torchrl.record.loggers.wandb import WandbLogger

        folder = run_folder.resolve()
        run_id = folder / "wandb" / "run_id.txt"
        run_id.parent.mkdir(parents=True, exist_ok=True)
        same = (
            {"id": run_id.read_text().strip(), "resume": "must"}
            if resume and run_id.is_file()
            else {}
        )
        try:
            logger = WandbLogger(
                folder.name,
                log_dir=str(folder),
                project=self.project,
                log_env_packages=False,  # its key would be "env", and our environment has those
                **same,
            )
        except wandb.Error as error:
            raise ConfigError(f"logger=wandb cannot begin a run: {sentence(error)}") from error
        write_text(run_id, str(logger.experiment.id))
        return [logger]

    def log_result(
        self, loggers: Iterable[Logger], result: Mapping[str, float], *, rounds: int
    ) -> None:
        """Puts the final result into the summary: the history has a row each round."""
        for logger in loggers:
            logger.experiment.summary.update(dict(result))

    def close(self, loggers: Iterable[Logger], *, finished: bool) -> None:
        """Ends W&B's run, as failed unless it came to its result."""
        for logger in loggers:
            logger.experiment.finish(exit_code=int(not finished))

    def check_ready(self) -> None:
        """Refuses W&B without its package, and without a key unless it is offline."""
        super().check_ready()
        import wandb
        from requests.utils import get_netrc_auth  # comes with wandb

        if wandb.run is not None:
            return  # W&B has begun a run already, which teardown would end
        try:
            settings = wandb.setup().settings
        finally:
            wandb.teardown()  # jobs on other machines must not look for the service of this one
        is_offline = settings.mode in ("offline", "dryrun", "disabled")
        given = settings.api_key or os.environ.get("WANDB_IDENTITY_TOKEN_FILE")
        if not (is_offline or given or any(map(get_netrc_auth, (settings.base_url, _HOST)))):
            raise ConfigError(
                "logger=wandb needs an API key of W&B: run `wandb login`, set WANDB_API_KEY, or "
                "log offline by WANDB_MODE=offline"
            )
