"""Procedures that make the model match the cell."""
