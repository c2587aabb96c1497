"""Scripted (hardware-in-the-loop) runs of a simulated or real cell. A script states faults and commands with their
times, and the expected results."""
