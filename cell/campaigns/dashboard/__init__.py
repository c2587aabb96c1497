"""The history of a logs folder as pages: lists of runs and campaigns, and a comparison of two runs."""
