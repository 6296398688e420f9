"""What certnav is held against, and what it is broken with, for tests and for ``scripts/``.

Sound recordings are `recordings`, `drives` and `declarations` (a drive in every form readers know),
`seeds` and `readers` (small ones, and how each is read). They are damaged by `broken_copies` (what
``certnav check`` has to name), `faults` (in the middle of a drive), `mutations` and `cases` (at
random) and `units`.
"""
