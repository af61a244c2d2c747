# %% [markdown]
# # A hundred training images
#
# Random poses, lines and noise, and for each image the truth: a mask and the line's true rows.
#
# The part is a stepped shaft, whose edges cut the line. The mask has the pixels that the laser
# lights; rows are given where the camera sees the line's whole profile. The same seed gives the
# same files.

# %%
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import virtual_sensor as vs

folder = Path("training_images")
folder.mkdir(exist_ok=True)
rng = np.random.default_rng(seed=1)
scene = vs.load_scene("stepped_shaft", width=256, height=256, spp=4).cold()

# %% [markdown]
# The sensor turns round the shaft, leans any way, and moves by some mm.

# %%
truth = []
for number in range(100):
    turned = vs.Pose.turn(rng.uniform(-15, 15), [1, 0, 0], about_mm=[0, 0, -13.5])
    leaned = vs.Pose.turn(rng.uniform(-5, 5), rng.normal(size=3))
    moved = vs.Pose.shift(rng.uniform([-10, -3, -3], [10, 3, 3]))
    wide = scene.with_parameters(line_radius=rng.uniform(0.2, 0.6))
    frame = vs.render_frame(wide.with_sensor_moved(turned.moved(leaned).moved(moved)))

    sensor = vs.ImageSensor(dark_noise_e=rng.uniform(2, 20))
    grey = vs.grey_values(frame.radiance, sensor, rng, peak_e=10 ** rng.uniform(2, 4))
    vs.save_png(grey, folder / f"{number:03}.png", bits=12)
    vs.save_png(255 * frame.lit, folder / f"{number:03}_mask.png", bits=8)
    row = vs.TrueLine.of_frame(frame).centres().row
    truth += [(number, u, v) for u, v in enumerate(row) if np.isfinite(v)]

np.savetxt(folder / "truth.csv", truth, "%d,%d,%.4f", header="image,column,row", comments="")
images = len({number for number, _, _ in truth})
print(f"{images} images with a line, {len(truth)} true rows in {folder}/truth.csv")

# %%
figure, panels = plt.subplots(2, 4, figsize=(8, 4.2), layout="constrained")
table = np.array(truth)
for number, (above, below) in enumerate(panels.T):
    image = vs.read_image(folder / f"{number:03}.png").pixels
    above.imshow(image, "gray", vmax=np.percentile(image, 99.8))
    below.imshow(vs.read_image(folder / f"{number:03}_mask.png"), "gray")
    below.plot(*table[table[:, 0] == number, 1:].T, "r.", ms=1)
    above.set_axis_off()
    below.set_axis_off()
figure.savefig("training_images.png")
