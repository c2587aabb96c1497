"""Benchmarks of the program and of other programs, its peers (`foldcell bench NAME`), and scripts that make the
pictures of the docs."""
