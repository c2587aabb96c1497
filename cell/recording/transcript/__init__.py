"""Runs that are decided again: what passed between executive and cell is kept, and answers it another time."""
