"""Noise of positions that fits the recording: how large, how much of it shared, for how long.

likelihood   how well errors of a scale, share and correlation time explain innovations
estimate     the scale, share and time that explain them best
loose        the innovations of a filter that goes by velocities alone
fitted       positions with the noise that was found, and what to say of it
"""
