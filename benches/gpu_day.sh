#!/usr/bin/env bash
# Everything that needs a hardware GPU, in one run: what the machine is, golden files, the tests that need a device, tile sizes,
# frames of all solvers, the same frames in PyTorch where it is installed, and a training step. One log per step, and a summary of
# all that ran, summary.md, with its figures in summary.json.
#
#     benches/gpu_day.sh [OUT] [STEP..]        by default out/gpu_day and all steps, in this order:
#                                              doctor verify tests tune bench half contacts peer training
#
# On a machine without cargo, PROGRAM is a built `fnopt` and TESTS a folder of built test programs. GOLDEN lists further folders of
# golden files. SECONDS_PER_STEP (default 600) limits each step; a step that fails does not stop the others. Exits with 1 if any did.
# GRIDS, BATCHES, SOLVERS and DEVICE say what is timed: `GRIDS=16 BATCHES=1 SOLVERS=spectral DEVICE="--device gpu --adapter llvmpipe"
# benches/gpu_day.sh out/small doctor verify bench` tries the script on a software adapter.
set -uo pipefail
cd "$(dirname "$0")/.."
out=${1:-out/gpu_day}
shift || true
steps=${*:-doctor verify tests tune bench half contacts peer training}
limit=${SECONDS_PER_STEP:-600}
read -ra device <<<"${DEVICE:---device gpu}"
sizes=(--grid "${GRIDS:-32,64,100,256}" --batch "${BATCHES:-1,16,256}" --most-particles 2600000)
mkdir -p "$out"
out=$(cd "$out" && pwd)

program=${PROGRAM:-}
if [[ -z "$program" ]]; then
    cargo build --release --locked || exit 2
    program=$(cargo metadata --format-version 1 --no-deps |
        python3 -c "import json, sys; print(json.load(sys.stdin)['target_directory'])")/release/fnopt
fi

failed=()
: >"$out/steps.tsv"
# Runs one command of a step under its limit; the log ends with its time.
run() {
    local name=$1 start=$SECONDS rc=0
    shift
    timeout "$limit" "$@" >"$out/$name.log" 2>&1 || rc=$?
    echo "[$name: exit $rc after $((SECONDS - start)) s]" | tee -a "$out/$name.log"
    printf '%s\t%s\t%s\n' "$name" "$rc" "$((SECONDS - start))" >>"$out/steps.tsv"
    ((rc == 0)) || failed+=("$name")
    return "$rc"
}

doctor() {
    { nvidia-smi --query-gpu=name,driver_version,memory.total --format=csv || true; } >"$out/card.log" 2>&1
    run doctor "$program" doctor && cat "$out/doctor.log"
}

verify() {
    local folder
    for folder in tests/golden ${GOLDEN:-}; do
        run "verify_$(basename "$(dirname "$folder")")_$(basename "$folder")" "$program" verify "$folder" "${device[@]}"
        run "verify_$(basename "$(dirname "$folder")")_$(basename "$folder")_f16" "$program" verify "$folder" "${device[@]}" --precision f16
    done
}

