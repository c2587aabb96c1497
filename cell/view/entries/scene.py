"""Entries of a recording for each object of the cell. Pure functions.

`world` is the robot's base frame. Entities in the table frame are under `world/table`. The camera is a pinhole
there, so that the viewer projects arcs, contours and key points into its picture. Series, state and log have
separate entity trees, because a view shows one tree.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from foldcell.cell.states.transition_table import State
from foldcell.cell.support.files.encoded_picture import jpeg_file
from foldcell.cell.view.entries import style
from foldcell.cell.view.entries.entry import Entry, Log
from foldcell.robots.ports import Array, CameraFrame, Side, arm_slice
from foldcell.skills.fold_figures.drawn_mesh import vertex_normals
from foldcell.skills.perception.rectification.table_view import TableView
from foldcell.skills.vocabulary import CameraCalibration, FoldStep, GarmentState, GraspId, PredictedShape, Table

TABLE = "world/table"
CAMERA = f"{TABLE}/camera"
TRUTH = rr.escape_entity_path_part("truth (simulation)")
JPEG_QUALITY = 85
ABOVE = 0.003
"""Lines on the table are drawn this far above its surface, so that the surface does not hide them [m]."""
OVERHANG = 0.15
"""A drawn fold line extends this far beyond the outer grasps [m]."""
THICKNESS = 0.04
LEGS = 0.05
EYE, LOOK_AT = (2.10, 1.45, 0.80), (0.30, 0.02, -0.05)
"""Default view of the cell: from the front left, like a person at the table [m, base frame]."""
TOWARDS_EYE = np.subtract(EYE, LOOK_AT)


def cell_entries(table: Table, floor: float | None) -> list[Entry]:
    """Return the fixed frames, the table and styles. floor: height of the floor, base frame [m]; None: no table
    legs."""
    (x0, x1), (y0, y1) = table.x, table.y
    legs = [] if floor is None else [(x, y) for x in (x0 + LEGS, x1 - LEGS) for y in (y0 + LEGS, y1 - LEGS)]
    height = table.height - (floor or 0.0)
    middle = ((x0 + x1) / 2, (y0 + y1) / 2, -THICKNESS / 2)
    boxes = rr.Boxes3D(
        centers=[middle, *((x, y, -(height + THICKNESS) / 2) for x, y in legs)],
        sizes=[(x1 - x0, y1 - y0, THICKNESS), *((LEGS, LEGS, height - THICKNESS) for _ in legs)],
        colors=[style.TABLE, *((120, 122, 128) for _ in legs)],
        fill_mode="solid",
    )  # fmt: skip
    states = rr.StateConfiguration(
        values=[s.value for s in State],
        labels=[style.label(s.value) for s in State],
        colors=[style.STATE_COLOURS[s] for s in State],
    )
    return [
        Log("world", None, (rr.ViewCoordinates.RIGHT_HAND_Z_UP,), essential=True),
        Log(TABLE, None, (rr.Transform3D(translation=table.T_base_table[:3, 3]),), essential=True),
        Log(f"{TABLE}/top", None, (boxes,), essential=True),
        Log("executive/state", None, (states,), essential=True),
        *_series_entries(),
    ]


def _series_entries() -> list[Entry]:
    """Return the names and colours of the plotted series."""
    entries: list[Entry] = []
    for side in Side:
        colour = style.SIDE_COLOURS[side.value]
        for path, name, shown, width in (
            (f"grip/{side}/pads_N", "pads", colour, 2.0),
            (f"grip/{side}/gripper_N", "gripper", (*colour, 120), 1.0),
            (f"grip/{side}/tip_N", "tips", style.darker(colour), 1.0),
            (f"opening/{side}", "opening", colour, 2.0),
        ):
            look = rr.SeriesLines(names=f"{side} {name}", colors=[shown], widths=[width])
            entries.append(Log(path, None, (look,), essential=True))
    for path, name, colour in (("dissimilarity_mm", "best D [mm]", style.ARC_PLANNED),
                               ("cost", "best cost C [mm of D + m of path]", style.PREDICTED)):  # fmt: skip
        look = rr.SeriesLines(names=name, colors=[colour], widths=[2.0])
        entries.append(Log(f"optimiser/{path}", None, (look,), essential=True))
    dots = rr.SeriesPoints(names="candidate's D [mm]", colors=[style.CANDIDATE], marker_sizes=[3.0])
    entries.append(Log("optimiser/candidate_mm", None, (dots,), essential=True))
    return entries


def joint_names_entries(names: Sequence[str]) -> list[Entry]:
    """Return the names of the joint series. names: (joints,), beginning with the left arm's."""
    part = {side: list(names[arm_slice(side, len(names))]) for side in Side}
    return [Log(f"joints/{side}", None, (rr.SeriesLines(names=part[side]),), essential=True) for side in Side]


