#!/usr/bin/env python3
"""Records how fast this release is on this machine: one line of JSON, benches/history/VERSION-DEVICE.json.

    cargo build --release
    benches/history/record.py [--device cpu|gpu] [--adapter NAME] [--grid 32,64,100] [--rounds 3]

The solvers take turns, round after round, so that a machine that slows down slows all of them; each figure is the
median over the rounds of the median time of a frame. Ratios between solvers, and to `peak_gflop_per_s`, are what may
be compared between machines. An existing record of the same version and device is replaced.
"""

import argparse
import datetime
import json
import pathlib
import re
import statistics
import subprocess
import sys

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent.parent
SOLVERS = ["spectral", "fnopt", "fnopt-paper", "quasi-newton", "lbfgs", "adam", "gd"]
ON_CPU_ONLY = ["newton", "quasi-newton-exact"]


def output(*command):
    """Returns what a command prints, or ends with what it complains of."""
    done = subprocess.run([str(part) for part in command], capture_output=True, text=True, cwd=ROOT)
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, command))}\n{done.stderr}")
    return done.stdout


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--program", type=pathlib.Path, default=ROOT / "target/release/fnopt")
    parser.add_argument("--device", choices=["cpu", "gpu"], default="cpu")
    parser.add_argument("--adapter")
    parser.add_argument("--grid", default="32,64,100")
    parser.add_argument("--rounds", type=int, default=3)
    args = parser.parse_args()
    if args.rounds < 1:
        parser.error("--rounds: at least 1")
    if not args.program.is_file():
        parser.error(f"{args.program}: not built; cargo build --release does")
    where = ["--device", args.device, *(["--adapter", args.adapter] if args.adapter else [])]
    solvers = SOLVERS + (ON_CPU_ONLY if args.device == "cpu" else [])

    times, iterations, peaks = {}, {}, []
    for done in range(args.rounds):
        print(f"round {done + 1} of {args.rounds}", file=sys.stderr)
        solver = ["--solver", ",".join(solvers)]
        bench = json.loads(output(args.program, "bench", *solver, "--grid", args.grid, "--json", *where))
        if bench["failures"]:
            sys.exit(str(bench["failures"]))
        peaks.append(bench["peak_gflop_per_s"])
        for row in bench["rows"]:
            iterations[row["solver"]] = row["iterations"]
            times.setdefault(row["solver"], {}).setdefault(row["grid"], []).append(row["ms_per_frame"])

    commit = output("git", "rev-parse", "HEAD").strip()
    if output("git", "status", "--porcelain", "src", "shaders", "Cargo.toml", "Cargo.lock"):
        commit += " and uncommitted changes"
    record = {name: bench[name] for name in ("version", "device", "processor", "system", "precision")} | {
        "commit": commit,
        "date": datetime.date.today().isoformat(),
        "peak_gflop_per_s": round(statistics.median(peaks), 1),
        "rounds": args.rounds,
        "solvers": {
            solver: {
                "iterations": iterations[solver],
                "ms_per_frame": {grid: float(f"{statistics.median(each):.4g}") for grid, each in of.items()},
            }
            for solver, of in times.items()
        },
    }
    device = re.sub(r"[^a-z0-9]+", "-", bench["device"].split(",")[0].lower()).strip("-")
    file = HERE / f"{bench['version']}-{device}.json"
    file.write_text(json.dumps(record) + "\n")
    print(file)


if __name__ == "__main__":
    main()
