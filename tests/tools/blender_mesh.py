"""Exports a mesh from Blender (`pip install bpy numpy`) as OBJ and glTF, or compares the frames of cloths that carried them.

    python3 tests/tools/blender_mesh.py export FOLDER      # writes mesh.obj, mesh.glb, mesh.gltf and mesh.bin
    python3 tests/tools/blender_mesh.py compare FOLDER     # FOLDER/{obj,glb,gltf}/rollout_obj/00001.obj
"""

import pathlib
import sys

import numpy

folder = pathlib.Path(sys.argv[2]).resolve()
# Texture coordinates are rounded once more in glTF.
TOLERANCE = 1e-5


def export():
    """Writes a tube with a seam, moved, turned and scaled by its object."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    place = {"location": (1, 2, 3), "rotation": (0.3, 0.2, 0.1)}
    bpy.ops.mesh.primitive_cylinder_add(vertices=12, radius=0.3, depth=1, end_fill_type="NOTHING", **place)
    bpy.context.object.scale = (1, 0.5, 2)
    bpy.ops.object.shade_smooth()
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.ops.mesh.select_all(action="SELECT")
    bpy.ops.mesh.subdivide(number_cuts=3)
    bpy.ops.object.mode_set(mode="OBJECT")
    path = str(folder / "mesh")
    bpy.ops.wm.obj_export(filepath=f"{path}.obj")
    bpy.ops.export_scene.gltf(filepath=f"{path}.glb", export_format="GLB")
    bpy.ops.export_scene.gltf(filepath=f"{path}.gltf", export_format="GLTF_SEPARATE")


def vertices(kind):
    """Returns positions and texture coordinates of the vertices in the last frame, shape [V, 5]."""
    lines = [line.split() for line in (folder / kind / "rollout_obj/00001.obj").read_text().splitlines()]
    rows = [[[float(word) for word in words] for first, *words in lines if first == name] for name in ("v", "vt")]
    return numpy.concatenate([numpy.array(array) for array in rows], axis=1)


def compare():
    expected = vertices("obj")
    for kind in ["glb", "gltf"]:
        found = vertices(kind)
        far = abs(found[:, None] - expected[None]).max(axis=2)
        far = max(far.min(axis=0).max(), far.min(axis=1).max())
        assert len(found) == len(expected) and far < TOLERANCE, f"{kind}: {len(found)} vertices, {far} m"
        print(f"mesh.{kind}: {len(found)} vertices, where those of mesh.obj are within {TOLERANCE} m")


{"export": export, "compare": compare}[sys.argv[1]]()
