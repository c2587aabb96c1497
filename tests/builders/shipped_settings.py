"""The shipped settings, as the skills get them for Baxter."""

from __future__ import annotations

from functools import partial

from foldcell.cell.config.cell_settings import load_settings
from foldcell.cell.hardware.assembly import execution_limits
from foldcell.skills.perception import perceive as perceiving
from foldcell.skills.perception.inspection import inspect as inspecting

_SHIPPED = load_settings()
GRASP = _SHIPPED.grasp.settings(contact_effort=9.0, empty_opening=0.0, tip_distance=0.038)
LIMITS = execution_limits(_SHIPPED.motion)
PERCEPTION = _SHIPPED.perception.settings()
INSPECTION = _SHIPPED.inspection.settings(_SHIPPED.perception)

perceive = partial(perceiving.perceive, settings=PERCEPTION)
inspect = partial(inspecting.inspect, settings=INSPECTION)
