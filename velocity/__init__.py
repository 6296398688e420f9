"""Range rates and lines of sight from Doppler, and the velocities they give.

`range_rate` turns observations into linear equations in velocity, `least_squares` solves them
for four satellites or more.
"""
