# %% [markdown]
# # A surface by fringes
#
# A projector in the laser's place: a point for each pixel, through hot air, and a map of the error.
#
# The patterns: four steps of three periods along both axes of the projector, 24 frames. Rays are
# traced once for all of them.

# %%
import matplotlib.pyplot as plt
import numpy as np

import virtual_sensor as vs

scene = vs.load_scene("fringe_cylinder", width=512, height=512, pixels=False)
codec = vs.PhaseShift(size_px=scene.projector.size, steps=4, periods_px=(16, 128, 1280))
frames = vs.render_sequence(scene, codec.patterns)
decoded = codec.decode(frames.radiance)
print(decoded)

# %% [markdown]
# Column and row of the projector, with the camera's pixel, give points: first as if light ran
# straight, then along the light that the air has bent.

# %%
straight = vs.reconstruct(scene, decoded)
bent = vs.reconstruct(scene, decoded, medium=scene.medium)


def deviation_um(found):
    """Distance of the points from this part's surface, a cylinder of 13.5 mm."""
    _, y, z = np.moveaxis(found.point_mm, -1, 0)
    return 1000 * (np.hypot(y, z + 13.5) - 13.5)


for name, found in (("straight", straight), ("bent", bent)):
    rms = np.sqrt(np.nanmean(deviation_um(found) ** 2))
    fit = vs.fit_cylinder(found.point_mm.reshape(-1, 3)[::50], direction=(1, 0, 0))
    print(f"{name}: {rms:.3g} µm rms off the part, radius {fit.radius_mm:.4f} mm")

# %% [markdown]
# What shape can't fake: straight light keeps column and row together, on the epipolar line. How far
# a pixel is from it shows the air, and nothing but the air.

# %%
figure, axes = plt.subplots(1, 3, figsize=(10, 3.2), layout="constrained")
for ax, words, image in zip(
    axes,
    ("straight: µm off the part", "bent: µm off the part", "epipolar residual, px"),
    (deviation_um(straight), deviation_um(bent), straight.epipolar_px),
    strict=True,
):
    most = np.nanpercentile(np.abs(image), 99.5)
    drawn = ax.imshow(image, "RdBu_r", vmin=-most, vmax=most)
    ax.set(title=words, xlabel="u, px", ylabel="v, px")
    figure.colorbar(drawn, ax=ax, shrink=0.85)
figure.savefig("fringes.png")
epipolar_px = np.asarray(straight.epipolar_px)
print(f"epipolar residual: {np.sqrt(np.nanmean(epipolar_px**2)):.2f} px rms")
