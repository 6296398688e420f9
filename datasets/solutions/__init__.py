"""Results of other programs, and truths in their formats, as one type.

solution        ForeignSolution: time, position, and whatever else a file states, with its σ
reading         read_solution: the format is recognised by the content
rtklib          RTKLIB and GINav ``.pos``, and GINav's truth ``.mat``
trajectories    KF-GINS ``.nav``, GREAT ``.ins`` and ``.flt``, TUM
columns         CSV with named columns: certnav's own, or anybody's
"""
