"""Campaigns of runs: garments x seeds x variants, on any executor, resumable at any time."""
