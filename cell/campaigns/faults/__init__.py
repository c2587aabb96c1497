"""The table of faults and its campaign. The campaign causes faults at random moments and checks whether each run
ended as it should."""
