#!/usr/bin/env python3
"""A data set of random rollouts: two corners of a sheet move at random, in random wind, for random materials.

Sample k depends on the seed and k alone. Files appear whole, and samples that are there are not computed again, so the
program may be stopped at any time and goes on when it is started again. Each sample has its frames, 00042.npz, and a record,
00042.json, with the scene and whether the rollout can be trusted.

    examples/python/dataset.py --out out/dataset
"""

import argparse
import json
from pathlib import Path

import numpy as np

import fnopt


def random_scene(seed, k, grid, frames):
    """Scene k of a data set."""
    random = np.random.default_rng([seed, k])
    # Each coordinate of a corner is a sum of slow waves that begin at rest.
    time = np.arange(frames)[:, None, None, None] / 60
    speed = random.uniform(0.5, 6, size=(2, 3, 4))  # rad/s
    size = random.uniform(0, 0.3, size=(2, 3, 4)) / speed  # m
    moves = (size * (1 - np.cos(speed * time))).sum(-1) * random.choice([-1, 1], size=(2, 3))
    corners = np.array([[0, 0.5, 0.45], [0, 0.5, -0.45]])
    softer = 10 ** random.uniform(-0.5, 0.5, size=3)
    return fnopt.Scene.from_dict(
        {
            "handles": "corners",
            "motion": corners + moves,
            "frames": frames,
            "wind": {"velocity": random.uniform(-2, 2, size=3)},
            "material": {
                "stretch_modulus": 1500 * softer[0],
                "shear_modulus": 45 * softer[1],
                "bending_stiffness": 7.5e-4 * softer[2],
            },
        }
    ).replace(grid=grid)


def compute(scene, solver, device, file):
    """Simulates a scene, writes its frames and returns its record."""
    try:
        rollout = fnopt.rollout(scene, solver, device=device, progress=False)
    except fnopt.NonFiniteError as error:
        return {"sound": False, "unsound": [str(error)], "frames": len(error.rollout)}
    rollout.save(file)
    report = rollout.report
    return {key: report[key] for key in ("sound", "unsound", "gap_estimate", "stretch_largest_free", "frames")}


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("out/dataset"))
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--frames", type=int, default=120)
    parser.add_argument("--grid", type=int, default=32)
    parser.add_argument("--solver", default="spectral")
    parser.add_argument("--device", default="auto")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)

    options.out.mkdir(parents=True, exist_ok=True)
    samples = range(options.count)
    try:
        from tqdm import tqdm

        samples = tqdm(samples, unit="rollout")
    except ImportError:
        pass
    computed, unsound = 0, 0
    for k in samples:
        record = options.out / f"{k:05}.json"
        if not record.exists():
            scene = random_scene(options.seed, k, options.grid, options.frames)
            found = compute(scene, options.solver, options.device, options.out / f"{k:05}.npz")
            about = {"seed": options.seed, "sample": k, "solver": options.solver, **found, "scene": scene.to_dict()}
            unfinished = record.with_suffix(".part")
            unfinished.write_text(json.dumps(about))
            unfinished.replace(record)
            computed += 1
        unsound += not json.loads(record.read_text())["sound"]
    print(f"{options.count} samples in {options.out}, {computed} of them new; {unsound} are not sound")


if __name__ == "__main__":
    main()
