"""The Rerun recording: complete, harmless to the run and geometrically correct."""

from __future__ import annotations

import math
import os
import signal
import socket
import subprocess
import sys
import textwrap
import threading
import time
import warnings
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pytest
import rerun.chunk
import rerun.error_utils
import synthetic_run as show
from scipy.spatial.transform import Rotation

from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.record.run_record import RecordingLosses
from foldcell.cell.view import bounded_worker, live
from foldcell.cell.view.bounded_worker import BoundedWorker
from foldcell.cell.view.entries import scene
from foldcell.cell.view.entries.entry import Columns, Log
from foldcell.cell.view.entries.robot import RobotFigure
from foldcell.cell.view.recorder import Recorder
from foldcell.robots.baxter.robot import ROBOT, load_model
from foldcell.robots.ports import JointState, Side
from foldcell.skills.fold_figures.drawn_mesh import vertex_normals
from foldcell.skills.vocabulary import PredictedShape


def rows(path: Path) -> dict[str, list[pa.RecordBatch]]:
    """The batches of each entity path, in file order."""
    found: dict[str, list[pa.RecordBatch]] = defaultdict(list)
    for chunk in rerun.chunk.RrdReader(str(path)).stream():
        found[chunk.entity_path].append(chunk.to_record_batch())
    return found


def complete(losses: RecordingLosses) -> bool:
    """Whether the file lacks nothing."""
    return not losses.dropped and not losses.errors


def column(batches: list[pa.RecordBatch], name: str) -> list:
    """The values of one component in all rows that have it."""
    return [v for b in batches if name in b.schema.names for v in b.column(name).to_pylist() if v is not None]


def times(batches: list[pa.RecordBatch]) -> np.ndarray:
    """Cell times of the rows [s]."""
    parts = [b.column("cell_time").cast(pa.int64()).to_numpy() for b in batches if "cell_time" in b.schema.names]
    return np.concatenate(parts) / 1e9


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, RecordingLosses, float]:
    path = tmp_path_factory.mktemp("view") / "run.rrd"
    recorder = Recorder.open(path, "run-1", show.TABLE, robot=ROBOT.visual())
    length, _ = show.play(recorder)
    return path, recorder.close(), length


def test_the_file_holds_every_row_of_every_series(recorded):
    path, report, length = recorded
    assert report == RecordingLosses()
    found = rows(path)
    ticks = round(length * 100)
    for entity in ("/joints/left", "/joints/right", "/opening/left", "/grip/right/pads_N", "/grip/left/gripper_N"):
        t = np.sort(times(found[entity]))
        assert len(t) == ticks, entity
        np.testing.assert_allclose(np.diff(t), 0.01, atol=1e-6)


def test_the_path_of_an_arm_that_is_not_in_the_new_plan_is_removed():
    """A new plan may use the other arm, or press with one hand after a fold with two."""
    arc = np.zeros((3, 3))
    shown = {"left", "right"}
    for arcs in ({Side.LEFT: arc, Side.RIGHT: arc}, {Side.RIGHT: arc}):
        for entry in scene.arc_entries(1.0, arcs, planned=True):
            where, _, side = entry.path.removeprefix(f"{scene.TABLE}/arcs/").partition("/")
            if where == "planned":
                drawn = any("LineStrips3D" in type(part).__name__ for part in entry.parts)
                shown = shown | {side} if drawn else shown - {side}
    assert shown == {"right"}


def test_states_are_recorded_in_order_until_the_end_of_the_run(recorded):
    path, _, length = recorded
    batches = rows(path)["/executive/state"]
    order = np.argsort(times(batches), kind="stable")
    said = [column(batches, "StateChange:state")[i][0] for i in order]
    distinct = [s for k, s in enumerate(said) if k == 0 or s != said[k - 1]]
    assert distinct[:4] == ["preparing", "photographing", "awaiting_garment", "looking"]
    assert distinct[-1] == "folded"
    assert distinct.count("folding") == 2
    assert times(batches).max() == pytest.approx(length, abs=0.011)


def test_the_layout_is_stored_in_the_file(recorded):
    path, _, _ = recorded
    assert len(rerun.chunk.RrdReader(str(path)).blueprints()) == 1


