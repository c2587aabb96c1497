"""The pages of docs/look_up, written from the program: `python -m benchmarks.reference`."""
