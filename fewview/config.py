"""Settings: one frozen dataclass a stage, YAML presets; unknown keys are refused."""

from __future__ import annotations

import dataclasses
import difflib
import hashlib
import json
import typing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from fewview.errors import ConfigError

TRAINING = "train_"
"""Files that begin so are settings of `fewview train`, not presets."""
Settings = typing.TypeVar("Settings")


@dataclass(frozen=True)
class FeatureConfig:
    """Features of what a scan shows."""

    kinds: tuple[str, ...] = ("xfeat", "sift", "planes", "panorama", "layout", "structure")
    """Which kinds of features are extracted and matched; the last three are of the rooms that
    networks complete around the scans, which run only for kinds that are named."""
    max_keypoints: int = 640
    """Learned keypoints kept per scan."""
    max_sift: int = 600
    """SIFT keypoints kept per scan."""
    max_depth_m: float = 6.0
    """Depth beyond this is not used: the noise of structured light grows with its square."""
    surface_voxel_m: float = 0.06
    """Spacing of the thinned surface that refinement and evidence work on."""
    max_patches: int = 12
    """Planar patches kept per scan, largest first."""
    quarter_turns: bool = True
    """Bring images that were taken in different roll into a common one before describing them."""


@dataclass(frozen=True)
class MatchingConfig:
    """From two scans' features to K rigid poses."""

    top_k: int = 5
    """Candidate poses kept per pair."""
    max_correspondences: int = 1500
    """Candidate correspondences that enter the consistency matrix, best similarity first."""
    duplicate_angle_deg: float = 15.0
    """Candidates closer than this and `duplicate_distance_m` count as one answer."""
    duplicate_distance_m: float = 0.3
    """See `duplicate_angle_deg`."""
    alignment: bool = True
    """Propose poses that lay the completed rooms of two scans over each other."""
    manhattan: bool = True
    """Propose the other yaws of box-shaped rooms as candidates of their own kind."""


@dataclass(frozen=True)
class RefinementConfig:
    """The robust regression of Sec. 3.3; alphas as in its equations."""

    iterations: int = 3
    """Alternations between nearest neighbours and Gauss-Newton; 0 leaves poses as proposed."""
    gauss_newton_steps: int = 3
    """Gauss-Newton steps per alternation."""
    neighbour_m: tuple[float, ...] = (0.20, 0.12, 0.08)
    """Largest distance of a nearest-neighbour pair, per alternation."""
    alpha_0_m: float = 0.03
    """Scale of the nearest-neighbour term."""
    alpha_1_m: float = 0.02
    """Scale of the co-planar term."""
    alpha_2: float = 0.03
    """Scale of the parallel term (sine of an angle)."""
    alpha_3: float = 0.03
    """Scale of the perpendicular term (sine of an angle)."""
    alpha_r: float = 0.02
    """Weight of the relations against the nearest neighbours."""
    match_weight: float = 1.0
    """Weight of a matched feature against a nearest neighbour."""
    alpha_match_m: float = 0.05
    """Scale of the matched features' term."""
    settle_m: float = 0.3
    """How far a pose from outside is expected to be off where completed rooms correct it."""


@dataclass(frozen=True)
class GlobalConfig:
    """The discrete choice over all pairs and the pose graph."""

    max_angle_deg: float = 10.0
    """A candidate agrees with two scan poses up to this rotation ..."""
    max_distance_m: float = 0.3
    """... and this translation."""
    chance_agreement: float = 0.03
    """Probability that a wrong candidate agrees by chance (tolerance volume over pose volume)."""
    levelled_chance_agreement: float = 0.2
    """The same for candidates not from matched features of what was seen: those of levelled scans
    share their four yaws and the walls they fit."""
    min_probability: float = 0.4
    """Scans whose placement is less probable stay unplaced (docs/method.md, section 6)."""
    restarts: int = 16
    """Seeded spanning trees from which the search starts."""
    registration: bool = True
    """Refine the poses of a component by the surfaces of all its scans at once."""
    plane_factors: bool = False
    """Let large planes hold scans together in the registration that see different parts of them."""
    together: bool = True
    """Decide what the candidates leave open by what all scans of completed rooms say of a place."""
    alternatives: int = 3
    """Other answers that are reported beside the best, at most."""

    def __post_init__(self) -> None:
        if self.alternatives < 0:
            raise ConfigError("global_stage.alternatives must be 0 or more")
        for name in ("chance_agreement", "levelled_chance_agreement", "min_probability"):
            if not 0.0 < getattr(self, name) < 1.0:
                raise ConfigError(f"global_stage.{name} must be above 0 and below 1")