def state_entries(t: float, state: str) -> list[Entry]:
    return [Log("executive/state", t, (rr.StateChange(state=state),), essential=True)]


def log_entries(t: float, text: str, level: str) -> list[Entry]:
    return [Log("log", t, (rr.TextLog(text, level=level.upper()),), essential=True)]


def jpeg(rgb: NDArray) -> rr.EncodedImage:
    """Encode a picture (H, W, 3) uint8 as a JPEG archetype."""
    return rr.EncodedImage(contents=jpeg_file(rgb, JPEG_QUALITY), media_type="image/jpeg")


def camera_entries(t: float, frame: CameraFrame, calibration: CameraCalibration) -> list[Entry]:
    """Return the picture, its depth and the camera's estimated pose. Clears the perception of the previous
    picture."""
    k, T = calibration.intrinsics, calibration.T_table_camera
    pinhole = rr.Pinhole(  # a negative line width is in points of the screen
        image_from_camera=k.matrix, resolution=[k.width, k.height], camera_xyz=rr.ViewCoordinates.RDF,
        image_plane_distance=0.2, color=(160, 160, 170), line_width=-1.0,
    )  # fmt: skip
    pose = rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3])
    millimetres = np.nan_to_num(frame.depth * 1000.0, nan=0.0).clip(0, 65535).astype(np.uint16)
    _, png = cv2.imencode(".png", millimetres, [cv2.IMWRITE_PNG_COMPRESSION, 4])
    depth = rr.EncodedDepthImage(png.tobytes(), media_type="image/png", meter=1000.0)
    stale = (f"{CAMERA}/mask", f"{TABLE}/perceived", f"{TABLE}/observed", f"{TABLE}/estimated")
    return [
        *(Log(path, t, (rr.Clear(recursive=True),)) for path in stale),
        Log(CAMERA, t, (pose, pinhole)),
        Log(f"{CAMERA}/picture", t, (jpeg(frame.rgb),)),
        Log(f"{CAMERA}/depth", t, (depth,)),
    ]


def mask_entries(
    t: float, mask: NDArray, calibration: CameraCalibration, table: Table, shape: tuple[int, int]
) -> list[Entry]:
    """Return the segmentation as an overlay on the camera's picture of `shape` (H, W). mask: bool, in pixels of
    the camera or of the table view."""
    if mask.shape != shape:
        view = TableView(calibration, table, (table.x[1] - table.x[0]) / mask.shape[0])
        size = (shape[1], shape[0])
        mask = cv2.warpPerspective(mask.astype(np.uint8), view.homography, size, flags=cv2.INTER_NEAREST)
    rgba = np.zeros((*shape, 4), dtype=np.uint8)
    rgba[mask.astype(bool)] = (*style.MASK, 90)
    _, png = cv2.imencode(".png", cv2.cvtColor(rgba, cv2.COLOR_RGBA2BGRA), [cv2.IMWRITE_PNG_COMPRESSION, 9])
    tint = rr.EncodedImage(contents=png.tobytes(), media_type="image/png", draw_order=10.0)
    return [Log(f"{CAMERA}/mask", t, (tint,))]


