#!/usr/bin/env python3
"""A simulator of one's own beside fnopt, on the same scene: masses and springs in NumPy, with explicit steps.

The truth is Newton's method, which finds the minimum of every frame. The springs are another model of cloth, so they need not
come near it: the table shows how far they are, and whether their frames can be trusted as cloth at all.

    examples/python/compare.py --grid 16 --frames 60
"""

import argparse
import time

import numpy as np

import fnopt


class Springs:
    """Masses joined by springs along edges, diagonals and, against bending, across each particle."""

    def __init__(self, scene, positions, handles):
        (self.h, self.w), fields = scene.grid, scene.to_dict()
        number = np.arange(self.h * self.w).reshape(self.h, self.w)
        self.length = fields["side_m"] / (self.h - 1)
        self.gravity, self.frame_dt = np.array(fields["gravity"]), scene.frame_dt
        stretch, shear = (fields["material"][name] for name in ("stretch_modulus", "shear_modulus"))
        bend = fields["material"]["bending_stiffness"] / self.length**2

        pairs, rest, stiffness = [], [], []
        for di, dj, k in ((0, 1, stretch), (1, 0, stretch), (1, 1, shear), (1, -1, shear), (0, 2, bend), (2, 0, bend)):
            a = number[: self.h - di, max(0, -dj) : self.w - max(0, dj)]
            b = number[di:, max(0, dj) : self.w + min(0, dj)]
            pairs.append(np.stack([a.ravel(), b.ravel()], axis=1))
            rest.append(np.full(a.size, self.length * np.hypot(di, dj)))
            stiffness.append(np.full(a.size, k))
        self.pairs = np.concatenate(pairs)
        self.rest, self.stiffness = np.concatenate(rest), np.concatenate(stiffness)

        share = np.ones((self.h, self.w))  # of a cell: half along borders, a quarter at corners
        share[[0, -1]] *= 0.5
        share[:, [0, -1]] *= 0.5
        self.mass = fields["areal_mass_kg_m2"] * self.length**2 * share.reshape(-1, 1)
        self.positions, self.velocities = positions.astype(float), np.zeros_like(positions, dtype=float)
        self.handles = handles
        # Well below the period of the fastest wave.
        fastest = np.sqrt(16 * stretch / self.mass.min())
        self.substeps = int(np.ceil(self.frame_dt * fastest))

    def forces(self):
        a, b = self.pairs.T
        along = self.positions[b] - self.positions[a]
        lengths = np.linalg.norm(along, axis=1)
        along /= lengths[:, None]
        closing = ((self.velocities[b] - self.velocities[a]) * along).sum(1)
        # A hundredth of critical damping, without which stiff springs ring for ever.
        damping = 0.02 * np.sqrt(self.stiffness * self.mass.min())
        pull = (self.stiffness * (lengths - self.rest) + damping * closing)[:, None] * along
        total = self.mass * self.gravity
        for axis in range(3):
            total[:, axis] += np.bincount(a, pull[:, axis], len(total)) - np.bincount(b, pull[:, axis], len(total))
        return total

    def step(self, targets):
        """Computes a frame, at whose end the handles are at these targets."""
        dt, before = self.frame_dt / self.substeps, self.positions[self.handles].copy()
        for k in range(1, self.substeps + 1):
            self.velocities += dt * self.forces() / self.mass
            self.velocities[self.handles] = (targets - before) / self.frame_dt
            self.positions += dt * self.velocities


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--grid", type=int, default=16)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument("--solvers", default="spectral,fnopt", help="solvers of fnopt to compare with")
    options = parser.parse_args(arguments)

    # In a vacuum, which the springs are in.
    scene = fnopt.Scene().replace(grid=options.grid, frames=options.frames, wind={"density": 0})
    truth = fnopt.rollout(scene, "newton", device="cpu", progress=False)
    handles = fnopt.Simulation(scene, "newton", device="cpu").handles[0]

    found = {}
    for solver in options.solvers.split(","):
        rollout = fnopt.rollout(scene, solver, device="cpu", progress=False)
        found[solver] = (rollout.positions, rollout.velocities, rollout.report["ms_per_frame"])

    springs = Springs(scene, truth.positions[0], handles)
    frames, begun = [(springs.positions.copy(), springs.velocities.copy())], time.perf_counter()
    for frame in range(1, len(truth)):
        springs.step(truth.positions[frame, handles])
        frames.append((springs.positions.copy(), springs.velocities.copy()))
    ms = 1e3 * (time.perf_counter() - begun) / (len(truth) - 1)
    found["springs"] = (*map(np.array, zip(*frames)), ms)

    print(f"{'':<10} {'mean [mm]':>10} {'largest [mm]':>13} {'chamfer [mm^2]':>15} {'ms/frame':>9}  sound")
    for name, (positions, velocities, ms) in found.items():
        measures = fnopt.compare(positions, truth.positions)
        chamfer = fnopt.chamfer(positions[-1], truth.positions[-1])
        verdict = fnopt.soundness(scene, positions, velocities)
        print(
            f"{name:<10} {1e3 * measures['distance_mean'].mean():10.2f} {1e3 * measures['distance_largest'].max():13.2f}"
            f" {1e6 * chamfer:15.3f} {ms:9.2f}  {'yes' if verdict['sound'] else '; '.join(verdict['unsound'])}"
        )
    return {name: fnopt.compare(positions, truth.positions) for name, (positions, _, _) in found.items()}


if __name__ == "__main__":
    main()
