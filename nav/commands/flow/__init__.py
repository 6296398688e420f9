"""What commands have in common: recordings from their folders to results.

first_run     the kernels of a run compiled before it, by several processes
navigation    one recording to its result directory
dataset       many recordings through everything there is, one failure costing no other
site          what came of it: tables, an index, all of it as LaTeX
"""
