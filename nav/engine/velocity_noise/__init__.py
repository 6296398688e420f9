"""Noise of velocities that fits the recording: of range rates by C/N0, and of ready-made ones.

collected    what velocities differ by from a filter, before it is given them
estimate     the noise that explains that best
fitted       a course with the noise that was found, and what to say of it
"""
