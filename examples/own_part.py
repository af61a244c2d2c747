# %% [markdown]
# # A part of my own
#
# From a CAD file and a lens to measured points, in five lines.
#
# `part` is your own file: STL, OBJ, PLY or 3MF. Here it is an angle bracket of 40 x 60 x 30 mm that
# comes with the program. The scene is written beside a copy of it, for you to read and change. The
# sensor stands over the part's top; what isn't said of it is chosen so that it suits the part.

# %%
import matplotlib.pyplot as plt
import numpy as np

import virtual_sensor as vs

path = vs.new_scene(
    "bracket.xml", part="bracket.stl", focal_length_mm=35, line_length_mm=58, overwrite=True
)
scene = vs.load_scene(path)
frame = vs.render_frame(scene)
line = vs.line_centres(frame.radiance)
points_mm = vs.triangulate(scene, line.pixel)
print(line)

# %% [markdown]
# Two figures that are on the drawing: how high the upright is above the base, 24 mm, and the radius
# of the fillet between them, 8 mm.

# %%
_, y, z = points_mm.T
base, upright = np.nanmedian(z[(y > -25) & (y < -17)]), np.nanmedian(z[(y > 25) & (y < 28.5)])
print(f"the upright stands {upright - base:.4f} mm above the base")

fillet = (y > 17) & (y < 23)
a, b, c = np.linalg.lstsq(
    np.stack([2 * y, 2 * z, np.ones_like(y)], axis=1)[fillet], (y**2 + z**2)[fillet]
)[0]  # a circle through the points
print(f"the fillet has a radius of {np.sqrt(c + a**2 + b**2):.3f} mm")

# %%
figure, (left, middle, right) = plt.subplots(1, 3, figsize=(10, 3.2), layout="constrained")
scene.plot(left).set_title("the sensor")
frame.plot(middle).set_title("what the camera sees")
right.plot(y, z, ".", ms=1)
right.set(xlabel="y in mm", ylabel="z in mm", title="what it measures", aspect="equal")
figure.savefig("own_part.png")
