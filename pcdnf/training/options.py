"""Options of a training: what ``pcdnf train`` takes."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..errors import PcdnfError
from .loader import CLOUDS_A_BATCH
from .validation import VALIDATION_CLOUDS_A_BATCH


@dataclass(frozen=True, kw_only=True)
class Options:
    """Of one run.

    Attributes
    ----------
    kind : str
        "pcdnf" or "lite".
    folder : Path
    minutes : float
        Wall time of the whole schedule, earlier sessions of a resumed run included.
    device : str
        "auto", "cpu" or "cuda:N".
    threads : int
        Of torch.
    workers : int or None
        Processes that prepare batches, none for the training's own; by default 1 beside a CPU, one a core but one
        beside a GPU.
    batch : int or None
        Patches a step, a multiple of 4; the kind's own by default.
    learning_rate : float or None
        Highest of the schedule; the kind's own by default.
    start : str or None
        Model whose weights the training starts from, of the same kind; else random ones.
    save_every : float
        Seconds between validations and saved states.
    first_pass : str or None
        Model whose first iteration prepares a share of the clouds; "self" is the network in training.
    first_pass_share : float
    seed : int
    validation_patches, validation_clouds : int
        The patches a multiple of 8.
    pool : int
        Clouds held in memory at once, and at least 4 by each process.
    scans : float
        Share of the clouds that are crops of simulated scans; validation takes such scans too where it is above 0.

    Raises
    ------
    PcdnfError
        ``bad_option``: a number of patches that cannot be shared out, or a learning rate that is not above 0.
    """

    kind: str
    folder: Path
    minutes: float
    device: str = "cpu"
    threads: int = 1
    workers: int | None = None
    batch: int | None = None
    learning_rate: float | None = None
    start: str | None = None
    save_every: float = 150.0
    first_pass: str | None = None
    first_pass_share: float = 0.4
    seed: int = 0
    validation_patches: int = 2048
    validation_clouds: int = 12
    pool: int = 64
    scans: float = 0.0

    def __post_init__(self) -> None:
        for name, patches, share in (
            ("--batch", self.batch or CLOUDS_A_BATCH, CLOUDS_A_BATCH),
            ("--validation-patches", self.validation_patches, VALIDATION_CLOUDS_A_BATCH),
        ):
            if patches <= 0 or patches % share:
                hint = f"Give a multiple of {share}: a batch has as many patches of each of {share} clouds."
                raise PcdnfError(f"{name} cannot be {patches}.", code="bad_option", hint=hint)
        if self.learning_rate is not None and not 0 < self.learning_rate < 1:
            hint = "Give a number above 0 and below 1, such as 0.001."
            raise PcdnfError(f"--learning-rate cannot be {self.learning_rate}.", code="bad_option", hint=hint)
        if not 0 <= self.scans <= 1:
            raise PcdnfError(f"--scans cannot be {self.scans}.", code="bad_option", hint="Give a share from 0 to 1.")
