# %% [markdown]
# # A lens, speckle, noise, and 12 bits in a PNG
#
# How well is the line found in a frame as a camera stores it, and does the detector know how well?
#
# `render_frame` gives the light that reaches each pixel through the lens; `record` makes of it what
# the camera stores: shot noise, read noise, fixed pattern, 12 bits, and speckle if it is asked for.

# %%
import matplotlib.pyplot as plt
import numpy as np

import virtual_sensor as vs

scene = vs.load_scene(
    "cold_cylinder", width=1024, height=1024, line_radius=0.2, f_number=8, linewidth=2, rq=30
)
frame = vs.render_frame(scene)
sensor = vs.ImageSensor(gain=0.37, dark_noise_e=2.4, bit_depth=12)  # by EMVA 1288
print(scene.camera.lens)

# %% [markdown]
# The same line, exposed to 1 to 90 % of the saturation. The predicted error is the detector's own
# `sigma`, from the image alone; the true one is the distance to the line that the frame knows.

# %%
peaks = [0.01, 0.03, 0.1, 0.3, 0.9]
shots = [vs.record(scene, frame, seed=n, sensor=sensor, peak=p) for n, p in enumerate(peaks)]
true_px, predicted_px = [], []
for peak, shot in zip(peaks, shots, strict=True):
    line = vs.line_centres(shot, "max_likelihood")  # knows gain, noise, saturation
    errors = vs.compare_line(line, shot)
    true_px.append(errors.rms_px)
    predicted_px.append(np.sqrt(np.mean(errors.sigma**2)))
    print(
        f"{peak:.0%} of the saturation: {errors.count} centres, {true_px[-1]:.3f} px rms off the"
        f" truth, predicted {predicted_px[-1]:.3f} px"
    )

# %% [markdown]
# Laser light on a rough surface is grainy, which no detector sees from its noise. More light does
# not help.

# %%
speckled = [
    vs.record(scene, frame, seed=n, sensor=sensor, peak=p, speckle=True)
    for n, p in enumerate(peaks)
]
found = [vs.compare_line(vs.line_centres(s, "centre_of_gravity"), s) for s in speckled]
speckled_px = [errors.rms_px for errors in found]
print(f"with speckle, 90 %: {found[-1].count} centres, {speckled_px[-1]:.3f} px rms off the truth")

# %% [markdown]
# The last shot for other programs: 12 bits in a 16-bit PNG, which says so. It also tells its gain,
# noise and saturation to `read_image` and to `virtual-sensor detect line_12bit.png`.

# %%
path = shots[-1].write("line_12bit.png")
stored = vs.read_image(path)
print(f"{path}: {stored.pixels.dtype}, grey values {stored.pixels.min()} to {stored.pixels.max()}")
print(f"gain {stored.detector_options['gain']}, noise {stored.detector_options['noise']:.2f}")

# %%
figure, axes = plt.subplots(1, 3, figsize=(9.6, 3.2), layout="constrained")
for left, each, title in zip(
    axes, (shots[0], speckled[-1]), ("1 %", "speckle, 90 %"), strict=False
):
    left.imshow(each.grey, "gray")
    left.set(xlim=(480, 580), ylim=(535, 495), xlabel="u, px", ylabel="v, px", title=title)
axes[2].loglog(peaks, speckled_px, "s", label="true, with speckle")
axes[2].loglog(peaks, true_px, "o", label="true")
axes[2].loglog(peaks, predicted_px, label="predicted")
axes[2].set(xlabel="brightest pixel by saturation", ylabel="error of a centre, px rms")
axes[2].set(ylim=(2e-3, 0.5))
axes[2].legend(loc="lower left")
figure.savefig("camera.png")
