"""What commands have in common: recordings from their folders to results.

navigation    one recording to its result directory
dataset       many recordings through everything there is, one failure costing no other
site          what came of it: tables, an index, all of it as LaTeX
"""
