"""Settings of a training run: those of every run, and the problem's own under `settings`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fewview import config
from fewview.errors import ConfigError
from fewview.training.problem import PROBLEMS, Problem, make


@dataclass(frozen=True)
class TrainConfig:
    """A training run."""

    problem: str
    """Which network; see `fewview.training.problem.PROBLEMS`."""
    settings: Problem
    """The problem itself, a dataclass."""
    init: str = ""
    """Folder of weights of the same network to begin with; empty for random ones."""
    seed: int = 0
    """Of the weights and of everything drawn."""
    steps: int = 4000
    """Batches."""
    rooms: int = 3
    """Rooms in a batch."""
    views: int = 4
    """Cameras in each of them."""
    made_views: int = 0
    """Cameras in a room when it is made, of which a batch draws `views`; 0 for as many."""
    size: int = 64
    """Pixels along a ring's face."""
    first_room: int = 0
    """Number of the first training room."""
    pool: int = 0
    """Training rooms before the first comes again; 0 for always new ones."""
    store: str = ""
    """Folder that keeps the rooms, for the next round and for other networks; empty for none."""
    library: str = ""
    """Folder of furniture catalogues whose models stand in the rooms; empty for none."""
    learning_rate: float = 1e-3
    """Its highest value."""
    warmup_steps: int = 200
    """Steps of its linear rise; afterwards it falls as a cosine."""
    weight_decay: float = 0.01
    """AdamW's."""
    clip_norm: float = 1.0
    """Largest norm of a gradient."""
    validation_rooms: int = 16
    """Rooms of the validation split, always the same."""
    validate_every: int = 500
    """Steps between validations."""
    log_every: int = 20
    """Steps between lines of progress and points of the curves."""
    checkpoint_minutes: float = 5.0
    """Time between checkpoints."""
    bfloat16: bool = False
    """Mixed precision; many times slower on most CPUs."""

    def __post_init__(self) -> None:
        for name in ("steps", "rooms", "views", "validation_rooms", "validate_every", "log_every"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} must be at least 1")
        if 0 < self.made_views < self.views:
            raise ConfigError("made_views must be 0 or at least views")


def load(file: Path, assignments: tuple[str, ...] = ()) -> TrainConfig:
    """Read a YAML file and put ``key=value`` assignments over it.

    Raises:
        ConfigError: the file cannot be read, names no problem, or sets what does not exist.
    """
    values = config.read(file)
    name = values.get("problem") if isinstance(values, dict) else None
    if not isinstance(name, str):
        known = ", ".join(sorted(PROBLEMS))
        raise ConfigError(f"{file}: add 'problem: NAME', one of {known}")
    base = TrainConfig(name, make(name))
    return config.assign(config.merge(base, values, str(file)), assignments)
