"""Random inputs and surroundings of all commands: `python -m benchmarks.inputs`."""
