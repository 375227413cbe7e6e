#!/usr/bin/env bash
# Reads what `fnopt rollout` writes with the programs that the formats are for, and a mesh that Blender writes, as far as they are
# installed: USD's validators (pip install usd-core numpy), Khronos' of glTF (npm install gltf-validator), and Blender (pip
# install bpy numpy). Names of other interpreters can be given, which must have them: USD_PYTHON, BLENDER_PYTHON.
set -euo pipefail
cd "$(dirname "$0")/.."
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

usd=${USD_PYTHON:-python3} blender=${BLENDER_PYTHON:-python3}
has() { "$1" -c "import $2, numpy" 2>/dev/null; }
has_validator() { command -v node >/dev/null && node -e 'require("gltf-validator")' 2>/dev/null; }
if ! has "$usd" pxr.UsdValidation && ! has_validator && ! has "$blender" bpy; then
    echo "skipped: usd-core, gltf-validator and bpy are missing"
    exit
fi

for up in y z; do
    echo "{\"up\": \"$up\", \"grid\": [16, 12], \"frames\": 120, \"speed\": 2}" >"$scratch/$up.json"
    cargo run --release --quiet -- rollout "$scratch/$up.json" --device cpu --solver spectral --no-pictures --every 2 --start-frame 5 \
        --format npz,usda,glb,pc2,mdd --out "$scratch/$up" >/dev/null
    echo "$up up:"
    if has "$usd" pxr.UsdValidation; then "$usd" tests/tools/usd.py "$scratch/$up"; else echo "skipped: usd-core"; fi
    if has_validator; then node tests/tools/gltf.js "$scratch/$up"; else echo "skipped: gltf-validator"; fi
    if has "$blender" bpy; then "$blender" tests/tools/blender.py "$scratch/$up"; else echo "skipped: bpy"; fi
done

if has "$blender" bpy; then
    echo "a mesh from Blender:"
    "$blender" tests/tools/blender_mesh.py export "$scratch" >/dev/null
    for kind in obj glb gltf; do
        echo "{\"mesh\": \"mesh.$kind\", \"grid\": [24, 20], \"start\": \"hanging\", \"motion\": \"none\"}" >"$scratch/$kind.json"
        cargo run --release --quiet -- rollout "$scratch/$kind.json" --device cpu --solver spectral --no-pictures --frames 2 \
            --format obj --out "$scratch/$kind" >/dev/null
    done
    "$blender" tests/tools/blender_mesh.py compare "$scratch"
fi
