"""Loops that numba compiles: strapdown and covariance, recorded rows, and the compiler itself."""
