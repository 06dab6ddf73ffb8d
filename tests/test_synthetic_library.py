"""Furniture models from catalogues: read, simplified, held out, and put into rooms."""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from furniture_library import (
    CHAIR,
    TABLE,
    obj_of,
    properties,
    write_catalogue,
    write_library,
)

from fewview.errors import FewviewError
from fewview.synthetic import (
    Library,
    furniture,
    make_room,
    read_library,
    ring,
    room_sample,
    seating,
    split_of,
    split_seed,
    storage,
    tables,
)
from fewview.synthetic.classes import Surface
from fewview.synthetic.exchange import Exchange, exchange_for
from fewview.synthetic.library import Model
from fewview.synthetic.models import BUDGET, Shape
from fewview.synthetic.room import Room
from fewview.synthetic.simplify import area, paired, simplified, single
from fewview.synthetic.torch_rays import TorchCaster
from fewview.synthetic.wavefront import Material, read_mtl, read_obj
from fewview.types import Array

SPLITS = ("train", "validation", "test")
MAKERS = (
    tables.dining, tables.desk, tables.coffee_table, tables.round_table, seating.lounge,
    seating.sleeping, seating.sofa, storage.cupboard, storage.bookshelf, furniture.waste_bin,
)  # fmt: skip
ROOMS = {
    1: "a6700480789138bf",
    8: "5c0111510a7913c4",
    10**9: "e3442eab3cec4c03",
    3 * 10**9 + 7: "0365308bee51f0d1",
}
"""Digests of rooms as they were before there was a library."""
SAMPLE_8 = "f1d003ab697fc819"
"""Digest of a sample of room 8 as it was then."""


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Library:
    folder = tmp_path_factory.mktemp("furniture")
    write_library(folder)
    return read_library(folder)


def only_model(folder: Path, title: str, obj: str, **more: str) -> Model:
    """The model of a catalogue that holds nothing else."""
    write_catalogue(folder / "one.sh3f", [(properties(0, title, CHAIR, **more), obj)])
    (model,) = read_library(folder).models
    return model


def shape_of(model: Model) -> Shape:
    assert model.shape is not None
    return model.shape


def digest(*arrays: Array) -> str:
    """Of arrays to five decimals, so that it is the same on other processors."""
    out = hashlib.sha256()
    for array in arrays:
        out.update(np.rint(1e5 * array.astype(np.float64)).astype(np.int64).tobytes())
    return out.hexdigest()[:16]


