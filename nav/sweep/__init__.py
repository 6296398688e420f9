"""Much at once: threads, the processors of this machine, or a cluster.

parallel      in_order, in_parallel
shared        what many calls have in common
cluster       the same on Dask
drives        recordings by where they lie, loaded where they are needed
"""
