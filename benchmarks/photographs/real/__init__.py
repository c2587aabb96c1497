"""The real set: outlines of real garments on harder grounds, with pictures that have to be refused.

`python -m benchmarks.photographs --set real --count 100 --first-seed 9000 --out DIR` draws and judges them.
Written, as the first set, without knowledge of the perception.
"""
