"""The phone set: pictures as people take them with a telephone of a garment that lies on a floor, desk or bed.

`python -m benchmarks.photographs --set phone --count 60 --first-seed 1 --out DIR` draws and judges them. Cloth,
ground and things are one height field: its slopes, and the shadows that it throws, make the picture. Every fourth
picture has to be refused; the garment is named in three of five. Written without knowledge of the perception.

Expected before the first picture was judged: every limit of `judge.LIMITS`, which are those of the real set. Seeds
1 to 180 are for looking at; those from 181 on are for judging.
"""
