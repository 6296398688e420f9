# %% [markdown]
# # One window, one certificate
#
# Range rates of four satellites over twenty seconds and the velocity in the car's own axes
# determine how these axes lie on the Earth. The answer comes with a proof that no other rotation
# fits better, and with verdicts on what the proof does not cover.

# %%
import numpy as np

from certnav.alignment import Ask, ClockModel, align
from certnav.alignment.reference import simulate_window
from certnav.alignment.solver import rotation_angle

rng = np.random.default_rng(7)


def show(title, window, clock="constant"):
    """Align a window and print what may be believed."""
    result = align(window.rows, ClockModel(clock))
    error = np.degrees(rotation_angle(result.C_ew, window.C_ew))
    print(f"{title}: {error:.2f}° from the truth, bound {np.degrees(result.bound):.1f}°")
    for verdict in result.verdicts:
        print(f"    {'✓' if verdict.passed else '✗'} {verdict.name:12} {verdict.message}")
    return result, error


# %% [markdown]
# Hilly road, four satellites, 5 cm/s of noise: everything passes.

# %%
good, error = show("good", simulate_window(rng, 4, "3d", epochs=20, speed=10.0, sigma=0.05))
assert good.passed and error < np.degrees(good.bound)

# %% [markdown]
# The certificate is a lower bound on the cost of *every* rotation. Draw some and look.

# %%
cost = good.problem.cost(good.C_ew)
drawn = [np.linalg.qr(rng.standard_normal((3, 3)))[0] for _ in range(2000)]
drawn = [C * np.sign(np.linalg.det(C)) for C in drawn]
print("lowest of 2000 drawn:", min(good.problem.cost(C) for C in drawn), "at hand:", cost)
assert min(good.problem.cost(C) for C in drawn) >= cost

# %% [markdown]
# Level road and two satellites: two rotations fit equally well, always. The optimum is proved, and
# it is no answer.

# %%
mirror, _ = show("mirror", simulate_window(rng, 2, "2d", epochs=20, speed=10.0, sigma=0.05))
assert mirror.verdict(Ask.OPTIMAL).passed and not mirror.passed

# %% [markdown]
# A drifting clock that the model takes as constant: optimal, unique, wrong. χ² says so.

# %%
window = simulate_window(rng, 4, "3d", epochs=20, speed=10.0, sigma=0.05, clock_rate=0.3)
wrong, _ = show("wrong clock", window)
right, error = show("right clock", window, "linear")
assert not wrong.verdict(Ask.CONSISTENT).passed and right.passed and error < 3.0
