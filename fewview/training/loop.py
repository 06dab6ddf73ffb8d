"""The training loop: AdamW, warm-up and cosine, checkpoints, validation, the best weights kept."""

from __future__ import annotations

import dataclasses
import math
import time
from collections import defaultdict
from collections.abc import Callable, Iterable
from pathlib import Path

import torch
import yaml
from torch import Tensor, nn

from fewview import weights
from fewview.errors import FewviewError
from fewview.training import checkpoint
from fewview.training.card import make_card
from fewview.training.problem import Batch
from fewview.training.rooms import RoomBatches, RoomSource, loader, source_of
from fewview.training.settings import TrainConfig

CHECKPOINT, CURVES, SETTINGS = "checkpoint.pt", "curves.json", "config.yaml"
LOWEST_RATE = 0.01
VALIDATION_BATCH = 8


def train(
    config: TrainConfig,
    out: Path,
    *,
    resume: bool = False,
    device: str = "auto",
    jobs: int = 1,
    source: RoomSource | None = None,
    report: Callable[[str], None] = lambda line: None,
) -> Path:
    """Train a network.

    Args:
        config: what is learnt, and how.
        out: folder for checkpoint, curves, settings and the best weights with their card.
        resume: go on from the checkpoint there.
        device: ``auto``, ``cpu`` or ``cuda``.
        jobs: processes that make rooms beside this one; 0 for none.
        source: where rooms come from, the generator when not given.
        report: takes lines of progress.

    Returns:
        the file of the best weights.

    Raises:
        FewviewError: nothing to resume, or a run there already that is not to be resumed.
    """
    out.mkdir(parents=True, exist_ok=True)
    if not resume and (out / CHECKPOINT).exists():
        raise FewviewError(f"{out}: holds a training run; add --resume, or choose another --out")
    run = _Run(config, out, chosen_device(device), source or source_of(config), report)
    if resume:
        run.restore()
    try:
        run.go(jobs)
    finally:
        run.save()
    return out / f"{config.settings.name}.safetensors"


def chosen_device(name: str) -> torch.device:
    """The device of a name; ``auto`` is the GPU where there is one.

    Raises:
        FewviewError: a GPU is asked for and there is none.
    """
    if name == "cuda" and not torch.cuda.is_available():
        raise FewviewError("--device cuda: PyTorch finds no GPU; use --device cpu")
    found = "cuda" if torch.cuda.is_available() else "cpu"
    return torch.device(found if name == "auto" else name)


def learning_rate(step: int, config: TrainConfig) -> float:
    """Linear rise, then half a cosine down to a hundredth."""
    if step < config.warmup_steps:
        return config.learning_rate * (step + 1) / config.warmup_steps
    share = (step - config.warmup_steps) / max(1, config.steps - config.warmup_steps)
    fall = 0.5 * (1.0 + math.cos(math.pi * min(share, 1.0)))
    return config.learning_rate * (LOWEST_RATE + (1.0 - LOWEST_RATE) * fall)