def ball(rings: int) -> Array:
    """(n, 3, 3) triangles of a sphere of 0.5 m."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, rings), np.linspace(0, np.pi, rings))
    points = 0.5 * np.stack([np.sin(v) * np.cos(u), np.sin(v) * np.sin(u), np.cos(v)], axis=-1)
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    return np.stack([[a, b, c], [a, c, d]]).transpose(0, 2, 3, 1, 4).reshape(-1, 3, 3)


@pytest.mark.parametrize("seed", sorted(ROOMS))
def test_without_a_library_rooms_are_as_they_were(seed: int) -> None:
    room = make_room(seed)
    tones = np.stack([texture.tone for texture in room.textures])
    parts = (room.corners, room.uv, room.texture, room.surface, room.plane, room.lamps, tones)
    assert digest(*parts) == ROOMS[seed]


def test_without_a_library_samples_are_as_they_were() -> None:
    sample = room_sample(8, 3, 16)
    parts = (sample.level_T_world, sample.planes, sample.plane_kind, sample.layout)
    assert digest(*parts) == SAMPLE_8


def test_a_catalogue_is_read(tmp_path: Path) -> None:
    obj = obj_of(CHAIR)
    models = [
        (properties(0, "Oak chair", CHAIR, category="Kitchen"), obj),
        (properties(1, "Garden door", CHAIR, doorOrWindow="true"), obj),
        (properties(2, "Wall chair", CHAIR, elevation="120"), obj),
        (properties(3, "Bus", CHAIR), obj),
        (properties(4, "Chair without size", CHAIR, width="wide"), obj),
    ]
    write_catalogue(tmp_path / "one.sh3f", models)
    found = read_library(tmp_path)
    (chair,) = found.models
    assert (chair.title, chair.category, chair.author) == ("Oak chair", "Kitchen", "José")
    assert (chair.collection, chair.licence) == ("Test models", "CC-BY 3.0 © Test")
    assert [kind.surface for kind in chair.kinds] == [Surface.CHAIR]
    np.testing.assert_allclose(chair.size, [0.45, 0.45, 0.9])
    assert found.credits() == ("Test models: 1 models by José. CC-BY 3.0 © Test",)


@pytest.mark.parametrize(
    ("title", "classes"),
    [
        ("Armchair", {Surface.SOFA}),
        ("Sofa 3 seats", {Surface.SOFA}),
        ("Child bed", {Surface.BED}),
        ("Glass table", {Surface.TABLE}),
        ("Table tennis", set()),
        ("Desk lamp", set()),
        ("Bedside table", {Surface.TABLE, Surface.CABINET}),
        ("Full bookcase", {Surface.CABINET}),
    ],
)
def test_titles_tell_what_models_are(tmp_path: Path, title: str, classes: set[Surface]) -> None:
    models = [(properties(0, title, CHAIR), ""), (properties(1, "Sofa", CHAIR), "")]
    write_catalogue(tmp_path / "one.sh3f", models)
    found = [model for model in read_library(tmp_path).models if model.name.endswith("-0")]
    assert {kind.surface for model in found for kind in model.kinds} == classes


@pytest.mark.parametrize("turned", [False, True])
def test_a_model_stands_upright_with_its_back_behind(tmp_path: Path, turned: bool) -> None:
    obj = obj_of((*CHAIR, ((10, 10, 10), (-17, 17, 45), "glass")))
    more = {}
    if turned:
        lines = [line.split() for line in obj.splitlines()]
        swapped = [[p[0], p[3], p[1], p[2]] if p[0] == "v" else p for p in lines]
        obj = "\n".join(" ".join(p) for p in swapped)
        more["modelRotation"] = "0 1 0 0 0 1 1 0 0"
    shape = shape_of(only_model(tmp_path, "Chair", obj, **more))
    points = shape.corners.reshape(-1, 3)
    np.testing.assert_allclose(points.min(axis=0), [-0.225, -0.225, 0], atol=1e-9)
    np.testing.assert_allclose(points.max(axis=0), [0.225, 0.225, 0.9], atol=1e-9)
    assert points[points[:, 2] > 0.5, 1].max() == pytest.approx(-0.175)
    green = shape.corners[shape.material == 1]
    np.testing.assert_array_equal(shape.colours[:2], [[255, 0, 0], [0, 255, 0]])
    assert green[..., 2].min() == pytest.approx(0.45)
    assert len(shape.corners) == 12


def test_left_and_right_stay_apart(tmp_path: Path) -> None:
    lopsided = ((*CHAIR[0][:2], "red"), ((5, 5, 45), (20, -20, 45), "green"))
    shape = shape_of(only_model(tmp_path, "Chair", obj_of(lopsided)))
    assert shape.corners[shape.material == 1][..., 0].min() == pytest.approx(0.175)


@pytest.mark.parametrize(
    "obj", ["", "v 1 2 3\nf 1 2 3", "v 1 two 3", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3", "f"]
)
def test_a_model_without_a_shape_is_not_used(tmp_path: Path, obj: str) -> None:
    assert only_model(tmp_path, "Chair", obj).shape is None


def test_obj_faces_of_all_kinds_are_read() -> None:
    text = """mtllib a.mtl
v 0 0 0
v 1 0 0 0.5 0.5 0.5
v 1 1 0
usemtl dark wood
f -3//1 -2//2 -1//3
v 0 1 0
usemtl other
f 1/1 2/2 \\
 3/3 4/4
