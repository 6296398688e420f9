"""What certnav is held against, and what it is broken with, for tests and for ``scripts/``.

Independent computations: `derivatives` of measurement models by differences, `bends` in closed
form, `attacks` on a certificate with what rotations cost in them. Sound recordings: `recordings`,
`drives` and `declarations` (a drive in every form readers know), `seeds` and `readers` (small ones,
and how each is read). Damage: `broken_copies` (what ``certnav check`` has to name), `faults` (in
the middle of a drive, made of `imu_breaks` and `gnss_breaks`), both with `damage` to files;
`mutations` and `cases` at random, `units` taken for others.
"""
