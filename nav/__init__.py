"""Navigation runs: from files to a solution, its evaluation and its report.

Conventions, stated here once and kept throughout
-------------------------------------------------
Frames
    i inertial, e ECEF, n north-east-down, b body = IMU (forward, right, down), v vehicle
    (forward, right, down, at the point the wheels constrain), w local world (the body frame at a
    window's start), a antenna.
Vectors and rotations
    ``pos_e``, ``vel_e``, ``lever_b``: a vector in that frame. ``C_eb @ x_b == x_e``.
Attitude
    Roll: right side down +. Pitch: nose up +. Heading: clockwise from true north.
Units
    SI and radians. Degrees, deg/h and mg only in files, configuration, command line and reports,
    and then in the name: ``heading_deg``.
Time
    GPS seconds since the GPS epoch (week · 604800 + seconds of week), float64, no leap seconds.
Satellites
    Line of sight: unit vector from receiver to satellite. Doppler is positive when approaching;
    range rate = −λ·D is positive when receding.
Errors of the filter
    True − estimated; see `filters.error_model`.
"""
