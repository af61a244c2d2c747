# %% [markdown]
# # Correct a profile
#
# How much of the error of hot air does a correction take away, and how well must the air be known?
#
# Hot air bends the laser and the camera's lines of sight. `triangulate` follows both through the
# air that it is given.

# %%
import matplotlib.pyplot as plt
import numpy as np

import virtual_sensor as vs

scene = vs.load_scene("hot_cylinder", temperature=1250)
line = vs.line_centres(vs.render(scene))

# %% [markdown]
# Three profiles from the same image: as if light ran straight, through the air that was there, and
# through that of a part 150 K colder, as if the temperature had been misjudged.

# %%
guess = vs.load_scene("hot_cylinder", temperature=1100).medium
profiles = {
    "straight": vs.triangulate(scene, line.pixel),
    "through air of 1100 °C": vs.triangulate(scene, line.pixel, medium=guess),
    "through the true air, 1250 °C": vs.triangulate(scene, line.pixel, medium=scene.medium),
}

# %% [markdown]
# The true surface is a cylinder of radius 13.5 mm, whose axis lies 13.5 mm below the origin.

# %%
figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
for name, points_mm in profiles.items():
    _, y, z = points_mm.T
    error_um = 1000 * (np.hypot(y, z + 13.5) - 13.5)
    rms_um, largest_um = np.sqrt(np.nanmean(error_um**2)), np.nanmax(np.abs(error_um))
    print(f"{name}: {rms_um:.3g} µm rms off the surface, at most {largest_um:.3g} µm")
    axes.plot(y, error_um, label=name)
axes.set(xlabel="y along the line, mm", ylabel="measured minus true radius, µm")
axes.legend()
figure.savefig("correct_profile.png")
