"""Runs that are killed after a chosen durable write, and what their journal and their resume show."""
