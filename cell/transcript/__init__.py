"""Transcripts: all exchanges between executive and cell are recorded, so that a run can be decided again."""
