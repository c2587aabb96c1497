"""The operator's page: what the cell does, beside the Rerun view, and what an operator may say to it now."""