@dataclass(frozen=True)
class FusionConfig:
    """The TSDF mesh."""

    voxel_m: float | None = None
    """Edge of a voxel; derived from the depth data and the memory bound when not given."""
    max_depth_m: float = 4.5
    """Depth beyond this is not fused."""
    max_memory_mb: int = 1000
    """Bound on the volume's memory; the voxel grows until it fits."""


@dataclass(frozen=True)
class Config:
    """All settings of a run."""

    features: FeatureConfig = field(default_factory=FeatureConfig)
    matching: MatchingConfig = field(default_factory=MatchingConfig)
    refinement: RefinementConfig = field(default_factory=RefinementConfig)
    global_stage: GlobalConfig = field(default_factory=GlobalConfig)
    fusion: FusionConfig = field(default_factory=FusionConfig)

    def hash(self) -> str:
        """A short fingerprint of every value."""
        text = json.dumps(dataclasses.asdict(self), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def presets_folder() -> Path:
    """Where the YAML presets are: inside an installed package, beside it in a checkout."""
    package = Path(__file__).parent
    installed = package / "configs"
    return installed if installed.is_dir() else package.parent / "configs"


def load(
    preset: str = "default", file: Path | None = None, assignments: tuple[str, ...] = ()
) -> Config:
    """Combine a preset, a YAML file and ``section.key=value`` assignments, later ones winning.

    Raises:
        ConfigError: unknown preset, unreadable file, unknown key or unusable value.
    """
    known = {p.stem: p for p in presets_folder().glob("*.yaml") if not p.stem.startswith(TRAINING)}
    if preset not in known:
        raise ConfigError(f"unknown preset '{preset}'; choose one of {', '.join(sorted(known))}")
    config = merge(Config(), read(known[preset]), str(known[preset]))
    if file is not None:
        config = merge(config, read(file), str(file))
    return assign(config, assignments)


def assign(config: Settings, assignments: tuple[str, ...]) -> Settings:
    """A copy of ``config`` with ``section.key=value`` assignments put in.

    Raises:
        ConfigError: unknown key or unusable value.
    """
    for text in assignments:
        config = merge(config, _parse_assignment(text), "--set")
    return config


def merge(config: Settings, values: dict[str, Any], where: str) -> Settings:
    """A copy of ``config`` with nested ``values`` put in; ``where`` names them in errors.

    Raises:
        ConfigError: unknown key or unusable value.
    """
    return typing.cast(Settings, _merged(config, values, where, ""))


def _merged(section: Any, values: Any, where: str, prefix: str) -> Any:
    if not isinstance(values, dict):
        raise ConfigError(f"{where}: '{prefix or 'the file'}' must hold named values")
    hints = typing.get_type_hints(type(section))
    changes: dict[str, Any] = {}
    for key, value in values.items():
        name = f"{prefix}{key}"
        if key not in hints:
            near = difflib.get_close_matches(str(key), hints, n=1)
            hint = f"; did you mean '{prefix}{near[0]}'?" if near else ""
            raise ConfigError(f"{where}: unknown setting '{name}'{hint}")
        current = getattr(section, key)
        if dataclasses.is_dataclass(current):
            changes[key] = _merged(current, value, where, f"{name}.")
        else:
            changes[key] = _checked(value, hints[key], name, where)
    return dataclasses.replace(section, **changes)


def _checked(value: Any, hint: Any, name: str, where: str) -> Any:
    options = typing.get_args(hint) if type(None) in typing.get_args(hint) else (hint,)
    for option in options:
        if option is type(None) and value is None:
            return None
        if option is float and isinstance(value, int | float) and not isinstance(value, bool):
            return float(value)
        if option in (int, bool, str) and type(value) is option:
            return value
        if typing.get_origin(option) is tuple and isinstance(value, list | tuple):
            return tuple(_checked(v, typing.get_args(option)[0], name, where) for v in value)
    raise ConfigError(f"{where}: '{name}' cannot be {value!r}; expected {hint}")


def read(path: Path) -> dict[str, Any]:
    """The values of a YAML file.

    Raises:
        ConfigError: it cannot be read.
    """
    try:
        values = yaml.safe_load(path.read_text())
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        reason = str(error).splitlines()[0]
        raise ConfigError(f"{path}: not a readable YAML file ({reason})") from error
    return values or {}


def _parse_assignment(text: str) -> dict[str, Any]:
    key, sign, value = text.partition("=")
    if not sign or not key:
        raise ConfigError(f"--set {text}: write it as section.key=value")
    nested: Any = yaml.safe_load(value)
    for part in reversed(key.split(".")):
        nested = {part: nested}
    return typing.cast(dict[str, Any], nested)
