"""What is drawn: scans, pose graphs, matches, meshes, each logged to a Rerun stream.

Rerun counts pixels from the image corner, `fewview` from the centre of the first pixel; half a
pixel is added on the way.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
from scipy.spatial.transform import Rotation

from fewview.completion.panorama import CLASSES
from fewview.geometry import se3
from fewview.recording import layout, pictures, room_pictures
from fewview.recording.layout import Eye
from fewview.recording.pictures import Image, Preview
from fewview.recording.rooms import CLASS_COLOURS, RoomShape
from fewview.types import (
    Array,
    ColouredMesh,
    CompletedRoom,
    FloatArray,
    Frame,
    Intrinsics,
    Levelling,
    PoseCandidate,
)

CAMERA_SIZE_M = 0.25
POINT_RADIUS_M = 0.015
PREDICTED_RADIUS_M = 0.008
PLANE_COLOURS = {True: (70, 220, 130), False: (255, 150, 40)}
"""Of planes that a scan shows part of, and of planes that are predicted."""
PLANE_OPACITY = 12
GALLERY_STEP_M = 5.0
GALLERY_COLUMNS = 5
KIND_COLOURS = (
    (90, 200, 250),
    (255, 190, 60),
    (130, 230, 110),
    (240, 110, 200),
    (190, 150, 255),
)


def log_inputs(stream: rr.RecordingStream, name: str, frame: Frame) -> None:
    """The images of a scan as read, at most `pictures.INPUT_WIDTH` wide."""
    images = pictures.reduced(frame, pictures.INPUT_WIDTH)
    stream.log(layout.path(layout.SCANS, name, "rgb"), _rgb(images.colour))
    stream.log(layout.path(layout.SCANS, name, "depth"), _depth(images.depth))


def log_points(stream: rr.RecordingStream, root: str, scan: Preview, root_T_scan: Array) -> None:
    """The points of a scan at its place ``root``."""
    stream.log(root, _transform(root_T_scan))
    cloud = rr.Points3D(scan.points, colors=scan.point_colours, radii=POINT_RADIUS_M)
    stream.log(f"{root}/points", cloud)


def log_camera(stream: rr.RecordingStream, root: str, scan: Preview) -> None:
    """The camera of a scan with its images, below the place ``root`` of the scan."""
    stream.log(f"{root}/image", _pinhole(scan.intrinsics))
    stream.log(f"{root}/image/rgb", _rgb(scan.colour))
    stream.log(f"{root}/image/depth", _depth(scan.depth))


def log_room_pictures(stream: rr.RecordingStream, name: str, room: CompletedRoom) -> None:
    """What a scan shows of its room beside what the networks make of it."""
    root = layout.path(layout.ROOMS, name)
    if room.panorama is not None:
        rings = room_pictures.ring_pictures(room.ring, room.panorama)
        stream.log(f"{root}/depth", _depth(rings.depth, room_pictures.FARTHEST_M))
        stream.log(f"{root}/semantics", rr.SegmentationImage(rings.semantics), _classes())
        stream.log(f"{root}/normals", _lossless(rings.normals))
        stream.log(f"{root}/confidence", _lossless(rings.confidence))
    if room.layout is not None:
        picture = room_pictures.layout_picture(room.layout)
        stream.log(f"{root}/layout", _lossless(picture))


def log_room_shape(stream: rr.RecordingStream, place: str, room: RoomShape) -> None:
    """The predicted points and the structural planes of a scan, below its place."""
    root = f"{place}/room"
    if len(room.points):
        cloud = rr.Points3D(room.points, colors=room.point_colours, radii=PREDICTED_RADIUS_M)
        stream.log(f"{root}/points", cloud)
    for observed, entity in ((True, "seen_planes"), (False, "predicted_planes")):
        corners = room.rectangles[room.observed == observed]
        if len(corners):
            colour = PLANE_COLOURS[observed]
            outlines = np.concatenate([corners, corners[:, :1]], axis=1)
            strips = rr.LineStrips3D(outlines, colors=colour, radii=rr.Radius.ui_points(0.6))
            stream.log(f"{root}/{entity}", strips)
            stream.log(f"{root}/{entity}/faces", _faces(corners, (*colour, PLANE_OPACITY)))


def log_labels(
    stream: rr.RecordingStream, path: str, positions: Array, texts: Sequence[str]
) -> None:
    """Names at positions (n, 3), all in one entity."""
    stream.log(
        path,
        rr.Points3D(
            positions,
            labels=texts,
            show_labels=True,
            radii=rr.Radius.ui_points(3.0),
            colors=(255, 255, 255),
        ),
    )


def log_edges(
    stream: rr.RecordingStream,
    path: str,
    edges: Sequence[Array],
    weights: Sequence[float],
) -> None:
    """Lines (2, 3) in one entity, red for weight 0 to green for weight 1."""
    if edges:
        lines = rr.LineStrips3D(
            np.asarray(edges),
            colors=heat(np.asarray(weights)),
            radii=rr.Radius.ui_points(1.0),
        )
        stream.log(path, lines)


def log_mesh(stream: rr.RecordingStream, root: str, mesh: ColouredMesh) -> None:
    """A mesh seen from the inside of its room: walls between viewer and room are not drawn."""
    drawn = pictures.light(mesh)
    stream.log(
        root,
        rr.Mesh3D(
            vertex_positions=drawn.vertices,
            triangle_indices=drawn.faces.astype(np.uint32),
            vertex_colors=drawn.colours,
            face_rendering=rr.components.MeshFaceRendering.Front,
        ),
    )


def log_matches(
    stream: rr.RecordingStream,
    source: Preview,
    target: Preview,
    candidate: PoseCandidate,
) -> None:
    """Both images side by side, with the matches of a candidate in one entity per kind."""
    root = layout.pair(source.name, target.name)
    both = pictures.side_by_side(source.colour, target.colour)
    stream.log(f"{root}/images", _rgb(both))
    for kind in sorted(candidate.matches):
        lines = pictures.match_lines(source, target, kind, candidate.matches[kind])
        colour = KIND_COLOURS[sorted(source.pixels).index(kind) % len(KIND_COLOURS)]
        if len(lines):
            strips = rr.LineStrips2D(lines + 0.5, colors=colour, radii=rr.Radius.ui_points(0.5))
            stream.log(f"{root}/matches/{layout.path(kind)}", strips)


def log_text(stream: rr.RecordingStream, path: str, markdown: str) -> None:
    """A Markdown document."""
    stream.log(path, rr.TextDocument(markdown, media_type=rr.MediaType.MARKDOWN))


def gallery_T_scan(index: int, levelling: Levelling) -> Array:
    """A place of its own, upright, for a scan whose pose is not known."""
    height = 0.0 if levelling.floor_z is None else -levelling.floor_z
    return se3.pose(levelling.level_R_scan, _shelf(index) + np.array([0.0, 0.0, height]))


def gallery_eye(count: int) -> Eye:
    """Look at the first ``count`` places of the gallery, a margin around them."""
    shelves = np.stack([_shelf(i) for i in range(max(count, 1))])
    target = (shelves.min(axis=0) + shelves.max(axis=0)) / 2
    size = float(np.ptp(shelves[:, :2], axis=0).max()) + GALLERY_STEP_M
    return Eye(target + size * np.array([0.0, -0.75, 0.55]), target)


def _shelf(index: int) -> Array:
    row, column = divmod(index, GALLERY_COLUMNS)
    return GALLERY_STEP_M * np.array([column, -row, 0.0])


def heat(share: Array) -> Image:
    """(n, 3) colours of shares (n,) in 0..1, from red over yellow to green."""
    share = np.clip(share, 0.0, 1.0)
    channels = [
        np.minimum(1.0, 2.0 - 2.0 * share),
        np.minimum(1.0, 2.0 * share),
        0.25 + 0 * share,
    ]
    return np.asarray(255 * np.stack(channels, axis=-1), dtype=np.uint8)


def _rgb(colour: Image) -> rr.EncodedImage:
    return rr.EncodedImage(contents=pictures.jpeg(colour), media_type="image/jpeg")


def _classes() -> rr.AnnotationContext:
    """Names and colours of what completed 360-images show."""
    classes = zip(range(len(CLASSES)), CLASSES, CLASS_COLOURS.tolist(), strict=True)
    return rr.AnnotationContext(list(classes))


def _lossless(picture: Image) -> rr.EncodedImage:
    return rr.EncodedImage(contents=pictures.png(picture), media_type="image/png")


def _faces(corners: Array, rgba: tuple[int, ...]) -> rr.Mesh3D:
    """Rectangles (n, 4, 3) in one colour, seen from where their corners turn to the left."""
    first = 4 * np.arange(len(corners))[:, None, None]
    triangles = (first + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    return rr.Mesh3D(
        vertex_positions=corners.reshape(-1, 3),
        triangle_indices=triangles.astype(np.uint32),
        albedo_factor=rgba,
        face_rendering=rr.components.MeshFaceRendering.Front,
    )


def _depth(depth: FloatArray, farthest_m: float | None = None) -> rr.EncodedDepthImage:
    """Depth in metres; ``farthest_m`` gets the last colour, else the largest value does."""
    return rr.EncodedDepthImage(
        pictures.depth_png(depth),
        media_type="image/png",
        meter=1000.0,
        depth_range=None if farthest_m is None else (0.0, 1000.0 * farthest_m),
    )


def _transform(parent_T_child: Array) -> rr.Transform3D:
    turn = Rotation.from_matrix(parent_T_child[:3, :3])
    return rr.Transform3D(
        translation=parent_T_child[:3, 3], quaternion=rr.Quaternion(xyzw=turn.as_quat())
    )


def _pinhole(intrinsics: Intrinsics) -> rr.Pinhole:
    return rr.Pinhole(
        focal_length=(intrinsics.fx, intrinsics.fy),
        principal_point=(intrinsics.cx + 0.5, intrinsics.cy + 0.5),
        width=intrinsics.width,
        height=intrinsics.height,
        camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=CAMERA_SIZE_M,
    )
