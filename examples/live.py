# %% [markdown]
# # Live navigation
#
# `Navigator` takes IMU samples and GNSS events as they come. Here a simulated drive is played, with
# GNSS arriving 0.2 s after its epoch. What comes out are the batch run's numbers, if that takes the
# noise of GNSS as declared: by itself it fits it to the whole recording, which live data cannot.

# %%
import dataclasses

import numpy as np

from certnav.datasets.simulation.sensors import fixes_from_truth
from certnav.datasets.simulation.simulator import SimulationConfig, simulate
from certnav.filters.earth import C_en_of
from certnav.nav.config import Config
from certnav.nav.config_files import load_config
from certnav.nav.engine.events import GnssEvent
from certnav.nav.navigator import Navigator
from certnav.nav.pipeline import navigate

# %% [markdown]
# An antenna's positions and velocities at 1 Hz; a receiver would deliver these.

# %%
settings = SimulationConfig(seed=5, duration=90.0, density="open")
drive = simulate(settings)
fixes = fixes_from_truth(
    drive.trajectory, settings.start_time + np.arange(0.5, 89.0), settings.lever_antenna_b,
    (1.0, 1.0, 2.0), 0.05, np.random.default_rng(1),
)  # fmt: skip


def events(k: int) -> list[GnssEvent]:
    """Return what the receiver says about its epoch k."""
    t = float(fixes.time[k])
    return [
        GnssEvent(t, "position", fixes.pos_e[k], fixes.pos_cov_e[k]),
        GnssEvent(t, "velocity", fixes.vel_e[k], fixes.vel_cov_e[k]),
    ]


# %% [markdown]
# Until there is an attitude, `state` is None and `waiting` says what for.

# %%
navigator = Navigator(drive.calibration, Config(), imu_interval=0.01)
due, waited_for = 0, ""
for sample in zip(drive.imu.time, drive.imu.gyro_b, drive.imu.accel_b, strict=True):
    navigator.add_imu(*sample)
    while due < len(fixes) and fixes.time[due] + 0.2 <= sample[0]:
        for event in events(due):
            navigator.add_gnss(event)
        due += 1
    if navigator.state is None and navigator.waiting != waited_for:
        waited_for = navigator.waiting
        print(f"{sample[0] - drive.imu.time[0]:5.1f} s  {waited_for}")
navigator.finish()

# %%
state = navigator.state
assert state is not None
truth = drive.reference
k = int(np.searchsorted(truth.time, state.time - 1e-6))
error_n = C_en_of(truth.pos_e[k]).T @ (state.pos_e - truth.pos_e[k])
print("error at the end, north east down [m]:", error_n.round(2))
print(sum(u.accepted for u in navigator.updates), "updates used of", len(navigator.updates))

# %% [markdown]
# The same data as a batch, with the noise as declared, and nothing added to it.

# %%
declared = load_config(None, [
    "gnss.position_noise=declared", "gnss.position_sigma_floor_m=0",
    "gnss.velocity_noise=declared", "gnss.velocity_sigma_floor_mps=0",
])  # fmt: skip
sequence = dataclasses.replace(drive.sequence(fixes), observations=None)
batch = navigate(sequence, declared)
apart = np.abs(batch.trajectory.pos_e[-1] - state.pos_e).max()
print(f"live and batch end {apart:.1e} m apart")
assert apart < 1e-6
assert np.linalg.norm(error_n) < 5.0
