# %% [markdown]
# # A first run
#
# A drive is simulated, written in the layout of the GREAT dataset, read back, navigated and judged.
# What the last cells do works with any recording that `datasets.loading.load` reads.

# %%
import tempfile
from pathlib import Path

import matplotlib

matplotlib.use("Agg")  # a file, no window
import matplotlib.pyplot as plt
import numpy as np

from certnav.datasets.great.writer import simulate_folder
from certnav.datasets.loading import load
from certnav.datasets.simulation.simulator import SimulationConfig
from certnav.nav.check.recording import check
from certnav.nav.config_files import load_config
from certnav.nav.evaluation.accuracy import evaluate
from certnav.nav.pipeline import navigate
from certnav.nav.results.directory import read_result, write_result

work = Path(tempfile.mkdtemp())

# %% [markdown]
# Two minutes of driving in a suburb: RINEX observations and navigation, IMU text, reference.

# %%
folder = simulate_folder(SimulationConfig(seed=2, duration=120.0, density="suburb"), work / "drive")
print(check(folder).text())

# %% [markdown]
# Configuration values are those of `docs/configuration.md`; `load_config` also takes a file.

# %%
sequence = load(folder)
config = load_config(None, ["gnss.min_cn0_dbhz=38", "alignment.method=level+course"])
solution = navigate(sequence, config)
print(solution.alignment.message)
print(*solution.notes, sep="\n")

# %% [markdown]
# Errors are solution − reference; the filter says itself how large they may be.

# %%
evaluation = evaluate(solution, sequence)
for name in ("horizontal_rms_m", "horizontal_max_m", "heading_rms_deg"):
    print(f"{name:20} {evaluation.metrics[name]:.2f}")
print("position NEES", f"{evaluation.consistency['nees_position_mean']:.1f}", "(3 is right)")
refused = [u for u in solution.updates if not u.accepted]
print(len(refused), "updates were not used:", {u.reason for u in refused})

# %%
time = evaluation.time - evaluation.time[0]
error = np.hypot(*evaluation.error_pos_n[:, :2].T)
sigma3 = 3.0 * np.hypot(*evaluation.sigma_pos_n[:, :2].T)
figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
axes.plot(time, error, color="#0072B2", label="horizontal error")
axes.plot(time, sigma3, color="#D55E00", label="3σ of the filter")
axes.set(xlabel="time since the start [s]", ylabel="[m]")
axes.legend(frameon=False)
figure.savefig(work / "error.png")

# %% [markdown]
# A result directory holds everything, and reads back.

# %%
out = write_result(work / "result", solution, evaluation, sequence, config, ("pos",))
print(sorted(p.name for p in out.iterdir()))
assert read_result(out).evaluation.metrics == evaluation.metrics
