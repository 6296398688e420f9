# %% [markdown]
# # Your own CSV files
#
# Two tables as a logger writes them, with column names of its own: a draft of the declaration, its
# blanks filled in, a check, a run. `docs/own_data.md` explains every key.

# %%
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd

from certnav.datasets.loading import load
from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.earth import C_en_of, ecef_to_lla
from certnav.filters.errors import NavError
from certnav.nav.check.recording import check
from certnav.nav.config import Config
from certnav.nav.drafting import measured_draft
from certnav.nav.pipeline import navigate

folder = Path(tempfile.mkdtemp()) / "drive"
folder.mkdir()

# %% [markdown]
# The files: an IMU in forward-left-up axes and deg/s, a receiver's positions; seconds of a GPS week
# that no file names.

# %%
settings = SimulationConfig(seed=3, duration=90.0, density="open")
drive = simulate(settings)
flu = np.array([1.0, -1.0, -1.0])
sow = drive.imu.time % 604800.0
imu = np.column_stack([sow, np.degrees(drive.imu.gyro_b * flu), drive.imu.accel_b * flu])
columns = ["sow", "rot_x", "rot_y", "rot_z", "acc_x", "acc_y", "acc_z"]
pd.DataFrame(imu, columns=columns).to_csv(folder / "imu.csv", index=False, float_format="%.6f")

time = settings.start_time + np.arange(1.0, 89.0)
fixes = fixes_from_truth(
    drive.trajectory, time, settings.lever_antenna_b, (1.0, 1.0, 2.0), 0.05,
    np.random.default_rng(1),
)  # fmt: skip
vel_n = np.einsum("nji,nj->ni", C_en_of(fixes.pos_e), fixes.vel_e)
lla = ecef_to_lla(fixes.pos_e)
gnss = np.column_stack([time % 604800.0, np.degrees(lla[:, :2]), lla[:, 2], vel_n])
columns = ["sow", "lat", "lon", "height", "v_north", "v_east", "v_down"]
pd.DataFrame(gnss, columns=columns).to_csv(folder / "gps.csv", index=False, float_format="%.9f")

# %% [markdown]
# `certnav declare drive/*.csv`: what names, numbers and the motion show is filled in with its
# evidence, down to how far forward and right of the IMU the antenna is; the rest is `"?"`.

# %%
draft = measured_draft(sorted(folder.glob("*.csv")))
print(draft.text())

# %% [markdown]
# A blank is refused with its line.

# %%
declaration = folder / "sequence.toml"
declaration.write_text(draft.text())
try:
    load(folder)
except NavError as refusal:
    print(refusal)

# %% [markdown]
# Only the user knows these.

# %%
answers = {
    "preset": '"adis16470"',
    "lever_frd_m": "[-0.65, -0.05, -0.15]",
    "lever_sigma_m": "0.02",  # by a tape, all three
    "height": '"ellipsoid"',
    "position_sigma_m": "[1.0, 1.0, 2.0]",
    "velocity_sigma_mps": "[0.05, 0.05, 0.05]",
}
lines = []
for line in draft.text().splitlines():
    key = line.partition(" = ")[0]
    lines.append(f"{key} = {answers[key]}" if key in answers else line)
declaration.write_text("\n".join(lines) + "\n")
report = check(folder)
print(report.text())
assert report.navigable

# %%
solution = navigate(load(folder), Config())
track = solution.trajectory
truth_time = drive.reference.time % 604800.0  # as the files' clock, which has no date, counts
truth = np.column_stack([np.interp(track.time, truth_time, p)
                         for p in drive.reference.pos_e.T])  # fmt: skip
error = np.linalg.norm(track.pos_e - truth, axis=1)
print(f"{track.time[-1] - track.time[0]:.0f} s navigated, error {np.median(error):.2f} m (median)")
assert np.median(error) < 2.0
