"""Benchmarks of the program and of its peers (`foldcell bench NAME`), and scripts for the pictures of the docs."""
