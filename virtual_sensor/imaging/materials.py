"""The material of a scene's part: a BSDF of Mitsuba's in a file of its own.

A scene includes it by ``<include filename="materials/$material.xml"/>``, and its shapes refer to it
by ``<ref id="steel"/>``, whatever its id is in its file.  The parameters of the file are the
scene's; those of iron follow from the scene's `wavelength`:

==================  ==============================================================================
Parameter           What becomes of it
==================  ==============================================================================
`iron_n`, `iron_k`  refractive index n + ik of iron at the wavelength, unless given: interpolated
                    in the table of Johnson and Christy, Phys. Rev. B 9, 5056 (1974), as
                    refractiveindex.info has it
==================  ==============================================================================
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from virtual_sensor.engine import mi
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene_file import SceneFile, parameter_words, shipped_scenes, shortened

ID = "steel"
"""Of the material's BSDF in a scene."""

_MAY_HOLD = ("default", "path", "alias", "bsdf", "texture")
_IRON = np.array(  # wavelength, nm, n and k
    [
        *((188, 1.29, 1.35), (199, 1.45, 1.40), (212, 1.47, 1.43), (226, 1.47, 1.49)),
        *((243, 1.50, 1.61), (262, 1.56, 1.75), (284, 1.64, 1.88), (292, 1.65, 1.94)),
        *((301, 1.67, 2.00), (311, 1.69, 2.06), (320, 1.74, 2.12), (332, 1.78, 2.19)),
        *((342, 1.85, 2.27), (354, 1.93, 2.35), (368, 2.02, 2.43), (381, 2.12, 2.50)),
        *((397, 2.24, 2.58), (413, 2.35, 2.65), (431, 2.48, 2.71), (451, 2.59, 2.77)),
        *((471, 2.67, 2.82), (496, 2.74, 2.88), (521, 2.86, 2.91), (549, 2.95, 2.93)),
        *((582, 2.94, 2.99), (617, 2.88, 3.05), (659, 2.92, 3.10), (704, 2.86, 3.19)),
        *((756, 2.87, 3.28), (821, 2.94, 3.39), (892, 2.96, 3.56), (984, 2.92, 3.79)),
        *((1088, 2.97, 4.06), (1216, 3.03, 4.39), (1393, 3.09, 4.83), (1610, 3.11, 5.39)),
        (1937, 3.17, 6.12),
    ]
)


def installed_materials() -> list[Path]:
    """Files of the materials that come with the program."""
    return sorted((shipped_scenes() / "materials").glob("*.xml"))


def material_words() -> dict[str, str]:
    """What the installed materials say of their parameters."""
    return {name: w for path in installed_materials() for name, w in parameter_words(path).items()}


def materials_with(parameter: str) -> list[str]:
    """Names of the installed materials that have a parameter."""
    return [path.stem for path in installed_materials() if parameter in parameter_words(path)]


def index_of_iron(wavelength_nm: float) -> complex:
    """Refractive index n + ik of iron; NaN outside the table, from 188 to 1937 nm."""
    nm, n, k = _IRON.T
    n, k = (np.interp(wavelength_nm, nm, each, np.nan, np.nan) for each in (n, k))
    return complex(n, k)


def with_index_of_iron(values: Mapping[str, str], given: Mapping[str, str]) -> dict[str, str]:
    """The values of a scene's parameters, `iron_n` and `iron_k` as they are at its `wavelength`.

    Parameters
    ----------
    values : Mapping
        Of all parameters, defaults included.
    given : Mapping
        Those that are no defaults, which are kept.

    Raises
    ------
    InputError
        If the table has no such wavelength, and they are not given.
    """
    wanted = {"iron_n", "iron_k"} & values.keys() - given.keys()
    try:
        index = index_of_iron(float(values["wavelength"])) if wanted else 0j
    except (KeyError, ValueError):  # which loading the scene tells
        return dict(values)
    if np.isnan(index):
        raise InputError(
            f"wavelength={values['wavelength']}: n and k of iron are known from {_IRON[0, 0]:g} to"
            f" {_IRON[-1, 0]:g} nm; give iron_n and iron_k"
        )
    found = {"iron_n": f"{index.real:.4g}", "iron_k": f"{index.imag:.4g}"}
    return {**values, **{name: found[name] for name in wanted}}


