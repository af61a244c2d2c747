# %% [markdown]
# # A detector of my own
#
# A function of my own finds the line: how good is it beside the program's detectors?
#
# A detector is a function of the image that gives the line's row in each column, NaN where there is
# none. This one takes the row that has half of the light on either side.

# %%
import matplotlib.pyplot as plt
import numpy as np

import virtual_sensor as vs


def median(image):
    """Row with half of a column's light on either side, within 10 px of the brightest pixel."""
    row = np.full(image.shape[1], np.nan)
    for u, column in enumerate(image.T.astype(float)):
        top = max(column.argmax() - 10, 0)
        light = (column[top : top + 21] - np.median(column)).clip(0)
        if light.max() > 50:  # grey values: there is a line
            above = np.append(0, light.cumsum())  # at the pixels' edges
            row[u] = top - 0.5 + np.interp(above[-1] / 2, above, np.arange(len(above)))
    return row


# %% [markdown]
# An image with noise, of which each pixel knows where the line truly is.

# %%
frame = vs.render_frame(vs.load_scene("hot_cylinder", width=1024, height=1024, line_radius=0.2))
sensor = vs.ImageSensor()  # 12 bits
image = vs.grey_values(frame.radiance, sensor, seed=1, peak_e=4000)

errors = {}
for detector in (median, "gaussian", "centre_of_gravity", "max_likelihood"):
    line = vs.line_centres(image, detector, sensor=sensor)
    name = getattr(detector, "__name__", detector)
    errors[name] = vs.compare_line(line, frame)
    print(f"{name}: {errors[name].count} centres, {errors[name].rms_px:.4f} px rms off the truth")

# %%
figure, panels = plt.subplots(1, 2, figsize=(8, 3.4), sharey=True, layout="constrained")
for axes, name in zip(panels, ("median", "max_likelihood"), strict=True):
    errors[name].plot(axes).set_title(name)
figure.savefig("own_detector.png")
