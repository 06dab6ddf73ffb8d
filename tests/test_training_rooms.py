"""Where a run's rooms come from: generated, from a library, stored, mirrored."""

from __future__ import annotations

import dataclasses
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from box_rooms import box_room
from furniture_library import write_library

from fewview import cli
from fewview.completion.panorama.ring import ring_points
from fewview.errors import FewviewError
from fewview.synthetic import room_sample, split_seed
from fewview.synthetic.samples import NO_PLANE
from fewview.training import rooms
from fewview.training.card import make_card
from fewview.training.panorama import PanoramaProblem
from fewview.training.rooms import Stored, generator_fingerprint, mirrored, source_of
from fewview.training.settings import TrainConfig

CONFIG = TrainConfig("panorama", PanoramaProblem())


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Of a furniture library."""
    made = tmp_path / "furniture"
    made.mkdir()
    write_library(made, copies=2)
    return made


def test_rooms_are_furnished_from_the_library_that_is_named(folder: Path) -> None:
    with_models = source_of(dataclasses.replace(CONFIG, library=str(folder)))("train", 3, 1, 8)
    without = source_of(CONFIG)("train", 3, 1, 8)
    bare = room_sample(split_seed("train", 3), 1, 8)
    assert without.depth.tobytes() == bare.depth.tobytes() != with_models.depth.tobytes()


def test_stored_rooms_are_those_of_their_generator(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = dataclasses.replace(CONFIG, store=str(tmp_path / "store"))
    furnished = dataclasses.replace(plain, library=str(folder))
    folders = set()
    for config in (plain, furnished, plain):
        source = source_of(config)
        assert isinstance(source, Stored)
        folders.add(source.folder)
    assert len(folders) == 2 and all(f.parent == tmp_path / "store" for f in folders)
    package = tmp_path / "synthetic"
    shutil.copytree(Path(str(rooms.synthetic.__file__)).parent, package)
    monkeypatch.setattr(rooms.synthetic, "__file__", str(package / "__init__.py"))
    before = generator_fingerprint()
    with (package / "plan.py").open("a") as file:
        file.write("# another generator\n")
    assert generator_fingerprint() != before
    assert before in {f.name for f in folders}


def test_a_library_without_models_stops_a_run_with_one_clear_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(FewviewError, match="sweethome3d-furniture"):
        source_of(dataclasses.replace(CONFIG, library=str(tmp_path)))
    settings = tmp_path / "train.yaml"
    settings.write_text(f"problem: panorama\nlibrary: {tmp_path / 'missing'}\n")
    assert cli.main(["train", str(settings), "--out", str(tmp_path / "run")]) == cli.BAD_INPUT
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "sweethome3d-furniture" in line and str(tmp_path / "missing") in line


def test_the_card_names_the_models_authors_and_licences(folder: Path) -> None:
    def card(config: TrainConfig) -> dict[str, object]:
        return dict(make_card(config, 1, 1.0, {}, torch.device("cpu"), 1)["data"])

    data = card(dataclasses.replace(CONFIG, library=str(folder)))["library"]
    assert isinstance(data, dict)
    assert data["attribution"] == ["Test models: 10 models by José. CC-BY 3.0 © Test"]
    assert len(data["fingerprint"]) == 16
    assert "library" not in card(CONFIG)


def test_mirrored_pixels_lie_on_the_planes_that_they_name() -> None:
    room = mirrored(box_room(3, 2, 32))
    on = room.plane_id != NO_PLANE
    assert 0.9 < on.mean() < 1.0
    for view in range(2):
        planes = room.planes[view][room.plane_id[view][on[view]]]
        points = ring_points(room.depth[view])[on[view]]
        np.testing.assert_allclose((points * planes[:, :3]).sum(axis=-1), planes[:, 3], atol=1e-5)
