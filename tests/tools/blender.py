"""Imports a rollout into Blender (`pip install bpy numpy`) as USD, glTF, PC2 and MDD, and compares the vertices of three
frames with its NPZ file.

    python3 tests/tools/blender.py FOLDER
"""

import json
import pathlib
import sys

import bpy
import numpy

folder = pathlib.Path(sys.argv[1]).resolve()
arrays = numpy.load(folder / "rollout.npz")
positions, fps = arrays["vertices_seq"], float(arrays["fps"])
up = json.loads((folder / "report.json").read_text())["settings"]["scene"].get("up", "y")
# Single precision, through a rotation.
TOLERANCE = 1e-5
CHECKED = [0, len(positions) // 2, len(positions) - 1]
assert abs(positions[CHECKED[1]] - positions[0]).max() > 0.01, "a rollout that moves"


def imported(load):
    """Returns the one mesh that `load` imports into an empty scene."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    load()
    return next(item for item in bpy.context.scene.objects if item.type == "MESH")


def check(name, item, time, upright=True):
    """Compares the vertices at the scene's frame `time(frame)`. Blender is z up."""
    for frame in CHECKED:
        at = time(frame)
        bpy.context.scene.frame_set(int(at), subframe=at - int(at))
        evaluated = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
        found = numpy.array([evaluated.matrix_world @ vertex.co for vertex in evaluated.to_mesh().vertices])
        x, y, z = positions[frame].T
        expected = numpy.stack([x, -z, y] if up == "y" else [x, y, z], axis=1)
        far = abs(found - expected).max()
        assert far < TOLERANCE, f"{name}, frame {frame}: {far}"
    print(f"{name}: frames {CHECKED} within {TOLERANCE} m")


path = {ending: str(folder / f"rollout.{ending}") for ending in ["usda", "glb", "obj", "pc2", "mdd"]}
mesh = imported(lambda: bpy.ops.wm.usd_import(filepath=path["usda"]))
start = bpy.context.scene.frame_start
assert bpy.context.scene.frame_end - start + 1 == len(positions)
check("USD", mesh, lambda frame: start + frame)

mesh = imported(lambda: bpy.ops.import_scene.gltf(filepath=path["glb"]))
render = bpy.context.scene.render
check("glTF", mesh, lambda frame: frame / fps * render.fps / render.fps_base)

axes = {"forward_axis": "NEGATIVE_Z", "up_axis": "Y"} if up == "y" else {"forward_axis": "Y", "up_axis": "Z"}
for kind in ["PC2", "MDD"]:
    mesh = imported(lambda: bpy.ops.wm.obj_import(filepath=path["obj"], **axes))
    cache = mesh.modifiers.new("cache", "MESH_CACHE")
    cache.cache_format, cache.filepath = kind, path[kind.lower()]
    # The modifier's own start counts; that of the file, which is not 0 here, is not read.
    assert cache.frame_start == 0
    check(kind, mesh, lambda frame: frame)
    cache.frame_start = 1
    check(f"{kind} from frame 1 on", mesh, lambda frame: frame + 1)
