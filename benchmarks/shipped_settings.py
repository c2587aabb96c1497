"""The shipped settings of perception and inspection."""

from __future__ import annotations

from foldcell.cell.config.cell_settings import load_settings

_SHIPPED = load_settings()
PERCEPTION = _SHIPPED.perception.settings()
INSPECTION = _SHIPPED.inspection.settings(_SHIPPED.perception)
