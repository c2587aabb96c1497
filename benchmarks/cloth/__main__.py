"""Prints the figures without peers as JSON: python -m benchmarks.cloth."""

import json

from benchmarks.cloth import measure

if __name__ == "__main__":
    print(json.dumps(measure(print, peers=False, quick=False)))
