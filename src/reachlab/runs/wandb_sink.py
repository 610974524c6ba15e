"""The sink that logs to Weights & Biases."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from shlex import quote
from threading import Thread
from typing import Any

from reachlab.runs.files import read_json
from reachlab.runs.metrics import read_metrics
from reachlab.settings.validation import InputError, needing

PROJECT = "reachlab"
"""W&B project, where the user names none."""

INIT_TIMEOUT = 30.0
"""Longest wait for the server to take a new run [s]."""

FINISH_TIMEOUT = 60.0
"""Longest wait at the end for rows to be uploaded [s]; what is left then stays on the disk, for `wandb sync`."""

END_TIMEOUT = 2.0
"""Longest wait for W&B's own process to end where it cannot be used [s]: after a request without an answer, that of W&B
0.31 may miss that it shall end, and then Python waits for it for ever."""

LOCAL = ("offline", "dryrun", "disabled")
"""Modes of W&B in which nothing leaves this machine."""

WITHOUT = "set WANDB_MODE=offline, or leave --wandb out"
"""How to train where W&B cannot be used."""


class WeightsAndBiases:
    """Logs a run by the directory's name; with W&B's files in the directory, and the same W&B run after a resume."""

    def __init__(self) -> None:
        """Sink that is not yet open.

        Raises:
            InputError: wandb is not installed; or online, there is no key that its server takes.
        """
        with needing("--wandb needs wandb: {}.", "wandb", ImportError):
            import wandb
        self._wandb = wandb
        try:
            self._settings = wandb.setup().settings
            online = wandb.run and not wandb.run.offline
            ready = self._settings.mode in LOCAL or online or wandb.login(prompt=False, verify=True)
        except (wandb.Error, OSError, ValueError) as error:  # a ValueError where a variable of W&B's is not valid
            raise self._refusal(error, WITHOUT) from None
        if not ready:
            raise InputError(f"--wandb needs an API key: run `wandb login`, {WITHOUT}.")

    def open(self, folder: Path) -> None:
        """Begin a W&B run, or continue the one that is not finished; rows that it lacks are logged again.

        Raises:
            InputError: the server does not take it.
        """
        try:
            self._run = self._wandb.init(
                project=self._settings.project or PROJECT,
                dir=folder,
                name=folder.resolve().name,
                config=read_json(folder / "config.json"),
                resume="auto",
                reinit="create_new",
                settings={
                    "console": "off",
                    "quiet": True,
                    "init_timeout": INIT_TIMEOUT,
                    "finish_timeout": FINISH_TIMEOUT,
                    "max_end_of_run_history_metrics": 0,
                    "max_end_of_run_summary_metrics": 0,
                },
            )
            for row in read_metrics(folder / "metrics.jsonl"):
                self.write(row)
        except (self._wandb.Error, OSError) as error:
            raise self._refusal(error, f"{WITHOUT}, and train on with --resume {quote(str(folder))}") from None

    def write(self, row: Mapping[str, Any]) -> None:
        """Log a row at its `steps`, unless the server has it from before a resume."""
        if row["steps"] >= self._run.starting_step:
            self._run.log(dict(row), step=row["steps"], commit=True)

    def close(self, result: Mapping[str, Any] | None) -> None:
        """Finish the W&B run; the result is in its summary, as `report`."""
        if result is not None:
            self._run.summary.update({"report": dict(result)})
        self._run.finish(exit_code=int(result is None))

    def _refusal(self, error: Exception, how: str) -> InputError:
        """Why W&B cannot be used, in one sentence, and how to go on. Its process ends, unless the caller has a run."""
        if self._wandb.run is None:
            ending = Thread(target=self._wandb.teardown, daemon=True)
            ending.start()
            ending.join(END_TIMEOUT)
        why = " ".join(str(error).split()).rstrip(".")
        return InputError(f"Weights & Biases cannot be used ({why}): {how}.")
