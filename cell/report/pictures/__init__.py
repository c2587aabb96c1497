"""The pictures and the film of a report."""
