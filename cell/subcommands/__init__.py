"""What the commands do: one module each with `run(options) -> exit code`. Names and flags: cell/cli.py."""
