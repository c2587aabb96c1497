"""Scripted runs of a cell, simulated or not: what is let go wrong or said when, and what has to come of it."""
