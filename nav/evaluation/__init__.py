"""A solution held against a reference, and its covariance against its errors."""