def perception_entries(t: float, state: GarmentState) -> list[Entry]:
    """Return the perceived contour and key points, on the table."""
    names = list(state.keypoints)
    entries: list[Entry] = [
        Log(f"{TABLE}/perceived/contour", t, (_closed(state.contour, style.PERCEIVED, 0.002),)),
    ]
    if names:
        points = _lift(np.array([state.keypoints[n] for n in names]))
        shown = rr.Points3D(points, radii=0.009, colors=[style.KEYPOINT], labels=names, show_labels=False)
        entries.append(Log(f"{TABLE}/perceived/keypoints", t, (shown,)))
    return entries


def plan_entries(t: float, step: FoldStep) -> list[Entry]:
    """Return the fold line, grasps and targets of a step. Clears arcs and prediction of the previous step."""
    old = (f"{TABLE}/arcs", f"{TABLE}/predicted")
    line = rr.LineStrips3D([_lift(_fold_line(step))], radii=0.0025, colors=[style.FOLD_LINE])
    grasp_ids = list(step.grasps)
    grasps = _lift(np.array([step.grasps[i].point for i in grasp_ids]).reshape(-1, 2))
    targets = np.array([step.targets[i] for i in grasp_ids]).reshape(-1, 3)
    return [
        *(Log(path, t, (rr.Clear(recursive=True),)) for path in old),
        Log(f"{TABLE}/plan/fold_line", t, (line,)),
        Log(f"{TABLE}/plan/grasps", t, (rr.Points3D(grasps, radii=0.011, colors=[style.GRASP],
            labels=[f"{i} grasp" for i in grasp_ids], show_labels=False),)),
        Log(f"{TABLE}/plan/targets", t, (rr.Points3D(targets, radii=0.008, colors=[style.TARGET],
            labels=[f"{i} target" for i in grasp_ids], show_labels=False),)),
    ]  # fmt: skip


def arc_entries(t: float, arcs: Mapping[Side, Array], planned: bool) -> list[Entry]:
    """Return the tool paths (n, 3). Planned paths are light green, executed paths are darker and thinner.

    Clears the paths of arms that are not in `arcs`. Planned paths also clear the candidates of the search.
    """
    kind = "planned" if planned else "driven"
    colour, radius = (style.ARC_PLANNED, 0.005) if planned else (style.ARC_DONE, 0.003)
    void = [*(("candidate", "best") if planned else ()), *(f"{kind}/{side}" for side in Side if side not in arcs)]
    return [
        *(Log(f"{TABLE}/arcs/{name}", t, (rr.Clear(recursive=True),)) for name in void),
        *(
            Log(f"{TABLE}/arcs/{kind}/{side}", t, (rr.LineStrips3D([arc], radii=radius, colors=[colour]),))
            for side, arc in arcs.items()
        ),
    ]


def candidate_entries(
    t: float,
    simulations: int,
    arcs: Mapping[GraspId, Array],
    own: tuple[float, float],
    best: tuple[float, float],
) -> list[Entry]:
    """Return a simulated candidate: its arcs (n, 3) as thin lines. own, best: D [m] and cost C [m] of this
    candidate and of the best candidate so far.

    The best candidate's arc stays visible in green. The cost C is path length [m] + 1000 D, so it can share an
    axis with D in mm.
    """
    shown = [
        Log(f"{TABLE}/arcs/candidate/{i}", t, (rr.LineStrips3D([arc], radii=0.0015, colors=[style.CANDIDATE]),))
        for i, arc in arcs.items()
    ]
    if own == best:
        shown += [
            Log(f"{TABLE}/arcs/best/{i}", t, (rr.LineStrips3D([arc], radii=0.003, colors=[style.ARC_PLANNED]),))
            for i, arc in arcs.items()
        ]
    figures = {"candidate_mm": 1e3 * own[0], "dissimilarity_mm": 1e3 * best[0], "cost": best[1],
               "simulations": float(simulations)}  # fmt: skip
    return [*shown, *(Log(f"optimiser/{name}", t, (rr.Scalars(value),)) for name, value in figures.items())]