def check_material(file: SceneFile) -> None:
    """Refuse a material's file that holds anything else than one BSDF and its textures.

    Raises
    ------
    InputError
        Naming the element and the remedy.
    """
    root, *rest = file.elements
    if root.tag == "bsdf":
        if "version" not in root.attributes:
            raise InputError(
                f"{root.where}: a <bsdf> that is a file of its own needs Mitsuba's version; give it"
                ' version="3.0.0"'
            )
        return
    own = [element for element in rest if element.depth == 2] if root.tag == "scene" else [root]
    for element in own:
        if element.tag not in _MAY_HOLD:
            raise InputError(
                f"{element.where}: <{shortened(element.tag)}> in the file of a material, which"
                " holds a <bsdf> and its textures; take it out, or name another file (material)"
            )
    if not any(element.tag == "bsdf" for element in own):
        raise InputError(f"{root.where}: the file of a material has no <bsdf>; add it")


def name_material(state: Any, file: Path) -> None:
    """Give the BSDF of a material's file the id by which shapes refer to it.

    Parameters
    ----------
    state : mitsuba.parser.ParserState
        Of the scene, parsed.
    file : Path
        Of the material.

    Raises
    ------
    InputError
        If the file has several, and none of them has that id.
    """
    resolved = mi.Properties.Type.ResolvedReference
    root = state.root.props
    outer = [root[name].index() for name in root.keys() if root.type(name) == resolved]  # noqa: SIM118
    found = [
        index
        for index in outer
        if state.nodes[index].type == mi.ObjectType.BSDF
        and Path(str(state.files[state.nodes[index].file_index])).resolve() == file.resolve()
    ]
    named = [index for index in found if state.nodes[index].props.id() == ID]
    if len(found) > 1 and not named:
        raise InputError(
            f'{file}: {len(found)} <bsdf> elements; give the one that is the material id="{ID}"'
        )
    for index in named or found:
        if state.id_to_index.get(ID, index) != index:
            raise InputError(
                f'{file}: its <bsdf> gets the id "{ID}", which the scene has already; give that'
                " element another"
            )
        state.nodes[index].props.set_id(ID)
        state.id_to_index = {**state.id_to_index, ID: index}


def goes_by_coordinates(state: Any, shape: Any) -> bool:
    """Whether the material of a shape has a texture or a lay, which texture coordinates give."""
    nodes = [each for each in _inner(state, shape) if each.type == mi.ObjectType.BSDF]
    while nodes:
        node = nodes.pop()
        along, across = (node.props.get(name, 0.0) for name in ("alpha_u", "alpha_v"))
        if along != across or node.props.plugin_name() in ("bitmap", "checkerboard"):
            return True
        nodes += _inner(state, node)
    return False


def _inner(state: Any, node: Any) -> list[Any]:
    """The nodes that a node of a parsed scene holds or refers to."""
    kinds, props = mi.Properties.Type, node.props
    places = [
        props[name].index()
        if props.type(name) == kinds.ResolvedReference
        else state.id_to_index.get(props[name].id())
        for name in props.keys()  # noqa: SIM118
        if props.type(name) in (kinds.ResolvedReference, kinds.Reference)
    ]
    return [state.nodes[place] for place in places if place is not None]


def with_coordinates(mesh: mi.Mesh) -> bytes:
    """A PLY file of a mesh with texture coordinates by box mapping, in mm: u along x, the lay.

    Each triangle has those two axes that lie most in its plane: (x, y), (x, z), or (y, z).
    """
    import trimesh  # most scenes have no such part

    held = mi.traverse(mesh)
    faces = np.array(held["faces"], np.int64)
    places = np.array(held["vertex_positions"], np.float32).reshape(-1, 3)[faces]
    a, b, c = places.reshape(-1, 3, 3).transpose(1, 0, 2)
    steep = np.repeat(np.argmax(np.abs(np.cross(b - a, c - a)), axis=1), 3)
    x, y, z = places.T
    normals = None
    if mesh.has_vertex_normals():
        normals = np.array(held["vertex_normals"], np.float64).reshape(-1, 3)[faces]
    split = trimesh.Trimesh(
        places, np.arange(len(faces)).reshape(-1, 3), vertex_normals=normals, process=False
    )
    split.vertex_attributes |= {"u": np.where(steep == 0, y, x), "v": np.where(steep == 2, y, z)}
    return bytes(split.export(file_type="ply", vertex_normal=normals is not None))
