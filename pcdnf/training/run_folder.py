"""The folder of a training: what it needs to go on after a kill, its best model, its log."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor, nn

from ..errors import PcdnfError


class TrainingRun:
    """State of a training that outlives its process.

    Parameters
    ----------
    folder : Path
        Made where it is missing; a state that lies there is taken up.
    network, average : nn.Module
        In training, and its exponential moving average.
    optimizer : torch.optim.Optimizer
        AdamW over the network's parameters.

    Attributes
    ----------
    step : int
    elapsed : float
        Seconds, earlier sessions included.
    best : float
        Lowest validation score so far.

    Raises
    ------
    PcdnfError
        ``other_training``: the state that lies there is of another network.
    """

    def __init__(self, folder: Path, network: nn.Module, average: nn.Module, optimizer: torch.optim.Optimizer) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self._network, self._average, self._optimizer = folder, network, average, optimizer
        self.step, self.elapsed, self.best = 0, 0.0, math.inf
        if self._state_file.exists():
            self._resume()

    @property
    def _state_file(self) -> Path:
        return self.folder / "state.safetensors"

    @property
    def model_file(self) -> Path:
        """Where the best model lies."""
        return self.folder / "model.safetensors"

    @property
    def last_file(self) -> Path:
        """Where the last model lies once the budget is spent."""
        return self.folder / "last.safetensors"

    def _resume(self) -> None:
        with safe_open(self._state_file, framework="pt") as file:
            tensors = {key: file.get_tensor(key) for key in file.keys()}  # noqa: SIM118
            facts = json.loads(file.metadata()["facts"])
        self.step, self.elapsed, self.best = facts["step"], facts["elapsed"], facts["best"]
        try:
            self._network.load_state_dict(_part(tensors, "network."))
            self._average.load_state_dict(_part(tensors, "average."))
        except RuntimeError as error:
            raise PcdnfError(
                f"{self.folder} contains the training of another network.",
                code="other_training",
                hint="Use the --kind that it was started with, or another folder.",
            ) from error
        for name, parameter in self._network.named_parameters():
            self._optimizer.state[parameter] = {
                "step": torch.tensor(float(self.step)),
                "exp_avg": tensors[f"first.{name}"].to(parameter.device),
                "exp_avg_sq": tensors[f"second.{name}"].to(parameter.device),
            }

    def save(self) -> None:
        """Write the state; a kill leaves the one before or this one."""
        tensors = {f"network.{key}": value for key, value in self._network.state_dict().items()}
        tensors |= {f"average.{key}": value for key, value in self._average.state_dict().items()}
        for name, parameter in self._network.named_parameters():
            moments = self._optimizer.state[parameter]
            tensors[f"first.{name}"], tensors[f"second.{name}"] = moments["exp_avg"], moments["exp_avg_sq"]
        facts = {"step": self.step, "elapsed": self.elapsed, "best": self.best}
        temporary = self._state_file.with_suffix(".tmp")
        save_file({k: v.contiguous() for k, v in tensors.items()}, temporary, {"facts": json.dumps(facts)})
        temporary.replace(self._state_file)

    def log(self, **facts: Any) -> None:
        """One line on standard output and in log.jsonl."""
        line = json.dumps({"step": self.step, "minutes": round(self.elapsed / 60, 2), **facts})
        print(line, flush=True)
        with (self.folder / "log.jsonl").open("a") as log:
            log.write(line + "\n")


def _part(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {key[len(prefix) :]: value for key, value in tensors.items() if key.startswith(prefix)}
