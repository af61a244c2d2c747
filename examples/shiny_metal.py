# %% [markdown]
# # Shiny metal
#
# Bare metal throws the laser where a mirror would: how much of the line is left, and which detector
# makes the most of it?
#
# On a round part, a rod of 27 mm, the light leaves a glaring spot and dark ends.

# %%
import matplotlib.pyplot as plt
import numpy as np

import virtual_sensor as vs

scenes = {}
for name, roughness in {"paint": None, "dull iron": 0.4, "shiny iron": 0.1}.items():
    path = vs.new_scene(
        f"{name}.xml", diameter_mm=27, line_length_mm=22, roughness=roughness, overwrite=True
    )
    scenes[name] = vs.load_scene(path)

# %% [markdown]
# Each image is so exposed that its brightest pixel just stays below what the camera can hold: the
# dark ends of the line drown in noise.

# %%
sensor = vs.ImageSensor()
figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
for name, scene in scenes.items():
    frame = vs.render_frame(scene)
    image = vs.grey_values(frame.radiance, sensor, seed=1, peak_e=9000)
    for detector in ("parabola", "gaussian", "centre_of_gravity", "max_likelihood"):
        errors = vs.compare_line(vs.line_centres(image, detector, sensor=sensor), frame)
        found = errors.count / errors.expected
        print(f"{name}, {detector}: {found:.0%} of the line found, {errors.rms_px:.3f} px rms off")
    y = vs.triangulate(scene, vs.TrueLine.of_frame(frame).centres().pixel)[:, 1]
    axes.semilogy(y, image.max(axis=0), label=name)

# %%
axes.set(xlabel="y along the line, mm", ylabel="brightest grey value of each column")
axes.legend()
figure.savefig("shiny_metal.png")

# %% [markdown]
# Exposed longer, the glaring spot clips. There the centre comes from what is left of the profile:
# the status is CLIPPED, the predicted error larger. The rest of the line has light enough now.

# %%
frame = vs.render_frame(scenes["shiny iron"])
for times in (1, 4, 16, 64):
    image = vs.grey_values(frame.radiance, sensor, seed=1, peak_e=9000 * times)
    line = vs.line_centres(image, "max_likelihood", sensor=sensor)
    errors = vs.compare_line(line, frame)
    clipped = (line.status == vs.Status.CLIPPED).sum() / line.found.sum()
    print(f"{times} times: {line.found.sum()} centres, {clipped:.0%} of them clipped,")
    print(f"    {errors.rms_px:.3f} px rms off, predicted {np.nanmedian(errors.sigma):.3f} px")

# %% [markdown]
# In a groove each wall reflects the line to the other. `max_depth=3` adds the light that is
# reflected once more: `frame.indirect` is its layer, and the truth says which centres it shifts.

# %%
size = {"width": 512, "height": 512, "line_radius": 0.2}
for roughness in (0.5, 0.2):
    steel = {"material": "ground_steel", "roughness": roughness}
    frame = vs.render_frame(vs.load_scene("v_groove", max_depth=3, **steel, **size))
    assert frame.indirect is not None  # it is None where max_depth is 2
    image = vs.grey_values(frame.radiance, sensor, seed=1, peak_e=90_000)
    line = vs.line_centres(image, "max_likelihood", sensor=sensor)
    errors = vs.compare_line(line, frame, end_px=3.0)
    column = errors.column.astype(int)
    ghost, direct = (layer.max(axis=0)[column] for layer in (frame.indirect[0], frame.direct))
    print(f"roughness {roughness}: {errors.count / errors.expected:.0%} of the line found,")
    share, wrong = np.median(ghost / direct), errors.wrong().sum()
    print(f"    reflected light {share:.1%} of the line's; {wrong} centres wrong")
