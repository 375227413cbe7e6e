#!/usr/bin/env python3
"""Compiles every kernel for GPUs that are not here, and checks what their compiler says.

    benches/static/check.py [--families vega10,gfx1100] [--program PATH] [--write]

AMD's compiler in Mesa's Vulkan driver works without a device (RADV_FORCE_FAMILY). The program builds the pipelines of
frames and of a training step there, over a layer that completes submissions without running them (layer.c). Families of
NVIDIA, such as sm_90, take the same kernels through CUDA's assembler (nvidia.py). Fails if a kernel is refused, or if it
spills more, keeps more in scratch memory or has fewer waves than compilers.csv says, which --write replaces; what was not
there may not spill. Frames that `fnopt predict` finds slower than predicted.csv says fail, too. Needs gcc, the headers of Vulkan's loader and Mesa's drivers (Debian: gcc libvulkan-dev
mesa-vulkan-drivers).
"""

import argparse
import concurrent.futures
import csv
import glob
import json
import os
import pathlib
import subprocess
import sys
import tempfile

import nvidia

HERE = pathlib.Path(__file__).resolve().parent
TABLE = HERE / "compilers.csv"
PREDICTED = HERE / "predicted.csv"
COLUMNS = ["family", "kernel", "workgroup", "lds_bytes", "vgprs", "waves", "spilled", "scratch_bytes", "instructions", "latency_cycles", "cases"]
# Its own kernels validate indirect dispatches, which nobody here uses.
OF_WGPU = {"main"}
# The driver whose kernels NVIDIA's families take: those of any hardware.
ANY = "gfx1100"
# A step with a batch of the paper, and next to no validation.
TRAINING = """
steps = 1

[[pool]]
iterations = 1
cloths = 10

[validation]
frames = 1
iterations = 1
grids = [[8, 8]]
"""


def cases():
    """Yields names and arguments of runs that together build every kernel of frames and of a training step."""
    bench = ["bench", "--device", "gpu", "--frames", "1", "--json"]
    for grid in ["32", "100"]:
        for solver in ["fnopt", "fnopt-paper", "spectral", "quasi-newton", "lbfgs", "adam", "gd"]:
            yield f"{solver} {grid}", [*bench, "--solver", solver, "--grid", grid]
    # Rows too long for a workgroup.
    yield "spectral 160", [*bench, "--solver", "spectral", "--grid", "160"]
    yield "training", ["train", "training.toml", "--device", "gpu", "--out", "training"]
    yield "batch", [*bench, "--grid", "32", "--batch", "256"]
    yield "f16", [*bench, "--grid", "32", "--precision", "f16"]
    yield "repulsion", ["rollout", "--device", "gpu", "--repulsion", "--frames", "3", "--no-pictures", "--out", "rollout"]
    yield "self-contact", ["rollout", "--device", "gpu", "--self-contact", "--frames", "3", "--no-pictures", "--out", "rollout"]
    yield "pleats", ["rollout", "pleats", "--device", "gpu", "--frames", "3", "--no-pictures", "--out", "rollout"]
    yield "bodies", ["rollout", "sphere", "--device", "gpu", "--frames", "3", "--no-pictures", "--out", "rollout"]


def find_program():
    metadata = subprocess.run(
        ["cargo", "metadata", "--format-version", "1", "--no-deps"], cwd=HERE, check=True, capture_output=True
    )
    return pathlib.Path(json.loads(metadata.stdout)["target_directory"]) / "release" / "fnopt"


def environment_of(family, folder):
    """Returns the environment in which the program finds a device of the family, with its own folder."""
    drivers = glob.glob("/usr/share/vulkan/icd.d/radeon_icd*.json")
    if not drivers:
        sys.exit("no driver: Mesa's radeon_icd is missing")
    own = folder / family
    own.mkdir(exist_ok=True)
    return own, {
        **os.environ,
        "VK_DRIVER_FILES": drivers[0],
        "VK_ICD_FILENAMES": drivers[0],
        "VK_LAYER_PATH": str(folder),
        "VK_INSTANCE_LAYERS": "VK_LAYER_FNOPT_static",
        "XDG_RUNTIME_DIR": str(own),
        "MESA_SHADER_CACHE_DISABLE": "true",
        "FNOPT_CACHE": str(own / "cache"),
        "RADV_FORCE_FAMILY": ANY if family in nvidia.FAMILIES else family,
    }


def compiled(program, family, folder):
    """Returns what the compiler says of each pipeline, with the case that built it."""
    own, environment = environment_of(family, folder)
    modules = own / "modules"
    if family in nvidia.FAMILIES:
        modules.mkdir()
        environment["MODULES"] = str(modules)
    (own / "training.toml").write_text(TRAINING)
    pipelines = []
    for case, arguments in cases():
        log = own / "statistics.jsonl"
        log.unlink(missing_ok=True)
        environment["STATISTICS"] = str(log)
        run = subprocess.run([program, *arguments], cwd=own, env=environment, capture_output=True, text=True)
        if run.returncode:
            sys.exit(f"{family}, {case}: exit {run.returncode}\n{run.stderr}")
        of_case = [json.loads(line) for line in log.read_text().splitlines()]
        of_case = [pipeline for pipeline in of_case if pipeline["kernel"] not in OF_WGPU]
        if family in nvidia.FAMILIES:
            for pipeline in of_case:
                spirv = modules / f"{pipeline['module']}.spv"
                pipeline.update(nvidia.statistics(spirv, family, pipeline["workgroup"]))
        pipelines += [(case, pipeline) for pipeline in of_case]
    return pipelines


