"""Run calibration procedures (calibration/) on a cell, with the same checks, stop circuit and journal as a
fold."""
