"""Campaigns of simulated runs: garments x seeds x variants, on any executor, resumable at any time."""
