"""Checks a rollout's USD file with the validators of usd-core (`pip install usd-core numpy`): no error, no warning, and the
points, velocities and extent that its NPZ file has.

    python3 tests/tools/usd.py FOLDER
"""

import pathlib
import sys

import numpy
from pxr import Usd, UsdGeom, UsdValidation

folder = pathlib.Path(sys.argv[1])
arrays = numpy.load(folder / "rollout.npz")
stage = Usd.Stage.Open(str(folder / "rollout.usda"))
validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
problems = UsdValidation.ValidationContext(validators).Validate(stage)
for problem in problems:
    print(problem.GetType(), problem.GetName(), problem.GetMessage())
if problems or not validators:
    sys.exit(f"{len(problems)} problems, {len(validators)} validators")

assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
assert stage.GetTimeCodesPerSecond() == stage.GetFramesPerSecond() == arrays["fps"]
mesh = UsdGeom.Mesh(next(prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Mesh)))
counts, corners = mesh.GetFaceVertexCountsAttr().Get(), mesh.GetFaceVertexIndicesAttr().Get()
frames, vertices, _ = arrays["vertices_seq"].shape
assert UsdGeom.Mesh.ValidateTopology(corners, counts, vertices)[0]
assert (numpy.array(corners).reshape(-1, 3) == arrays["faces"]).all()
uv = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
assert uv.GetInterpolation() == "vertex" and (numpy.array(uv.Get()) == arrays["vertices_uv"]).all()
start = stage.GetStartTimeCode()
assert stage.GetEndTimeCode() - start + 1 == frames
for frame in range(frames):
    points = numpy.array(mesh.GetPointsAttr().Get(start + frame))
    assert (points == arrays["vertices_seq"][frame]).all(), frame
    assert (numpy.array(mesh.GetVelocitiesAttr().Get(start + frame)) == arrays["velocities_seq"][frame]).all(), frame
    assert (numpy.array(mesh.GetExtentAttr().Get(start + frame)) == [points.min(0), points.max(0)]).all(), frame
    lengths = numpy.linalg.norm(mesh.GetNormalsAttr().Get(start + frame), axis=1)
    assert abs(lengths - 1).max() < 1e-3, frame
print(f"USD: {len(validators)} validators, {frames} frames")
