"""The table of faults and its campaign: faults at random moments, and whether each run ended as it should."""
