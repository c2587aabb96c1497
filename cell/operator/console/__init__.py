"""The operator's page: the state of the run, the commands that are possible now, and the Rerun view."""
