# %% [markdown]
# # A sweep on Dask
#
# How does the error of hot air depend on the part's temperature, and on how the sensor stands?
#
# Each case is a whole measurement with frames, tables and a page. A cluster of two processes on
# this machine shares them; it needs `pip install 'virtual-sensor[cluster]'`.

# %%
from pathlib import Path

import matplotlib.pyplot as plt
from dask.distributed import LocalCluster

from virtual_sensor.reporting import measure, sweep
from virtual_sensor.studies.sweep import plan, run
from virtual_sensor.studies.sweep_table import results

folder = Path("swept")


def main():
    cases = plan(
        "hot_cylinder",
        {
            "temperature": [900, 1100, 1250],  # degC
            "beta": [0, 15],  # degrees round the part
            **{"width": 256, "height": 256, "line_radius": 0.8},
        },
    )
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        finished = run(cases, folder, measure.save, cluster.scheduler_address)
    swept = results(finished, folder)
    sweep.save(swept, folder, "python dask_sweep.py")
    return swept.table


# %% [markdown]
# A second run finds the finished cases and takes no time. `swept/report.html` is the page of all.
# Turned by 15 degrees, the sensor looks past the hot air that rises from the part.

# %%
if __name__ == "__main__":  # the workers read this file too
    table = main()
    rows = table.to_dataframe()
    print(rows[["temperature", "beta", "status", "hot_section_rms_um"]].to_string(index=False))
    figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
    for beta, some in rows.groupby("beta"):
        axes.plot(some.temperature.astype(float), some.hot_section_rms_um, "o-", label=f"{beta}°")
    axes.set(xlabel="temperature of the part, °C", ylabel="measured minus true section, µm rms")
    axes.legend(title="beta")
    figure.savefig("dask_sweep.png")
