"""The decorator of functions that only compiled code calls. It leaves out the conversions between Python's and
numba's values, a fifth of the time to compile the loop: a tuple of arrays has hundreds of values to convert."""

from functools import partial

from numba import njit

inner = partial(njit, nogil=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)