def rows(family, pipelines):
    """Returns a row for each kernel and workgroup: the worst of its variants."""
    groups = {}
    for case, pipeline in pipelines:
        groups.setdefault((pipeline["kernel"], "x".join(map(str, pipeline["workgroup"]))), []).append((case, pipeline))
    for (kernel, workgroup), variants in sorted(groups.items()):
        _, worst = min(variants, key=lambda v: (v[1]["Subgroups per SIMD"], -v[1]["VGPRs"], -v[1]["Latency"]))
        yield {
            "family": family,
            "kernel": kernel,
            "workgroup": workgroup,
            "lds_bytes": worst["LDS size"],
            "vgprs": worst["VGPRs"],
            "waves": worst["Subgroups per SIMD"],
            "spilled": max(p["Spilled VGPRs"] + p["Spilled SGPRs"] for _, p in variants),
            "scratch_bytes": max(p["Scratch size"] for _, p in variants),
            "instructions": worst["Instructions"],
            "latency_cycles": worst["Latency"],
            "cases": len({case for case, _ in variants}),
        }


def regressions(row, before):
    """Yields what is worse in a row than it was, `before` being None for a kernel that was not there."""
    name = f"{row['family']}: {row['kernel']} {row['workgroup']}"
    for what in ["spilled", "scratch_bytes"]:
        most = int(before[what]) if before else 0
        if row[what] > most:
            yield f"{name}: {what} {row[what]}, not {most}"
    if before and row["waves"] < int(before["waves"]):
        yield f"{name}: waves {row['waves']}, not {before['waves']}"


def predicted(program, folder):
    """Returns the milliseconds of frames by solver, grid and card, with the tile sizes of hardware."""
    own, environment = environment_of(ANY, folder)
    sizes = ["--grid", "32,64,100", "--solver", "fnopt:10,spectral:10"]
    environment["STATISTICS"] = os.devnull
    run = subprocess.run([program, "predict", *sizes, "--json"], cwd=own, env=environment, capture_output=True, text=True)
    if run.returncode:
        sys.exit(f"predict: exit {run.returncode}\n{run.stderr}")
    rows = json.loads(run.stdout)
    return {(r["solver"], r["grid"], r["card"]): (r["dispatches"], r["ms_gaps"], r["ms_per_frame"]) for r in rows}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--families", default="vega10,gfx1100", help="names of RADV_FORCE_FAMILY")
    parser.add_argument("--program", type=pathlib.Path, help="a built fnopt [default: that of the release profile]")
    parser.add_argument("--write", action="store_true", help="replace the families' rows in compilers.csv, and predicted.csv")
    arguments = parser.parse_args()
    program = (arguments.program or find_program()).resolve()

    known = list(csv.DictReader(TABLE.open())) if TABLE.exists() else []
    key = lambda row: (row["family"], row["kernel"], row["workgroup"])
    before = {key(row): row for row in known}
    wrong, new = [], []
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        library = folder / "liblayer.so"
        subprocess.run(["gcc", "-O1", "-shared", "-fPIC", HERE / "layer.c", "-o", library], check=True)
        layer = {"name": "VK_LAYER_FNOPT_static", "type": "GLOBAL", "library_path": str(library), "api_version": "1.3.0",
                 "implementation_version": "1", "description": "Statistics of compilers without their devices"}
        (folder / "layer.json").write_text(json.dumps({"file_format_version": "1.1.2", "layer": layer}))
        families = arguments.families.split(",")
        with concurrent.futures.ThreadPoolExecutor() as pool:
            of_families = list(pool.map(lambda family: compiled(program, family, folder), families))
        for family, pipelines in zip(families, of_families):
            wrong += [f"{family}: {p['kernel']} in {case}: result {p['result']}" for case, p in pipelines if p["result"]]
            of_family = list(rows(family, [(case, p) for case, p in pipelines if not p["result"]]))
            for row in of_family:
                wrong += regressions(row, before.get(key(row)))
            spilling = [f"{row['kernel']} {row['workgroup']}" for row in of_family if row["spilled"] or row["scratch_bytes"]]
            print(f"{family}: {len(pipelines)} pipelines, {len(of_family)} kernels and workgroups; spill: {', '.join(spilling) or 'none'}")
            new += of_family
        frames = predicted(program, folder)
    predictions = list(csv.DictReader(PREDICTED.open())) if PREDICTED.exists() else []
    for row in predictions:
        frame = f"{row['solver']} {row['grid']} on {row['card']}"
        _, _, ms = frames.get((row["solver"], row["grid"], row["card"]), (0, 0.0, None))
        if ms is None:
            wrong.append(f"{frame}: in predicted.csv, and not predicted")
        elif ms > 1.01 * float(row["ms_per_frame"]):
            wrong.append(f"{frame}: {ms:.3f} ms a frame predicted, not {row['ms_per_frame']}")
    if arguments.write:
        with PREDICTED.open("w", newline="") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(["solver", "grid", "card", "dispatches", "ms_gaps", "ms_per_frame"])
            table.writerows([*key, count, f"{gaps:.3f}", f"{ms:.3f}"] for key, (count, gaps, ms) in frames.items())
        kept = [row for row in known if row["family"] not in arguments.families.split(",")]
        with TABLE.open("w", newline="") as file:
            table = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            table.writeheader()
            table.writerows(sorted([*kept, *new], key=key))
    print(*wrong, f"{len(wrong)} wrong", sep="\n")
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
