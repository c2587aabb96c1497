"""Drawn photographs of garments, made without knowledge of the perception, and the judgement of what it finds.

`python -m benchmarks.photographs --count 60 --first-seed 1 --out DIR` draws the pictures of `phone`, shows each to
`foldcell.perceive` and prints the figures beside the thresholds that were set beforehand (`judge.LIMITS`).
`--set real` takes the pictures of `real` instead.
"""
