"""Scripted runs of a cell, simulated or real. A script states faults and commands with their times, and the
expected results."""
