"""Calibration procedures, which make the models of cell and fabric match reality."""