"""
    model = read_obj(text)
    assert model.libraries == ("a.mtl",) and model.names == ("dark wood", "other")
    np.testing.assert_array_equal(model.triangles, [[0, 1, 2], [0, 1, 2], [0, 2, 3]])
    np.testing.assert_array_equal(model.material, [0, 1, 1])


def test_materials_are_read() -> None:
    text = "newmtl dark wood\nKd 0.5 0.25 0\n\nmap_Kd -s 1 1 1 oak.jpg\nnewmtl glass\n  d 0.2\n"
    assert read_mtl(text) == {
        "dark wood": Material((0.5, 0.25, 0.0), 1.0, "oak.jpg"),
        "glass": Material(opacity=0.2),
    }


def test_large_models_are_brought_to_the_budget() -> None:
    whole = single(*(ball(60), (ball(60)[:, :, 2].mean(axis=1) > 0).astype(np.int64)))
    few, material = simplified(*whole, BUDGET)
    assert len(whole[0]) > 10 * BUDGET and 0.8 * BUDGET < len(few) <= BUDGET
    np.testing.assert_allclose(np.linalg.norm(few, axis=-1), 0.5, atol=0.02)
    assert area(few) == pytest.approx(np.pi, rel=0.03)
    assert few[material == 1, :, 2].min() > -0.02 and few[material == 0, :, 2].max() < 0.02


def test_backs_and_flat_faces_are_left_out() -> None:
    face = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    flat = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0]])
    kept, material = single(np.stack([flat, face, face[::-1]]), np.array([0, 1, 2]))
    np.testing.assert_array_equal(kept, face[None])
    np.testing.assert_array_equal(material, [1])


@pytest.mark.parametrize(
    ("corner", "joined"),
    [((1.0, 1, 0), True), ((1, 1, 0.3), False), ((0.2, 0.2, 0), False), ((1.2, -0.5, 0), False)],
)
def test_only_flat_convex_neighbours_are_paired(corner: tuple[float, ...], joined: bool) -> None:
    a, b, c = np.eye(3)[[2, 0, 1]] * [1, 1, 0]
    triangles = np.array([[a, b, c], [b, np.array(corner), c]])
    quads, material = paired(triangles, np.array([3, 3]))
    assert len(quads) == (1 if joined else 2) and (material == 3).all()
    halves = quads[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 3)
    assert area(halves) == pytest.approx(area(triangles))
    assert len(paired(triangles, np.array([0, 1]))[0]) == 2


def test_every_model_is_held_out_from_two_splits(library: Library, tmp_path: Path) -> None:
    names = {split: {m.name for m in library.of(split)} for split in SPLITS}
    assert sum(map(len, names.values())) == len(library.models) == 60
    assert set.union(*names.values()) == {m.name for m in library.models}
    assert len(names["train"]) > 30 and min(map(len, names.values())) >= 4
    assert {m.name for m in library.of("demo")} == names["test"]
    write_library(tmp_path, copies=20)
    for split in SPLITS:
        assert names[split] & {m.name for m in library.models} == names[split]
    more = {m.name: m.split for m in read_library(tmp_path).models}
    assert all(more[m.name] == m.split for m in library.models if m.name in more)


@pytest.mark.parametrize("split", ["demo", *SPLITS])
def test_a_room_has_models_of_its_own_split(library: Library, split: str) -> None:
    seed = split_seed(split, 5)
    assert split_of(seed) == split
    wanted = "test" if split == "demo" else split
    assert {m.split for m in exchange_for(seed, library).models} == {wanted}


def test_seeds_of_no_split_are_refused() -> None:
    with pytest.raises(FewviewError, match="no split"):
        split_of(4 * 10**9)


@pytest.mark.parametrize("maker", MAKERS)
def test_models_stay_in_the_boxes_of_what_they_replace(
    library: Library, maker: Callable[[np.random.Generator], furniture.Piece]
) -> None:
    for seed in range(6):
        piece = maker(np.random.default_rng(seed))
        exchange = Exchange(library.of("train"), np.random.default_rng(seed))
        patches = exchange(piece.patches)
        points = np.concatenate([p.corners.reshape(-1, 3) for p in patches])
        half = 0.5 * np.array(piece.size[:2]) + 1e-9
        assert (np.abs(points[:, :2]) <= half).all()
        assert points[:, 2].min() > -1e-9 and points[:, 2].max() <= piece.size[2] + 1e-9
        labels = {p.surface for p in piece.patches}
        assert {p.surface for p in patches} <= labels | {Surface.OTHER}


def test_about_two_thirds_of_the_pieces_that_have_models_are_exchanged(library: Library) -> None:
    rng, models = np.random.default_rng(0), library.of("train")
    sofas = [seating.sofa(np.random.default_rng(seed)) for seed in range(120)]
    changed = [Exchange(models, rng)(sofa.patches) != sofa.patches for sofa in sofas]
    assert 0.5 < np.mean(changed) < 0.8
    bin_ = furniture.waste_bin(np.random.default_rng(0))
    assert Exchange(models, rng)(bin_.patches) == bin_.patches


def test_chairs_of_a_table_are_alike_and_face_it(library: Library) -> None:
    chairs = tuple(m for m in library.of("train") if m.title == "Chair")
    for seed in range(8):
        piece = tables.dining(np.random.default_rng(seed))
        patches = Exchange(chairs, np.random.default_rng(seed))(piece.patches)
        new = [p for p in patches if p not in piece.patches]
        assert {p.surface for p in new} <= {Surface.CHAIR}
        for back in new[1::2]:
            middle = back.corners.reshape(-1, 3).mean(axis=0)
            seat = new[new.index(back) - 1].corners.reshape(-1, 3).mean(axis=0)
            assert abs(middle[1]) > abs(seat[1]) and middle[2] > seat[2]


def test_things_stand_on_flat_tops_only(tmp_path: Path) -> None:
    frame = (*TABLE[1:], ((120, 4, 4), (0, 33, 70), "red"), ((120, 4, 4), (0, -33, 70), "red"))
    for boxes, share in ((TABLE, 1.0), (frame, 0.1)):
        said = properties(0, "Table", TABLE)
        write_catalogue(tmp_path / "one.sh3f", [(said, obj_of(boxes))])
        models = read_library(tmp_path).models
        assert shape_of(models[0]).top == pytest.approx(share, abs=0.05)
        pieces = [tables.coffee_table(np.random.default_rng(seed)) for seed in range(12)]
        dining = [tables.dining(np.random.default_rng(seed)) for seed in range(12)]
        rng = np.random.default_rng(0)
        used = [Exchange(models, rng)(p.patches) != p.patches for p in pieces + dining]
        assert any(used) == (share == 1.0)


@cache
def furnished(library: Library, seed: int) -> tuple[Room, Room]:
    return make_room(seed), make_room(seed, library)


@pytest.mark.parametrize("seed", [1, 2, 10**9 + 3])
def test_a_furnished_room_keeps_its_plan(library: Library, seed: int) -> None:
    plain, other = furnished(library, seed)
    assert [s.name for s in plain.standing] == [s.name for s in other.standing]
    for a, b in zip(plain.standing, other.standing, strict=True):
        np.testing.assert_array_equal(a.footprint, b.footprint)
    shell = plain.plane >= 0
    np.testing.assert_array_equal(plain.corners[shell], other.corners[other.plane >= 0])
    assert Counter(other.surface.tolist()) != Counter(plain.surface.tolist())


def test_furnished_samples_depend_on_seed_and_library_alone(
    library: Library, tmp_path: Path
) -> None:
    first = room_sample(2, 2, 16, library=library)
    write_library(tmp_path)
    again = read_library(tmp_path)
    assert again.fingerprint == library.fingerprint
    second = room_sample(2, 2, 16, library=again)
    for name, value in vars(first).items():
        assert value.tobytes() == getattr(second, name).tobytes(), name
    bare = room_sample(2, 2, 16)
    assert first.depth.tobytes() != bare.depth.tobytes()
    write_library(tmp_path, copies=2)
    assert read_library(tmp_path).fingerprint != library.fingerprint


def test_torch_meets_models_as_embree_does(library: Library) -> None:
    room = furnished(library, 2)[1]
    sample = room_sample(2, 1, 12, library=library)
    beams = ring.beams(sample.level_T_world, 12)
    ours, theirs = TorchCaster(room.corners).cast(beams), room.caster.cast(beams)
    np.testing.assert_allclose(ours.depth, theirs.depth, rtol=1e-3, atol=1e-3)
    assert (np.linalg.norm(room.normals[theirs.triangle], axis=-1) > 0.999).all()


def test_a_folder_without_models_is_named_with_the_package(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "missing"):
        with pytest.raises(FewviewError, match="sweethome3d-furniture") as caught:
            read_library(folder)
        assert str(folder) in str(caught.value)
    (tmp_path / "broken.sh3f").write_text("no archive")
    with pytest.raises(FewviewError, match=r"broken\.sh3f: not a furniture catalogue"):
        read_library(tmp_path)