def adapted_entries(t: float, friction: float, learned: float) -> list[Entry]:
    """Return the estimated friction between cloth and table, and the share (0..1) by which the last fold reduced
    the uncertainty of this estimate."""
    figures = {"friction": friction, "friction_learned": learned}
    return [Log(f"optimiser/{name}", t, (rr.Scalars(value),)) for name, value in figures.items()]


def predicted_entries(t: float, shape: PredictedShape) -> list[Entry]:
    return [Log(f"{TABLE}/predicted", t, (mesh(shape.vertices, shape.triangles, (*style.PREDICTED, 75)),))]


def observed_entries(t: float, points: Array) -> list[Entry]:
    """Return a contour (n, 2) as a line, or height points (n, 3) as dots."""
    path = f"{TABLE}/observed"
    if points.shape[1] == 2:
        return [Log(path, t, (_closed(points, style.OBSERVED, 0.0025),))]
    return [Log(path, t, (rr.Points3D(points, radii=0.002, colors=[style.OBSERVED]),))]


def estimate_entries(t: float, says: str, picture: NDArray, shape: PredictedShape | None) -> list[Entry]:
    """Return an estimated state of the garment: the sentence in the log, the candidates over the picture, and the
    shape of the best candidate on the table."""
    path = f"{TABLE}/estimated"
    shown = rr.Clear(recursive=True) if shape is None else mesh(shape.vertices, shape.triangles, (*style.MASK, 90))
    return [
        *log_entries(t, says, "WARN"),
        Log("perception/estimate", t, (jpeg(picture),)),
        Log(path, t, (shown,)),
    ]


def truth_entries(t: float, vertices: Array, triangles: NDArray, first: bool) -> list[Entry]:
    """Return the simulated garment itself: the whole mesh if `first`, else vertices and normals only."""
    path = f"{TABLE}/{TRUTH}"
    if first:
        return [Log(path, t, (mesh(vertices, triangles, (*style.GARMENT, 255)),), essential=True)]
    return [Log(path, t, (moved_mesh(vertices, triangles),))]


def moved_mesh(vertices: Array, triangles: NDArray) -> rr.Mesh3D:
    """Return new places for the vertices of a mesh that was recorded before."""
    normals = facing_normals(vertices, triangles).astype(np.float32)
    return rr.Mesh3D.from_fields(vertex_positions=vertices.astype(np.float32), vertex_normals=normals)


def mesh(vertices: Array, triangles: NDArray, colour: tuple[int, ...]) -> rr.Mesh3D:
    return rr.Mesh3D(
        vertex_positions=vertices.astype(np.float32),
        triangle_indices=triangles.astype(np.uint32),
        vertex_normals=facing_normals(vertices, triangles).astype(np.float32),
        albedo_factor=colour,
    )


def facing_normals(vertices: Array, triangles: NDArray) -> Array:
    """Return normals (n, 3) turned towards the default eye, because the viewer draws the back of a sheet black."""
    normal = vertex_normals(vertices, triangles)
    away = normal @ TOWARDS_EYE < 0.0
    normal[away] *= -1.0
    return normal


def _lift(points: Array) -> Array:
    """Convert points (n, 2) or (n, 3) on the table to points (n, 3) slightly above it."""
    points = np.asarray(points, dtype=np.float64)
    if points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    return points + np.array([0.0, 0.0, ABOVE])


def _closed(contour: Array, colour: tuple[int, ...], radius: float) -> rr.LineStrips3D:
    return rr.LineStrips3D([_lift(np.vstack([contour, contour[:1]]))], radii=radius, colors=[colour])


def _fold_line(step: FoldStep) -> Array:
    """Return the ends (2, 2) of the drawn part of the infinite fold line: the part along the grasps, and OVERHANG
    more at both ends."""
    line = step.line
    along = (np.array([g.point for g in step.grasps.values()]) - line.point) @ line.direction
    return line.point + np.outer((along.min() - OVERHANG, along.max() + OVERHANG), line.direction)
