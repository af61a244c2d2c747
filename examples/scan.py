# %% [markdown]
# # A scan by hand
#
# The sensor moves over the part in steps of 1 mm, as on a linear stage: profiles become a cloud of
# points.
#
# A coarser film than the default one makes each profile quick.

# %%
import matplotlib.pyplot as plt
import numpy as np
import trimesh

import virtual_sensor as vs

path = vs.new_scene(
    "bracket.xml",
    part="bracket.stl",
    film="612x512",
    pixel_um=13.8,
    line_length_mm=58,
    overwrite=True,
)
scene = vs.load_scene(path)

profiles = []
for x_mm in np.arange(-19.5, 20):
    moved = scene.with_sensor_moved(vs.Pose.shift([x_mm, 0, 0]))
    line = vs.line_centres(vs.render(moved))
    profiles.append(vs.triangulate(moved, line.pixel))
points_mm = np.concatenate(profiles)
points_mm = points_mm[np.isfinite(points_mm).all(axis=1)]
trimesh.PointCloud(points_mm).export("bracket.ply")
print(f"{len(points_mm)} points of {len(profiles)} profiles are in bracket.ply")

# %% [markdown]
# The base is 6 mm thick, says the drawing, and its countersunk hole is 14 mm wide at the top.

# %%
x, y, z = points_mm.T
base = (abs(z - 6) < 0.02) & (y < 14)
print(f"the base is {z[base].mean():.4f} mm high, with a spread of {1000 * z[base].std():.2f} µm")
print(f"its hole is at least {2 * np.hypot(x, y + 8)[base].min():.2f} mm wide")

# %%
figure, axes = plt.subplots(figsize=(7, 4.5), layout="constrained")
drawn = axes.scatter(y, x, c=z, s=1)
axes.set(xlabel="y along the line, mm", ylabel="x of the sensor, mm", aspect="equal")
figure.colorbar(drawn, label="z, mm")
figure.savefig("scan.png")