class _Run:
    """A run in progress."""

    def __init__(
        self,
        config: TrainConfig,
        out: Path,
        device: torch.device,
        source: RoomSource,
        report: Callable[[str], None],
    ) -> None:
        torch.manual_seed(config.seed)
        self.problem, self.config, self.out, self.device = config.settings, config, out, device
        self.source, self.report = source, report
        self.network = self.problem.network()
        self.before = None
        if config.init:
            state, self.before = weights.load(self.problem.name, Path(config.init))
            self.network.load_state_dict(state)
        self.network.to(device)
        self.optimiser = torch.optim.AdamW(
            self.network.parameters(), config.learning_rate, weight_decay=config.weight_decay
        )
        self.state = checkpoint.State()
        self.settings = dataclasses.asdict(config)
        self.running: dict[str, Tensor] = {}
        self.summed = 0
        self.clock = self.saved = time.monotonic()
        (out / SETTINGS).write_text(yaml.safe_dump(_plain(self.settings), sort_keys=False))

    def restore(self) -> None:
        path = self.out / CHECKPOINT
        self.state = checkpoint.restore(path, self.network, self.optimiser, self.settings)
        self.report(f"resumed at step {self.state.step}")

    def save(self) -> None:
        self._count_time()
        path = self.out / CHECKPOINT
        checkpoint.save(path, self.state, self.network, self.optimiser, self.settings)
        checkpoint.write_curves(self.out / CURVES, self.state)
        self.saved = time.monotonic()

    def go(self, jobs: int) -> None:
        config = self.config
        validation = self._validation_batches(jobs) if self.state.step < config.steps else []
        batches = RoomBatches(config, self.source)
        self.clock = began = time.monotonic()
        first = self.state.step
        for batch in loader(batches, range(first, config.steps), jobs):
            self._learn(_moved(batch, self.device))
            self.state.step += 1
            if self.state.step % config.log_every == 0:
                self._log((time.monotonic() - began) / (self.state.step - first))
            if self.state.step % config.validate_every == 0 or self.state.step == config.steps:
                self._validate(validation)
            if time.monotonic() - self.saved > 60.0 * config.checkpoint_minutes:
                self.save()

    def _validation_batches(self, jobs: int) -> list[Batch]:
        rooms = min(self.config.validation_rooms, VALIDATION_BATCH)
        count = math.ceil(self.config.validation_rooms / rooms)
        batches = RoomBatches(self.config, self.source, "validation", rooms)
        return list(loader(batches, range(count), jobs))

    def _learn(self, batch: Batch) -> None:
        self.network.train()
        for group in self.optimiser.param_groups:
            group["lr"] = learning_rate(self.state.step, self.config)
        parts = self._losses(batch)
        self.optimiser.zero_grad(set_to_none=True)
        torch.stack(list(parts.values())).sum().backward()  # type: ignore[no-untyped-call]
        norm = nn.utils.clip_grad_norm_(self.network.parameters(), self.config.clip_norm)
        if torch.isfinite(norm):
            self.optimiser.step()
        self.summed += 1
        for name, value in parts.items():
            self.running[name] = self.running.get(name, torch.zeros_like(value)) + value.detach()

    def _losses(self, batch: Batch) -> dict[str, Tensor]:
        with torch.autocast(self.device.type, torch.bfloat16, enabled=self.config.bfloat16):
            return self.problem.losses(self.network, batch)

    def _log(self, seconds_per_step: float) -> None:
        parts = {k: float(v) / self.summed for k, v in self.running.items()}
        self.running, self.summed = {}, 0
        total, step = sum(parts.values()), self.state.step
        rate = learning_rate(step, self.config)
        self.state.curves["training"].append(
            {"step": step, "loss": total, **parts, "learning_rate": rate}
        )
        shown = ", ".join(f"{k} {v:.3f}" for k, v in parts.items())
        samples = self.config.rooms * self.config.views / seconds_per_step
        left = seconds_per_step * (self.config.steps - step) / 60.0
        self.report(
            f"step {step}/{self.config.steps} loss {total:.3f} ({shown}), "
            f"{samples:.1f} samples/s, {left:.0f} min left"
        )

    def _validate(self, batches: Iterable[Batch]) -> None:
        self.network.eval()
        figures: dict[str, list[float]] = defaultdict(list)
        with torch.inference_mode():
            for batch in batches:
                moved = _moved(batch, self.device)
                parts = self._losses(moved)
                figures["loss"].append(float(torch.stack(list(parts.values())).sum()))
                for name, value in self.problem.metrics(self.network, moved).items():
                    figures[name].append(value)
        means = {name: _mean(values) for name, values in figures.items()}
        self.state.curves["validation"].append({"step": self.state.step, **means})
        self.report("validation: " + ", ".join(f"{k} {v:.3f}" for k, v in means.items()))
        self._count_time()
        if means["loss"] < self.state.best:
            self.state.best = means["loss"]
            self._keep(means)
        checkpoint.write_curves(self.out / CURVES, self.state)

    def _keep(self, figures: dict[str, float]) -> None:
        state, threads = self.state, torch.get_num_threads()
        card = make_card(
            self.config, state.step, state.seconds, figures, self.device, threads, self.before
        )
        weights.save(self.problem.name, self.out, self.network.state_dict(), card)

    def _count_time(self) -> None:
        now = time.monotonic()
        self.state.seconds += now - self.clock
        self.clock = now


def _moved(batch: Batch, device: torch.device) -> Batch:
    return {name: tensor.to(device, non_blocking=True) for name, tensor in batch.items()}


def _mean(values: list[float]) -> float:
    """Mean of those that are numbers."""
    known = [v for v in values if math.isfinite(v)]
    return sum(known) / len(known) if known else math.nan


def _plain(value: object) -> object:
    """Tuples as lists, which YAML knows."""
    if isinstance(value, dict):
        return {k: _plain(v) for k, v in value.items()}
    return [_plain(v) for v in value] if isinstance(value, list | tuple) else value
