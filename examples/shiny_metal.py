# %% [markdown]
# # Shiny metal
#
# Bare metal throws the laser where a mirror would: how much of the line is left, and which detector
# makes the most of it?
#
# On a round part, a rod of 27 mm, the light leaves a glaring spot and dark ends.

# %%
import matplotlib.pyplot as plt

import virtual_sensor as vs

scenes = {}
for name, roughness in {"paint": None, "dull iron": 0.4, "shiny iron": 0.1}.items():
    path = vs.new_scene(
        f"{name}.xml", diameter_mm=27, line_length_mm=22, roughness=roughness, overwrite=True
    )
    scenes[name] = vs.load_scene(path)

# %% [markdown]
# Each image is so exposed that its brightest pixel just stays below what the camera can hold.

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