def transforms_at(path: Path, t: float) -> dict[str, tuple[str, float, np.ndarray]]:
    """For each frame (parent, cell time, T_parent_frame): the newest transform that is not newer than t [s]."""
    newest: dict[str, tuple[str, float, np.ndarray]] = {}
    for entity, batches in rows(path).items():
        if not entity.startswith("/tf"):
            continue
        for batch in batches:
            when = times([batch]) if "cell_time" in batch.schema.names else np.zeros(batch.num_rows)
            wanted = [n for n in batch.schema.names if n.startswith("Transform3D")]
            for stamp, row in zip(when, batch.select(wanted).to_pylist(), strict=True):
                child = row["Transform3D:child_frame"][0]
                if stamp > t + 1e-9 or (child in newest and newest[child][1] > stamp):
                    continue
                T = np.eye(4)
                if row.get("Transform3D:quaternion"):
                    T[:3, :3] = Rotation.from_quat(row["Transform3D:quaternion"][0]).as_matrix()
                    T[:3, 3] = row["Transform3D:translation"][0]
                newest[child] = (row["Transform3D:parent_frame"][0], stamp, T)
    return newest


def test_the_robot_is_drawn_at_its_joint_positions(recorded):
    """The file's transforms, chained up to the base frame, agree with Pinocchio."""
    path, _, _ = recorded
    model, series = load_model(), rows(path)
    newest = transforms_at(path, 10.0)
    stamp = newest["robot/left_upper_shoulder"][1]
    assert 9.9 < stamp <= 10.0
    q = []
    for side in Side:
        batches = series[f"/joints/{side}"]
        values = column(batches, "Scalars:scalars")
        q += values[int(np.argmin(np.abs(times(batches) - stamp)))]
    for side in Side:
        frame, T = f"robot/{side}_gripper", np.eye(4)
        while frame in newest:
            frame, _, local = newest[frame]
            T = local @ T
        assert frame == "tf#/world"
        np.testing.assert_allclose(T, model.tool_pose(side, np.array(q)), atol=2e-6)


def test_a_joint_whose_reading_is_no_number_stays_where_it_was_drawn_last():
    figure, n = RobotFigure(ROBOT.visual()), len(ROBOT.visual().joint_names)
    q = np.zeros((3, n))
    q[1, 0], q[:, 1] = math.nan, math.nan
    with warnings.catch_warnings():
        warnings.simplefilter("error", UserWarning)  # that of the library
        entries = figure.joints(np.array([0.0, 0.1, 0.2]), q, np.zeros(3))
        drawn = {entry.path: entry.t for entry in entries if isinstance(entry, Columns)}
    first, second, third = (f"tf/{name}" for name in ROBOT.visual().joint_names[:3])
    np.testing.assert_array_equal(drawn[first], [0.0, 0.2])
    assert second not in drawn
    assert len(drawn[third]) == 3


def test_the_optimisers_curve_and_arcs_are_recorded_and_cleared_by_the_plan(recorded):
    """The recording has the figures and arc of every candidate and of the best one so far. C is 1000 D plus the
    length of the paths."""
    path, _, _ = recorded
    found = rows(path)
    series = {name: np.ravel(column(found[f"/optimiser/{name}"], "Scalars:scalars"))
              for name in ("candidate_mm", "dissimilarity_mm", "cost", "simulations")}  # fmt: skip
    assert {len(values) for values in series.values()} == {16}, "two folds have eight candidates each"
    best = series["dissimilarity_mm"].reshape(2, 8)
    assert np.all(np.diff(best, axis=1) <= 0) and np.all(series["candidate_mm"].reshape(2, 8) >= best - 1e-9)
    np.testing.assert_allclose(series["cost"], series["dissimilarity_mm"] + 1.4)
    for side in Side:
        arcs = {kind: column(found[f"/world/table/arcs/{kind}/{side}"], "LineStrips3D:strips")
                for kind in ("candidate", "best", "planned")}  # fmt: skip
        folds = len(arcs["planned"])
        assert folds >= 1 and len(arcs["candidate"]) == 8 * folds and len(arcs["best"]) == 4 * folds
        planned = times(found[f"/world/table/arcs/planned/{side}"])
        for kind in ("candidate", "best"):
            cleared = times(found[f"/world/table/arcs/{kind}"])
            assert set(np.round(planned, 6)) <= set(np.round(cleared, 6)), "the plan clears the arcs of the search"


def test_the_garments_ground_truth_is_labelled(recorded):
    path, _, _ = recorded
    assert any("truth (simulation)" in e.replace("\\", "") for e in rows(path))


