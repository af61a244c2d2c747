# %% [markdown]
# # A field of my own
#
# Air from a formula: checked against a closed form, then put under the sensor.
#
# A field of air is an array: n - 1 at the nodes of a grid. Here it is a ball of hot air, for which
# the angle by which it bends a ray can be worked out.

# %%
import matplotlib.pyplot as plt
import numpy as np

import virtual_sensor as vs

cool, warm = vs.air_refractivity(temperature_c=[20.0, 600.0])
sigma_mm, spacing_mm = 8.0, 2.0
axis = np.arange(-80.0, 80.1, spacing_mm)  # the ball has faded there, and the part is within
x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
ball = np.exp(-(x**2 + y**2 + z**2) / (2 * sigma_mm**2))
field = vs.IndexField.from_arrays(
    cool + (warm - cool) * ball, [-80.0] * 3, [spacing_mm] * 3, ambient=cool
)

# %% [markdown]
# Rays that pass the middle at a distance b, along x, turn away from the hot air by
# √(2π) Δn b/σ exp(-b²/2σ²), to the first order in Δn: the integral of the gradient across the ray.

# %%
b = np.linspace(-30.0, 30.0, 61)
starts = np.stack([np.full(61, -44.0), 0 * b, b], axis=1)
rays = vs.trace(field, starts, [1.0, 0.0, 0.0], 88.0)
traced = 1e6 * rays.direction[:, 2]
b_sigma = b / sigma_mm
formula = 1e6 * np.sqrt(2 * np.pi) * (cool - warm) * b_sigma * np.exp(-(b_sigma**2) / 2)
print(f"largest angle: {traced.max():.1f} µrad")
print(f"traced minus closed form: at most {np.abs(traced - formula).max():.2g} µrad")

# %% [markdown]
# The same ball beside the laser of a sensor, 60 mm above the part: how far does the profile move?
# Where light crosses the field's border, the field must have faded to the air around: a jump there
# would bend light too, and above 0.1 px it is refused.

# %%
cold = vs.load_scene("cold_cylinder")
hot = cold.with_medium(field.moved(vs.Pose.shift([-25.0, 8.0, 60.0])))
profile, moved = (vs.triangulate(s, vs.line_centres(vs.render(s)).pixel) for s in (cold, hot))
shift_um = 1000 * (moved - profile)[:, 2]
print(f"the profile rises by {np.nanmin(shift_um):.1f} to {np.nanmax(shift_um):.1f} µm")

# %% [markdown]
# Saved, it serves the commands as well:
# `virtual-sensor measure hot_cylinder -D field=ball.nc -D temperature=600`.

# %%
hot.medium.save("ball.nc")

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.2), layout="constrained")
left.plot(b, formula, label="closed form")
left.plot(b, traced, ".", label="traced")
left.set(xlabel="b, mm", ylabel="angle, µrad")
left.legend()
right.plot(profile[:, 1], shift_um)
right.set(xlabel="y along the line, mm", ylabel="shift of the measured profile, µm")
figure.savefig("own_field.png")
