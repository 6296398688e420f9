"""What alignment is compared with: the semidefinite program, VOBA, Gauss–Newton, simulation."""
