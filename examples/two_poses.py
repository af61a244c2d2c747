# %% [markdown]
# # Two poses make the air visible
#
# The radius of a hot cylinder to a micrometre or two, through air that nobody knows.
#
# One laser line mixes shape and air: another radius and another plume bend it much alike. Air stays
# with the part while the sensor turns, and from a second pose it does something else to the line.
#
# The pictures: a part at 1250 °C whose plume is blurred by 2 mm, as the sensor's camera records it
# with its noise, from above and turned by 15 and by 30 degrees.

# %%
import matplotlib.pyplot as plt
import numpy as np

import virtual_sensor as vs

lines = {}
for beta in (0, 15, 30):
    hot = vs.load_scene("hot_cylinder", temperature=1250, blur=2, beta=beta)
    image = vs.grey_values(vs.render(hot), seed=beta, peak_e=4000)
    lines[beta] = vs.line_centres(image, "max_likelihood", sensor=vs.ImageSensor())

# %% [markdown]
# What is assumed: where the sensor stood, that the part is a cylinder of any radius in any place,
# and air of another kind: that of a part at 1100 °C, with a scale and a width to be found.

# %%
air = vs.IndexField.read("hot_cylinder_1100C_quarter")
cylinder = vs.CylinderShape(radius_mm=13.0, y_mm=0.0, z_mm=-13.0)


def estimate(*betas):
    seen = [vs.Observation(vs.load_scene("hot_cylinder", beta=b), lines[b]) for b in betas]
    free = ("radius_mm", "y_mm", "z_mm")
    return vs.estimate_air(seen, air, ("scale", "width"), shape=cylinder, free=free)


figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
for betas in ((0,), (0, 15), (0, 30)):
    found = estimate(*betas)
    wrong, noise = (1000 * n for n in (found["radius_mm"] - 13.5, found.sigma_of("radius_mm")))
    name = f"beta {' and '.join(map(str, betas))}"
    print(f"{name}: radius wrong by {wrong:+.1f} µm, by noise alone ± {2 * noise:.1f} µm;", end=" ")
    print(f"residual {found.rms_px:.3f} px rms")
    _, y, z = found.points[0].point_mm.T
    axes.plot(y, 1000 * (np.hypot(y, z + 13.5) - 13.5), ".", markersize=2, label=name)
axes.set(xlabel="y along the line, mm", ylabel="corrected minus true radius, µm")
axes.legend(title="air found from", markerscale=4)
figure.savefig("two_poses.png")
print(found.notes[-1])

# %% [markdown]
# What is left in the image says nothing of the radius: from one pose it is the least, and the
# radius the most wrong. From two poses the part is right though the air is not: no scale and no
# width make this plume of that field, as the note says.
