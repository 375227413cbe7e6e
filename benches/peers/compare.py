"""Times fnopt and a PyTorch implementation of the same frame on this machine and writes a table.

    python3 benches/peers/compare.py [--grid 32,64,100] [--rounds 3] [--device cpu|cuda] [--adapter NAME] [--markdown FILE]

Each round runs every column once, interleaved and with the same number of threads; a cell is the median over
the rounds. First, both programs compute the same frames from the same sheet. The exit code is 1 if these differ
by more than 1e-3 of its side. Needs PyTorch, numpy and safetensors, and a built program
(`cargo build --release`).
"""

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile

import numpy

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent.parent
FRAME_TIME, GRAVITY = 1 / 60, 9.8
# Later frames drift apart: ten iterations of the optimizer amplify rounding.
FRAMES_COMPARED = 3
TOLERANCE = 1e-3
# The peer takes the network's step as it is.
AS_PUBLISHED = ["--solver", "fnopt-paper"]


def run(command, threads=None):
    """Returns the output of a command; fnopt runs on this many threads."""
    env = os.environ | ({"RAYON_NUM_THREADS": str(threads)} if threads else {})
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, env=env)
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, command))}\n{done.stderr}")
    return done.stdout


class Comparison:
    def __init__(self, options, folder):
        self.options, self.folder = options, folder
        gpu = ["--device", "gpu"] + (["--adapter", options.adapter] if options.adapter else [])
        # Flags of fnopt by column name: the CPU path and, on request, an adapter, usually a software one.
        self.ours = {"fnopt": ["--device", "cpu"] if options.device == "cpu" else gpu}
        if options.device == "cpu" and options.adapter:
            self.ours[f"fnopt on {options.adapter}"] = gpu

    def sheet(self, n, device):
        """Returns fnopt's frames of a drape that loses the support of one corner, in edges, [F, n, n, 3]. (A
        flat sheet would not do: whole components of its first gradient are zero, and the optimizer amplifies
        their rounding.)"""
        scene = {
            "grid": [n, n],
            "up": "z",
            "motion": "none",
            "material": "paper",
            "handles": [0],
            "wind": {"density": 0, "drag": 0},
            "frames": FRAMES_COMPARED + 4,
            "frame_time_s": FRAME_TIME,
            "gravity": GRAVITY,
        }
        path = self.folder / f"scene_{n}.json"
        path.write_text(json.dumps(scene))
        out = self.folder / f"ours_{n}"
        command = [self.options.program, "rollout", path, "--checkpoint", self.options.checkpoint, "--out", out]
        run(command + device + [*AS_PUBLISHED, "--no-pictures", "--format", "npy"])
        (frames,) = out.glob("*.npy")
        return numpy.load(frames).reshape(-1, n, n, 3) * (n - 1)

    def peer(self, n, mode, tf32=False, more=()):
        down = -GRAVITY * FRAME_TIME**2 * (n - 1)
        command = [sys.executable, HERE / "torch_frame.py", "--checkpoint", self.options.checkpoint]
        command += ["--start", self.folder / f"start_{n}.npy", "--held", 0, "--gravity", 0, 0, down]
        command += ["--mode", mode, "--device", self.options.device, "--threads", self.options.threads]
        command += ["--frames", self.options.frames, *(["--tf32"] if tf32 else []), *more]
        return json.loads(run(command).splitlines()[-1])

    def check(self, n):
        """Returns the largest distance between both programs' sheets after a few frames from one start, in
        sides."""
        ours = {name: self.sheet(n, device) for name, device in self.ours.items()}
        numpy.save(self.folder / f"start_{n}.npy", ours["fnopt"][0])
        path = self.folder / f"peer_{n}.npy"
        self.peer(n, "eager", more=["--out", path])
        theirs = numpy.load(path)[:FRAMES_COMPARED]
        largest = 0
        for name, frames in ours.items():
            apart = numpy.linalg.norm(frames[1 : FRAMES_COMPARED + 1] - theirs, axis=-1).max() / (n - 1)
            if not apart < TOLERANCE:
                sys.exit(f"{n}x{n}: the frames of {name} are {apart:.2e} of the side apart, not {TOLERANCE:g}")
            largest = max(largest, apart)
        return largest

    def fnopt(self, n, device):
        command = [self.options.program, "bench", "--grid", n, "--frames", self.options.frames, "--json", *AS_PUBLISHED]
        return json.loads(run(command + device, self.options.threads))["rows"][0]["ms_per_frame"]

    def systems(self):
        if self.options.device == "cuda":
            modes = [(mode, tf32) for mode in self.options.modes.split(",") for tf32 in [False, True]]
        else:
            modes = [(mode, False) for mode in self.options.modes.split(",")]
        name = lambda mode, tf32: f"PyTorch {mode}" + (", TF32" if tf32 else "")
        peers = {name(*which): lambda n, which=which: self.peer(n, *which)["ms_per_frame"] for which in modes}
        ours = {name: lambda n, device=device: self.fnopt(n, device) for name, device in self.ours.items()}
        return {**ours, **peers}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--grid", default="32,64,100")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--frames", type=int, default=10, help="frames timed in each run, after three warm-up frames")
    parser.add_argument("--device", choices=["cpu", "cuda"], default="cpu")
    parser.add_argument("--modes", default="eager,compiled", help="of PyTorch: eager, compiled, and on a GPU graph")
    parser.add_argument("--threads", type=int, default=2, help="threads of both programs on the CPU")
    parser.add_argument("--adapter", help="adapter for fnopt; with --device cpu it adds a column")
    parser.add_argument("--program", default=ROOT / "target/release/fnopt")
    parser.add_argument("--checkpoint", default=ROOT / "assets/weights/fnopt.safetensors")
    parser.add_argument("--markdown", type=pathlib.Path)
    options = parser.parse_args()
    if options.frames < FRAMES_COMPARED:
        parser.error(f"--frames: at least {FRAMES_COMPARED}")

    with tempfile.TemporaryDirectory() as folder:
        comparison = Comparison(options, pathlib.Path(folder))
        grids = [int(n) for n in options.grid.split(",")]
        for n in grids:
            apart = comparison.check(n)
            print(f"{n}x{n}: the same frames to {apart:.1e} of the side", file=sys.stderr)
        systems = comparison.systems()
        times = {(name, n): [] for name in systems for n in grids}
        for round_ in range(options.rounds):
            for n in grids:
                for name, measure in systems.items():
                    times[name, n].append(measure(n))
            print(f"round {round_ + 1} of {options.rounds}", file=sys.stderr)

    median = {key: statistics.median(values) for key, values in times.items()}
    peers = [name for name in systems if name not in comparison.ours]
    ratios = [(ours, peer) for ours in comparison.ours for peer in peers]
    heads = ["grid"] + [f"{name} [ms]" for name in systems] + [f"{ours} / {peer}" for ours, peer in ratios]
    lines = [f"| {' | '.join(heads)} |", "|---|" + "---:|" * (len(heads) - 1)]
    for n in grids:
        cells = [f"{median[name, n]:.1f}" for name in systems]
        cells += [f"{median[ours, n] / median[peer, n]:.3f}" for ours, peer in ratios]
        lines.append(f"| {n}x{n} | {' | '.join(cells)} |")
    table = "\n".join(lines) + "\n"
    print(table, end="")
    if options.markdown:
        options.markdown.write_text(table)


if __name__ == "__main__":
    main()
