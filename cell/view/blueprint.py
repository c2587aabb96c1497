"""The layout of the recording in the viewer: the cell, the camera's pictures, the state, series and log."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb

from foldcell.cell.view.entries.entry import TIMELINE
from foldcell.cell.view.entries.scene import CAMERA, EYE, LOOK_AT, TABLE


def layout(floor: float = 0.0) -> rrb.Blueprint:
    """Return the blueprint that is stored in each recording. floor: height of the floor in the base frame [m]."""
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(_cell(floor), rrb.StateTimelineView(origin="executive", name="State"), row_shares=[7, 1]),
            rrb.Vertical(_camera(), _series(), _log(), row_shares=[5, 4, 3]),
            column_shares=[8, 5],
        ),
        rrb.TimePanel(state="collapsed", timeline=TIMELINE, play_state="following"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        auto_views=False,
    )


def _cell(floor: float) -> rrb.Spatial3DView:
    ground = rr.components.Plane3D.XY.with_distance(floor)
    return rrb.Spatial3DView(
        origin="world",
        contents=["+ world/**", f"- {CAMERA}/depth/**", f"- {CAMERA}/mask/**"],
        name="Cell",
        background=rrb.Background(color=(30, 33, 38), kind=rrb.BackgroundKind.SolidColor),
        line_grid=rrb.LineGrid3D(visible=True, spacing=0.5, plane=ground, color=(255, 255, 255, 18)),
        eye_controls=rrb.EyeControls3D(position=EYE, look_target=LOOK_AT, eye_up=(0.0, 0.0, 1.0)),
    )


def _camera() -> rrb.Tabs:
    drawn = [f"+ {TABLE}/{part}/**" for part in ("perceived", "plan", "arcs/planned", "observed")]
    return rrb.Tabs(
        rrb.Spatial2DView(
            origin=CAMERA, contents=[f"+ {CAMERA}/picture/**", f"+ {CAMERA}/mask/**", *drawn], name="Camera"
        ),
        rrb.Spatial2DView(origin=CAMERA, contents=[f"+ {CAMERA}/depth/**"], name="Depth"),
        rrb.Spatial2DView(origin="perception", contents=["+ perception/overlay/**"], name="Recognised"),
        rrb.Spatial2DView(origin="perception", contents=["+ perception/fitting/**"], name="Fitting"),
        rrb.Spatial2DView(origin="perception", contents=["+ perception/estimate/**"], name="After a failure"),
        active_tab=0,
    )


def _series() -> rrb.Tabs:
    legend = rrb.PlotLegend(corner=rrb.Corner2D.LeftTop)
    return rrb.Tabs(
        rrb.TimeSeriesView(origin="grip", name="Grip [N]", plot_legend=legend),
        rrb.TimeSeriesView(origin="opening", name="Opening [mm]", plot_legend=legend),
        rrb.TimeSeriesView(origin="joints/left", name="Left joints [rad]", plot_legend=legend),
        rrb.TimeSeriesView(origin="joints/right", name="Right joints [rad]", plot_legend=legend),
        rrb.TimeSeriesView(
            origin="optimiser",
            contents=["+ optimiser/**", "- optimiser/simulations"],
            name="Optimiser",
            plot_legend=legend,
        ),
        active_tab=0,
    )


def _log() -> rrb.TextLogView:
    return rrb.TextLogView(
        origin="log",
        name="Log",
        columns=rrb.TextLogColumns(timeline_columns=[TIMELINE], text_log_columns=["loglevel", "body"]),
    )
