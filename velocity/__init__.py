"""Range rates and lines of sight from Doppler, and the velocities they give.

`range_rate` turns observations into linear equations in velocity; `least_squares` solves them for
four satellites or more, `ddia` with the attitude's help (`forward_motion`) for one, two or more.
`pairs` does so for millions of pairs at once, `screening` says which to trust, `samples`,
`pair_table` and `statistics` judge them against a reference. `doppler_noise` and `mounting`
calibrate receiver and installation.
"""
