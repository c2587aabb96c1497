"""The operator's page: it shows the state of the run, the commands that are possible now, and the Rerun view."""
