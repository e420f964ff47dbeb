"""Numba kernels on plain arrays. Import `jit` from `ambler.kernels.jit`; every kernel module has a `warm_up()`."""
