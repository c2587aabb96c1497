"""Calibration procedures: pure, without I/O. They say what a cell has to do, and compute the result."""
