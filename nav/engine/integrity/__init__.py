"""Bounds of the position error at a stated risk.

responses   what one wrong sensor has done to the solution
levels      the bounds that follow
placed      beside the trajectory, with what they stand for
"""
