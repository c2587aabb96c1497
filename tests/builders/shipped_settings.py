"""The shipped settings, as the skills get them for Baxter."""

from __future__ import annotations

from cell.config.cell_settings import load_settings

__all__ = ["GRASP"]

GRASP = load_settings().grasp.settings(contact_effort=9.0, empty_opening=0.0)