def test_ground_truth_is_recorded_only_while_the_cloth_moves(tmp_path):
    recorder = Recorder.open(tmp_path / "t.rrd", "x", show.TABLE)
    towel = show.Towel.make(5, 5)
    vertices = np.column_stack([towel.material, np.zeros(25)])
    for k in range(100):  # 0.5 s of rest, then 0.5 s of motion
        recorder.garment_truth(0.01 * k, vertices + max(0, k - 50) * 0.001, towel.triangles)
    recorder.close()
    (entity,) = [e for e in rows(tmp_path / "t.rrd") if "truth" in e]
    t = np.sort(times(rows(tmp_path / "t.rrd")[entity]))
    assert t[0] == 0.0
    assert t[1] > 0.5
    assert 6 <= len(t) <= 9


def test_bad_values_are_counted_and_valid_ones_are_recorded(tmp_path):
    recorder = Recorder.open(tmp_path / "bad.rrd", "x", show.TABLE)
    recorder.camera(0.0, show.picture(np.zeros((4, 3)), show.Towel.make(2, 2), 1, 0.0), None)  # type: ignore[arg-type]
    recorder.observed(0.1, np.full((3, 5), np.nan))
    recorder.joints(JointState(0.2, np.zeros(3), np.zeros(3), np.zeros(3), 0.0))
    recorder.event(0.3, "still here")
    report = recorder.close()
    assert len(report.errors) >= 2
    assert column(rows(tmp_path / "bad.rrd")["/log"], "TextLog:text") == [["still here"]]


def test_a_recording_that_cannot_be_opened_does_not_stop_the_run(tmp_path):
    recorder = Recorder.open(tmp_path / "missing" / "run.rrd", "x", show.TABLE)
    recorder.event(0.0, "hello")
    report = recorder.close()
    assert report.errors


def test_a_silent_recorder_accepts_everything_and_records_nothing():
    recorder = Recorder.silent()
    show.play(recorder, folds=1)
    assert recorder.close() == RecordingLosses()


def test_methods_return_before_anything_is_encoded(tmp_path, monkeypatch):
    """The caller that passes a picture does not wait for its encoding."""
    recorder = Recorder.open(tmp_path / "r.rrd", "x", show.TABLE)
    frame = show.picture(np.zeros((4, 3)), show.Towel.make(2, 2), 1, 0.0)
    handed_over, encode = threading.Event(), cv2.imencode

    def held(*arguments):
        handed_over.wait()
        return encode(*arguments)

    monkeypatch.setattr(cv2, "imencode", held)
    for k in range(100):
        recorder.camera(0.1 * k, frame, show.calibration())
    handed_over.set()
    assert complete(recorder.close())
    assert len(column(rows(tmp_path / "r.rrd")["/world/table/camera/picture"], "EncodedImage:blob")) == 100


