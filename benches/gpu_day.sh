#!/usr/bin/env bash
# Everything that needs a hardware GPU, in one run: what the machine is, golden files, the tests that need a device, tile sizes,
# frames of all solvers, the same frames in PyTorch, and a training step. One log per step, and a summary.
#
#     benches/gpu_day.sh [OUT] [STEP..]        by default out/gpu_day and all steps, in this order:
#                                              doctor verify tests tune bench half contacts peer training
#
# On a machine without cargo, PROGRAM is a built `fnopt` and TESTS a folder of built test programs. GOLDEN lists further folders of
# golden files. SECONDS_PER_STEP (default 600) limits each step; a step that fails does not stop the others. Exits with 1 if any did.
set -uo pipefail
cd "$(dirname "$0")/.."
out=${1:-out/gpu_day}
shift || true
steps=${*:-doctor verify tests tune bench half contacts peer training}
limit=${SECONDS_PER_STEP:-600}
mkdir -p "$out"
out=$(cd "$out" && pwd)

program=${PROGRAM:-}
if [[ -z "$program" ]]; then
    cargo build --release --locked || exit 2
    program=$(cargo metadata --format-version 1 --no-deps |
        python3 -c "import json, sys; print(json.load(sys.stdin)['target_directory'])")/release/fnopt
fi

failed=()
# Runs one command of a step under its limit; the log ends with its time.
run() {
    local name=$1 start=$SECONDS rc=0
    shift
    timeout "$limit" "$@" >"$out/$name.log" 2>&1 || rc=$?
    echo "[$name: exit $rc after $((SECONDS - start)) s]" | tee -a "$out/$name.log"
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
        run "verify_$(basename "$(dirname "$folder")")_$(basename "$folder")" "$program" verify "$folder" --device gpu
        run "verify_$(basename "$(dirname "$folder")")_$(basename "$folder")_f16" "$program" verify "$folder" --device gpu --precision f16
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

bench() {
    local solver
    for solver in fnopt fnopt-paper spectral gd adam lbfgs quasi-newton; do
        run "bench_$solver" "$program" bench --device gpu --solver "$solver" --grid 32,64,100 --batch 1,16,256
        cat "$out/bench_$solver.log"
    done
}

half() {
    run bench_fnopt_f16 "$program" bench --device gpu --precision f16 --grid 32,64,100 --batch 1,16,256
    cat "$out/bench_fnopt_f16.log"
}

# Scenes with bodies and layers that press, and the test that a fine twist never passes through itself.
contacts() {
    local scene
    for scene in twist sphere table; do
        run "contacts_$scene" "$program" rollout "$scene" --device gpu --grid 64 --solver spectral --iterations 20 --intersections \
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
    run peer python3 benches/peers/compare.py --device cuda --modes "${MODES:-eager,graph,compiled}" --rounds 2 --program "$program" \
        --markdown "$out/peer.md"
    cat "$out/peer.log"
}

# Steps per second of the paper's recipe, after those in which kernels are compiled.
training() {
    run training_first "$program" train --device gpu --out "$out/run" --steps 20
    local start
    start=$(date +%s.%N)
    run training "$program" train --device gpu --resume "$out/run" --steps 520 &&
        awk -v a="$start" -v b="$(date +%s.%N)" 'BEGIN { printf "%.1f steps/s, start included\n", 500 / (b - a) }' |
            tee -a "$out/training.log"
    tail -n 2 "$out/run/metrics.csv"
}

for step in $steps; do
    echo "== $step ($SECONDS s)"
    "$step"
done
if ((${#failed[@]})); then
    echo "failed: ${failed[*]}"
    exit 1
fi
