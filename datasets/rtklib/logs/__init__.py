"""Receivers' own logs in the place of RINEX.

given_files  whatever is given where RINEX is taken
raw_logs     a log as RINEX, and what was found in it
raw_to_rinex RTKLIB's decoders in a process of their own
"""