tests() {
    if [[ -z "${TESTS:-}" ]]; then
        run tests cargo test --release --locked --test gpu --test train
        return
    fi
    local test
    for test in "$TESTS"/*; do
        run "tests_$(basename "$test")" "$test"
        grep -E '^test result|FAILED|panicked' "$out/tests_$(basename "$test").log"
    done
}

tune() {
    run tune "$program" tune --grid 64 && tail -n 3 "$out/tune.log"
}

# Times frames; the figures go to a file of the step's name.
timed() {
    local name=$1
    shift
    # shellcheck disable=SC2016 # The inner shell expands them.
    run "$name" bash -c 'out=$1; shift; exec "$@" --json >"$out"' bash "$out/$name.json" "$program" bench "${device[@]}" "${sizes[@]}" "$@"
}

bench() {
    local solver
    for solver in ${SOLVERS:-fnopt fnopt-paper spectral gd adam lbfgs quasi-newton}; do
        timed "bench_$solver" --solver "$solver"
    done
}

half() {
    timed bench_fnopt_f16 --precision f16
}

# Scenes with bodies and layers that press, and the test that a fine twist never passes through itself.
contacts() {
    local scene
    for scene in twist sphere table; do
        run "contacts_$scene" "$program" rollout "$scene" "${device[@]}" --grid 64 --solver spectral --iterations 20 --intersections \
            --no-pictures --out "$out/$scene"
        grep -E 'ms/frame|intersections' "$out/contacts_$scene.log"
    done
    if [[ -z "${TESTS:-}" ]]; then
        run contacts_tests cargo test --release --locked --test gpu -- --ignored
    else
        for test in "$TESTS"/*; do
            run "contacts_tests_$(basename "$test")" "$test" --ignored
        done
    fi
}

peer() {
    if ! python3 -c "import torch, numpy, safetensors" 2>/dev/null; then
        echo "skipped: PyTorch, numpy or safetensors is missing"
        return
    fi
    run peer python3 benches/peers/compare.py --device cuda --modes "${MODES:-eager,graph,compiled}" --rounds 2 --program "$program" \
        --markdown "$out/peer.md"
    cat "$out/peer.log"
}

# Steps per second of the paper's recipe, after those in which kernels are compiled.
training() {
    run training_first "$program" train "${device[@]}" --out "$out/run" --steps 20
    local start
    start=$(date +%s.%N)
    run training "$program" train "${device[@]}" --resume "$out/run" --steps 520 &&
        awk -v a="$start" -v b="$(date +%s.%N)" 'BEGIN { printf "%.1f steps/s, start included\n", 500 / (b - a) }' |
            tee -a "$out/training.log"
    tail -n 2 "$out/run/metrics.csv"
}

for step in $steps; do
    echo "== $step ($SECONDS s)"
    "$step"
done

if command -v python3 >/dev/null; then
    python3 - "$out" "$(git rev-parse --short HEAD 2>/dev/null || true)" <<'END' || failed+=(summary)
import json, pathlib, sys
out, commit = pathlib.Path(sys.argv[1]), sys.argv[2]
steps = [dict(zip(("step", "exit", "seconds"), (name, int(rc), int(seconds))))
         for name, rc, seconds in (line.split("\t") for line in (out / "steps.tsv").read_text().splitlines())]
benches = {}
for step in steps:
    file = out / f"{step['step']}.json"
    if file.is_file() and file.stat().st_size:
        benches[step["step"]] = json.loads(file.read_text())
summary = {"commit": commit, "steps": steps, "benches": benches}
(out / "summary.json").write_text(json.dumps(summary, indent=1) + "\n")
first = next(iter(benches.values()), {})
lines = ["# GPU day", "", f"fnopt {first.get('version', '?')}, commit {commit or '?'}, on {first.get('device', '?')} ({first.get('system', '?')})", "",
         "| step | exit | s |", "|---|---:|---:|"]
lines += [f"| {s['step']} | {s['exit']} | {s['seconds']} |" for s in steps]
if benches:
    lines += ["", "| solver | grid | cloths | iterations | ms/frame | least | together | dispatches |", "|---|---|---:|---:|---:|---:|---:|---:|"]
for name, bench in benches.items():
    for row in bench["rows"]:
        number = lambda field, digits=3: "" if row.get(field) is None else f"{row[field]:.{digits}f}"
        lines.append(f"| {name.removeprefix('bench_')} | {row['grid']} | {row['batch']} | {number('iterations', 0)} | {number('ms_per_frame')} | "
                     f"{number('ms_least')} | {number('ms_together')} | {number('dispatches', 0)} |")
    lines += [f"| {name.removeprefix('bench_')} | {of['grid']} | {of['batch']} | | {of['error']} | | | |" for of in bench.get("failures", [])]
for log in ("doctor", "tune", "training", "peer"):
    if any(step["step"] == log for step in steps):
        file = out / f"{log}.log"
        lines += ["", f"## {log}", "", "```", *file.read_text(errors="replace").splitlines()[-40:], "```"]
(out / "summary.md").write_text("\n".join(lines) + "\n")
print(f"summary: {out / 'summary.md'}")
END
fi
if ((${#failed[@]})); then
    echo "failed: ${failed[*]}"
    exit 1
fi