def test_a_killed_run_leaves_a_readable_recording(tmp_path):
    path = tmp_path / "killed.rrd"
    code = f"""
        import time
        from pathlib import Path
        import numpy as np
        from foldcell.cell.view.recorder import Recorder
        from foldcell.robots.ports import JointState
        from foldcell.skills.vocabulary import Table
        recorder = Recorder.open(Path({str(path)!r}), "x", Table(-0.1, (0.2, 1.0), (-0.7, 0.7)))
        for k in range(1500):
            recorder.joints(JointState(0.01 * k, np.zeros(14), np.zeros(14), np.zeros(14), 0.0))
        recorder.event(15.0, "the last word")
        time.sleep(1.0)
        print("ready", flush=True)
        time.sleep(60)
    """
    process = subprocess.Popen([sys.executable, "-c", textwrap.dedent(code)], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    assert process.stdout.readline().strip() == "ready"
    os.kill(process.pid, signal.SIGKILL)
    process.wait()
    with pytest.warns(rerun.error_utils.RerunWarning, match="no footer"):
        found = rows(path)
    assert len(times(found["/joints/left"])) > 1400
    assert ["the last word"] in column(found["/log"], "TextLog:text")


def test_a_silent_client_of_the_live_stream_does_not_delay_the_run(tmp_path):
    recorder = Recorder.open(tmp_path / "live.rrd", "x", show.TABLE, live=True)
    assert recorder.live_url is not None
    port = int(recorder.live_url.split(":")[2].split("/")[0])
    for _ in range(100):
        try:
            client = socket.create_connection(("127.0.0.1", port), timeout=1.0)
            break
        except ConnectionRefusedError:
            time.sleep(0.05)
    show.play(recorder, folds=1)
    report = recorder.close()
    assert complete(report)
    client.close()


def test_a_live_stream_that_cannot_listen_is_reported_and_the_recording_is_complete(tmp_path, monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        monkeypatch.setattr(live, "free_port", lambda: taken.getsockname()[1])
        recorder = Recorder.open(tmp_path / "file.rrd", "x", show.TABLE, live=True)
        recorder.event(0.0, "hello")
        report = recorder.close()
    assert complete(report) and any("in use" in error for error in report.live_errors)
    assert column(rows(tmp_path / "file.rrd")["/log"], "TextLog:text") == [["hello"]]


@pytest.mark.filterwarnings("ignore::rerun.error_utils.RerunWarning")  # the viewer's file has no footer
def test_a_live_viewer_gets_the_recording_and_may_hang(tmp_path):
    recorder = Recorder.open(tmp_path / "file.rrd", "run-7", show.TABLE, live=True)
    assert recorder.live_url is not None
    recorder.event(0.0, "before the viewer came")
    rerun_viewer, copy = Path(sys.executable).parent / "rerun", tmp_path / "seen.rrd"
    viewer = subprocess.Popen(
        [rerun_viewer, "--connect", recorder.live_url, "--save", copy],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    try:
        wait_for(lambda: copy.exists() and copy.stat().st_size > 10_000)
        recorder.event(1.0, "after it")
        wait_for(lambda: len(written(copy)) == 2)
        # the whole process group, because `rerun` is a script that starts the viewer
        os.killpg(viewer.pid, signal.SIGSTOP)
        show.play(recorder, folds=1)
        assert complete(recorder.close())
    finally:
        os.killpg(viewer.pid, signal.SIGKILL)
        viewer.wait()
    assert len(times(rows(tmp_path / "file.rrd")["/joints/left"])) > 1200
    assert column(rows(copy)["/log"], "TextLog:text") == [["before the viewer came"], ["after it"]]


def written(copy: Path) -> list:
    """The log in a file that is still being written. The file may hold only the blueprint or end within a
    message."""
    try:
        return column(rows(copy)["/log"], "TextLog:text")
    except (ValueError, RuntimeError):
        return []


def wait_for(condition: Callable[[], bool], timeout: float = 60.0) -> None:
    end = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < end, "the condition is not met in time"
        time.sleep(0.1)


def test_a_full_queue_drops_items_except_essential_ones():
    gate, done = threading.Event(), []

    def work(item: int) -> None:
        gate.wait()
        done.append(item)

    worker: BoundedWorker[int] = BoundedWorker("test", work, lambda e: None, limit=3)
    taken = [worker.offer(k) for k in range(10)]
    assert taken.count(False) == worker.dropped >= 6
    assert worker.offer(99, essential=True)
    gate.set()
    assert worker.close(5.0)
    assert done == [k for k, ok in enumerate(taken) if ok] + [99]


def test_an_item_wakes_no_thread_and_the_end_wakes_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """A run offers hundreds of items a second: its own thread must not be interrupted for each."""
    monkeypatch.setattr(bounded_worker, "EVERY_S", 60.0)
    waits, waiting, wait = list[float | None](), threading.Event(), threading.Condition.wait

    def noted(condition: threading.Condition, timeout: float | None = None) -> bool:
        if threading.current_thread().name == "pump":
            waits.append(timeout)
            waiting.set()
        return wait(condition, timeout)

    monkeypatch.setattr(threading.Condition, "wait", noted)
    done: list[int] = []
    worker: BoundedWorker[int] = BoundedWorker("pump", done.append, lambda e: None, limit=100)
    waiting.wait()
    for k in range(5):
        assert worker.offer(k)
        time.sleep(0.01)
    assert worker.close(5.0)
    assert done == [0, 1, 2, 3, 4] and waits == [60.0]


def test_a_pump_continues_after_errors_and_counts_the_items_left_at_the_end():
    errors: list[BaseException] = []
    stuck = threading.Event()

    def work(item: int) -> None:
        if item == 1:
            raise ValueError("one")
        if item == 3:
            stuck.wait(10.0)

    worker: BoundedWorker[int] = BoundedWorker("test", work, errors.append, limit=100)
    for k in range(10):
        worker.offer(k)
    assert not worker.close(0.3)
    stuck.set()
    assert [str(e) for e in errors] == ["one"]
    assert worker.dropped == 6


def test_lines_of_one_plot_have_different_colours():
    entries = [e for e in scene.cell_entries(load_settings().table, None) if isinstance(e, Log)]
    looks = [e.parts[0].colors.as_arrow_array() for e in entries if e.path.startswith("grip/")]
    assert len(looks) == 6 == len({str(look) for look in looks})


def test_the_normals_of_a_sphere_point_outwards():
    polar, azimuth = np.linspace(0.3, np.pi - 0.3, 30), np.linspace(0, 2 * np.pi, 60, endpoint=False)
    u, v = np.meshgrid(polar, azimuth, indexing="ij")
    points = np.column_stack([(np.sin(u) * np.cos(v)).ravel(), (np.sin(u) * np.sin(v)).ravel(), np.cos(u).ravel()])
    i, j = np.meshgrid(np.arange(29), np.arange(60), indexing="ij")
    a, b = (i * 60 + j).ravel(), (i * 60 + (j + 1) % 60).ravel()
    triangles = np.vstack([np.column_stack([a, a + 60, b]), np.column_stack([b, a + 60, b + 60])])
    inside = slice(60, -60)
    normals = vertex_normals(points, triangles)[inside]
    assert np.einsum("ij,ij->i", normals, points[inside]).min() > 0.995
    facing = scene.facing_normals(points, triangles)
    assert (facing @ scene.TOWARDS_EYE).min() >= -1e-12


def test_the_mask_of_the_table_view_is_mapped_to_the_camera_picture():
    """A rectangle on the table, drawn in pixels of the table view, agrees with its corners projected by a pinhole
    camera."""
    calibration, pixel = show.calibration(), 0.002
    view = scene.TableView(calibration, show.TABLE, pixel)
    mask = np.zeros(view.shape, dtype=bool)
    corners = np.array([[0.45, -0.2], [0.75, -0.2], [0.75, 0.3], [0.45, 0.3]])
    cv2.fillPoly(grid := mask.astype(np.uint8), [np.round(view.to_pixel(corners)).astype(np.int32)], 1)
    (entry,) = scene.mask_entries(0.0, grid.astype(bool), calibration, show.TABLE, (480, 640))
    png = np.array(entry.parts[0].blob.as_arrow_array().to_pylist()[0], dtype=np.uint8)
    drawn = cv2.imdecode(png, cv2.IMREAD_UNCHANGED)[:, :, 3] > 0
    T = np.linalg.inv(calibration.T_table_camera)
    p = np.column_stack([corners, np.zeros(4)]) @ T[:3, :3].T + T[:3, 3]
    uvw = p @ calibration.intrinsics.matrix.T
    uv = np.round(uvw[:, :2] / uvw[:, 2:]).astype(np.int32)
    cv2.fillPoly(expected := np.zeros((480, 640), np.uint8), [uv], 1)
    assert (drawn & (expected > 0)).sum() / (drawn | (expected > 0)).sum() > 0.97


def test_robot_meshes_keep_their_shape_and_have_no_collision_bodies():
    import xml.etree.ElementTree as ET

    import trimesh

    from foldcell.robots.baxter.names import JOINT_NAMES
    from foldcell.robots.example_data import package_root

    urdf = ROBOT.visual().urdf
    root = ET.parse(urdf).getroot()
    assert not list(root.iter("collision"))
    assert set(JOINT_NAMES) < {j.get("name") for j in root.iter("joint")}
    original = {}
    for mesh in ET.parse(ROBOT.model_file()).getroot().iter("mesh"):
        path = package_root() / mesh.attrib["filename"].removeprefix("package://")
        original[path.stem] = path
    drawn = {Path(m.attrib["filename"]) for m in root.iter("mesh")}
    assert len(drawn) >= 12
    for glb in drawn:
        assert glb.is_file()
        bounds = trimesh.load_scene(glb).bounds
        np.testing.assert_allclose(bounds, trimesh.load_scene(original[glb.stem]).bounds, atol=0.004)


def test_the_estimated_state_is_recorded_as_sentence_picture_and_shape_and_a_heap_has_no_shape():
    triangle = PredictedShape(np.eye(3), np.array([[0, 1, 2]], np.int32), np.eye(3)[:, :2])
    picture, says = np.zeros((20, 30, 3), np.uint8), "the fold is half made"
    half, heap = (scene.estimate_entries(3.0, says, picture, shape) for shape in (triangle, None))
    assert (
        [e.path for e in half] == [e.path for e in heap] == ["log", "perception/estimate", "world/table/estimated"]
    )
    assert isinstance(half[2].parts[0], rerun.Mesh3D) and isinstance(heap[2].parts[0], rerun.Clear)
