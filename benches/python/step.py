#!/usr/bin/env python3
"""What a step from Python costs over the same step in Rust: `fnopt rollout` and `Simulation.step` take turns, and of each frame
the median and the fastest of all rounds count.

    cargo build --release && pip install . && benches/python/step.py
"""

import argparse
import json
import statistics
import subprocess
import tempfile
import time
from pathlib import Path

import fnopt


def in_rust(command, options):
    """Milliseconds of each frame, as the command reports them."""
    with tempfile.TemporaryDirectory() as out:
        arguments = ["--solver", options.solver, "--grid", str(options.grid), "--frames", str(options.frames + 1)]
        arguments += ["--device", options.device, "--no-pictures", "--out", out]
        subprocess.run([command, "rollout", *arguments], check=True, capture_output=True)
        return [frame["ms"] for frame in json.loads((Path(out) / "report.json").read_text())["per_frame"]]


def in_python(options, with_positions):
    """Milliseconds of each step, and what of it the step in Rust took."""
    scene = fnopt.Scene().replace(grid=options.grid)
    simulation = fnopt.Simulation(scene, options.solver, device=options.device)
    times, inside = [], []
    for _ in range(options.frames):
        begun = time.perf_counter()
        simulation.step()
        if with_positions:
            simulation.positions
        times.append(1e3 * (time.perf_counter() - begun))
        inside.append(simulation.stats[0]["ms"])
    return times, inside


def main():
    root = Path(__file__).resolve().parents[2]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--command", default=root / "target/release/fnopt", help="the command fnopt")
    parser.add_argument("--solver", default="spectral")
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--grid", type=int, default=32)
    parser.add_argument("--frames", type=int, default=200)
    parser.add_argument("--rounds", type=int, default=9)
    options = parser.parse_args()

    columns = {"rust": [], "step()": [], "step(), in Rust": [], "step() and positions": []}
    for _ in range(options.rounds):
        columns["rust"].append(in_rust(options.command, options))
        times, inside = in_python(options, False)
        columns["step()"].append(times)
        columns["step(), in Rust"].append(inside)
        columns["step() and positions"].append(in_python(options, True)[0])
    for name, rounds in columns.items():
        for which, of in (("median", statistics.median), ("fastest", min)):
            ms, base = (statistics.mean(map(of, zip(*all))) for all in (rounds, columns["rust"]))
            print(f"{name:<22} {which:<8} {ms:7.3f} ms/frame {100 * (ms / base - 1):+6.1f} %")


if __name__ == "__main__":
    main()
