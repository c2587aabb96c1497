"""Performs the procedures of `calibration` in a cell, with the checks, stop circuit and journal of a fold."""
