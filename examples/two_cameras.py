# %% [markdown]
# # Two cameras
#
# One laser, a camera on either side of it: what one can't see, the other one can.
#
# The line lies across a gear blank, on its rim, its hub and the web between them. Rim and hub hide
# parts of the web. `alpha` has an angle for each camera.

# %%
import matplotlib.pyplot as plt
import numpy as np

import virtual_sensor as vs

path = vs.new_scene(
    "gear.xml",
    part="gear_blank.stl",
    alpha=(35, -35),
    at_mm=(14, 0, 20),
    line_length_mm=52,
    overwrite=True,
)
scene = vs.load_scene(path)

# %% [markdown]
# Each camera's image gives a profile. The points of both are in the same world: they are joined as
# they are.

# %%
profiles = {}
for camera in scene.cameras:
    line = vs.line_centres(vs.render(scene, camera=camera))
    points_mm = vs.triangulate(scene, line.pixel, camera=camera)
    profiles[camera] = points_mm[np.isfinite(points_mm).all(axis=1)]
joined = np.concatenate(list(profiles.values()))

for name, points_mm in {**profiles, "both": joined}.items():
    count, _ = np.histogram(points_mm[:, 1], np.linspace(-26, 26, 209))
    print(f"{name}: {len(points_mm)} points, on {np.mean(count > 0):.0%} of the line's 52 mm")

# %%
figure, panels = plt.subplots(2, 1, figsize=(7, 4.5), sharex=True, layout="constrained")
for axes, (name, points_mm) in zip(panels, profiles.items(), strict=True):
    axes.plot(*joined[:, 1:].T, ".", color="0.8", ms=1)
    axes.plot(*points_mm[:, 1:].T, ".", ms=1)
    axes.set(ylabel="z, mm", title=f"what {name} sees")
panels[1].set_xlabel("y along the line, mm")
figure.savefig("two_cameras.png")
