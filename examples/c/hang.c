/* A sheet hangs from two corners; a wind blows, and one corner is led upwards. `tests/c/run.sh` builds and runs it. */

#include "fnopt.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

/* Ends the program with the status of a call that failed. */
static void check(FnoptStatus status) {
    if (status != FNOPT_STATUS_DONE) {
        fprintf(stderr, "error: %s\n", fnopt_last_error());
        exit(status);
    }
}

int main(void) {
    FnoptScene *scene;
    check(fnopt_scene_parse("{\"grid\": [32, 32], \"motion\": \"none\"}", NULL, &scene));

    const FnoptOptions options = {.solver = "spectral", .device = "cpu"};
    const FnoptScene *scenes[] = {scene};
    FnoptSimulation *simulation;
    check(fnopt_simulation_new(scenes, 1, &options, &simulation));
    fnopt_scene_free(scene);

    size_t count = 3 * fnopt_particles(simulation);
    float *positions = malloc(count * sizeof *positions);
    uint32_t held[2];
    if (positions == NULL || fnopt_handles(simulation, held, 2) != 2) return 1;
    check(fnopt_positions(simulation, positions, count));

    double targets[6];
    for (int k = 0; k < 6; ++k) targets[k] = positions[3 * held[k / 3] + k % 3];
    const double top = targets[1], wind[3] = {2.0, 0.0, 0.0};
    const FnoptControl control = {.handles = targets, .handle_count = 2, .wind = wind};
    for (int frame = 1; frame <= 60; ++frame) {
        targets[1] = top + 0.2 * frame / 60.0; /* 20 cm in a second */
        check(fnopt_step(simulation, &control));
    }

    check(fnopt_positions(simulation, positions, count));
    double lowest = INFINITY;
    for (size_t p = 0; p < count; p += 3) lowest = fmin(lowest, positions[p + 1]);
    FnoptStats stats;
    check(fnopt_stats(simulation, &stats, 1));
    printf("fnopt %s, frame %zu, %.2f s: lowest point %.3f m, led corner at %.3f m, mean stretch %.2f %%\n", fnopt_version(),
           fnopt_frame(simulation), fnopt_frame(simulation) * fnopt_frame_time(simulation), lowest,
           positions[3 * held[0] + 1], 100.0 * stats.stretch_mean);

    free(positions);
    fnopt_simulation_free(simulation);
    return 0;
}
