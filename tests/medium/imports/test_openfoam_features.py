"""OpenFOAM's cases: what the reader's table says of each feature is done."""

import gzip
import json
import re
import shutil

import numpy as np
import plume_files as plume
import pytest
from import_checks import X, Y, Z, imported, refused, same, table_of
from plume_files import lattice

from virtual_sensor.medium.heat_flow.case import setup_record
from virtual_sensor.medium.heat_flow.setup import HeatFlow
from virtual_sensor.medium.imports.import_field import Choices, of_own_case
from virtual_sensor.medium.imports.meshes import read_openfoam


def foam_case(folder, **options):
    return plume.write_openfoam(folder / "case", lattice(X, Y, Z), **options)


def foam_forms(folder):
    same(imported(foam_case(folder, processors=2)), (4, 6, 5))
    shutil.rmtree(folder / "case")
    case = foam_case(folder)
    same(imported(case), (4, 6, 5))
    for file in [*(case / "constant" / "polyMesh").iterdir(), case / "0.5" / "T"]:
        (file.parent / f"{file.name}.gz").write_bytes(gzip.compress(file.read_bytes()))
        file.unlink()
    same(imported(case), (4, 6, 5))


def foam_collated(folder):
    case = foam_case(folder)
    (case / "processors4" / "0.5").mkdir(parents=True)
    made = imported(case)
    same(made, (4, 6, 5))
    assert any("processors4: OpenFOAM's collated form is not read" in n for n in made.notes)
    shutil.rmtree(case / "0.5")
    refused(case, "collated form .*reconstructPar")


def foam_times(folder):
    case = foam_case(folder, times=("0.5", "2"))
    assert "t = 2 s" in imported(case).quantity.attributes["source"]
    assert "t = 0.5 s" in imported(case, time_s=0.5).quantity.attributes["source"]
    refused(case, "there is no time 1 s; the last ones are 0.5, 2", time_s=1.0)


def foam_regions(folder):
    case, nodes = folder / "case", lattice(X, Y, Z)
    for i, name in enumerate(("air", "heater")):
        region = plume.write_openfoam(folder / name, np.add(nodes, [0, 0, 100 * i]))
        for part in ("constant", "0.5"):
            (case / part).mkdir(parents=True, exist_ok=True)
            shutil.move(region / part, case / part / name)
    shutil.move(folder / "air" / "system", case / "system")
    refused(case, "holds 2 regions, air, heater; name that of the air with --region")
    refused(case, "no such region; there are: air, heater", region="water")
    same(imported(case, region="air"), (4, 6, 5))
    assert imported(case, region="heater").quantity.origin_mm[2] == pytest.approx(104)
    properties = "FoamFile { version 2.0; format ascii; class dictionary; object r; }\n"
    properties += "regions ( /* fluid (heater) */ fluid (air) solid (heater) );\n"
    (case / "constant" / "regionProperties").write_text(properties)
    made = imported(case)
    same(made, (4, 6, 5))
    assert "region air" in made.quantity.attributes["source"]
    refused(foam_case(folder / "one"), "has one region; leave --region out", region="air")


def foam_ignored(folder):
    case = foam_case(folder)
    text = (case / "0.5" / "T").read_text()
    text = re.sub(r"^(\d+\.?\d*)$", r"(\1 0 0)", text, flags=re.M).replace("(120 0 0)", "120")
    text = text.replace("volScalarField", "volVectorField").replace("<scalar>", "<vector>")
    (case / "0.5" / "U").write_text(text.replace("object T", "object U"))
    made = imported(case)
    same(made, (4, 6, 5))
    assert any("U [K] (3 components)" in note for note in made.notes)


FOAM = {
    "reconstructed": foam_forms,
    "decomposed, processor0 ...": foam_forms,
    "decomposed, processors4": foam_collated,
    "ASCII, binary, compressed": foam_forms,
    "times": foam_times,
    "dimensions": foam_times,
    "one region": foam_times,
    "several regions": foam_regions,
    "volScalarField": foam_times,
    "vectors, tensors": foam_ignored,
    "patches, particles, sets": foam_ignored,
}


@pytest.mark.parametrize("check", dict.fromkeys(FOAM.values()))
def test_openfoam_is_read_as_its_table_says(check, tmp_path):
    """Rationale: the reader's docstring is a promise."""
    pytest.importorskip("pyvista", reason="the extra virtual-sensor[fields] is absent")
    assert set(FOAM) == set(table_of(read_openfoam))
    check(tmp_path)


def test_a_case_of_ours_says_itself_what_it_is(tmp_path):
    """Rationale: its import needs no option; what the user says, holds."""
    folder = tmp_path / "air.case"
    folder.mkdir()
    flow = HeatFlow(900.0, section=True, ambient_c=15.0)
    (folder / "setup.json").write_text(json.dumps(setup_record(flow)))
    known = of_own_case(folder, Choices())
    assert (known.variable, known.mirror, known.extrude_mm) == ("T", ("x", "y"), (0.0, 180.0))
    assert (known.ambient, known.pressure_pa) == (288.15, 101325.0)
    said = of_own_case(folder, Choices(mirror=("y",), ambient=300.0))
    assert (said.mirror, said.extrude_mm, said.ambient) == (("y",), (-180.0, 180.0), 300.0)
    (folder / "setup.json").write_text(json.dumps(setup_record(HeatFlow())))
    known = of_own_case(folder, Choices())
    assert (known.mirror, known.extrude_mm) == (("x", "y"), None)
    (folder / "setup.json").write_text("{")
    assert of_own_case(folder, Choices()) == Choices()
