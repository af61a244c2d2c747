# %% [markdown]
# # Noise, and 12 bits in a PNG
#
# How well is the line found in an image with noise, and does the detector know how well?
#
# `render` gives the light that reaches each pixel; `grey_values` makes of it what a camera would
# store: shot noise, read noise, fixed pattern, 12 bits.

# %%
import matplotlib.pyplot as plt
import numpy as np

import virtual_sensor as vs

frame = vs.render_frame(vs.load_scene("hot_cylinder", width=1024, height=1024, line_radius=0.2))
sensor = vs.ImageSensor(gain=0.37, dark_noise_e=2.4, bit_depth=12)  # by EMVA 1288

# %% [markdown]
# The same line with 100 to 10,000 electrons in its brightest pixel. The predicted error is the
# detector's own `sigma`, from the image alone; the true one is the distance to the line that the
# frame knows.

# %%
peaks_e = [100, 300, 1000, 3000, 10_000]
images = [vs.grey_values(frame.radiance, sensor, seed=n, peak_e=n) for n in peaks_e]
true_px, predicted_px = [], []
for peak_e, image in zip(peaks_e, images, strict=True):
    line = vs.line_centres(image, "max_likelihood", sensor=sensor)
    errors = vs.compare_line(line, frame)
    true_px.append(errors.rms_px)
    predicted_px.append(np.sqrt(np.mean(errors.sigma**2)))
    print(
        f"{peak_e} electrons: {errors.count} centres, {true_px[-1]:.3f} px rms off the truth,"
        f" predicted {predicted_px[-1]:.3f} px"
    )

# %% [markdown]
# The last image for other programs: 12 bits in a 16-bit PNG, which says so, with noise and gain.

# %%
path = vs.save_png(images[-1], "line_12bit.png", sensor=sensor)
stored = vs.read_image(path)
print(f"{path}: {stored.pixels.dtype}, grey values {stored.pixels.min()} to {stored.pixels.max()}")
print(f"gain {stored.detector_options['gain']}, noise {stored.detector_options['noise']:.2f}")

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.2), layout="constrained")
left.imshow(images[0], "gray")
left.set(xlim=(440, 580), ylim=(560, 460), xlabel="u, px", ylabel="v, px", title="100 electrons")
right.loglog(peaks_e, true_px, "o", label="true")
right.loglog(peaks_e, predicted_px, label="predicted")
right.set(xlabel="electrons of the brightest pixel", ylabel="error of a centre, px rms")
right.legend()
figure.savefig("camera_noise.png")
