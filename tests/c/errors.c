/* What the C interface does with wrong arguments and with states that it is given. */

#include "fnopt.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define EXPECT(condition) \
    do { \
        if (!(condition)) { \
            fprintf(stderr, "%s:%d: expected %s; last error: %s\n", __FILE__, __LINE__, #condition, fnopt_last_error()); \
            exit(1); \
        } \
    } while (0)

static int said(const char *text) { return strstr(fnopt_last_error(), text) != NULL; }

static FnoptSimulation *simulation_of(const char *json, size_t cloths, const char *solver) {
    FnoptScene *scene = NULL;
    EXPECT(fnopt_scene_parse(json, NULL, &scene) == FNOPT_STATUS_DONE);
    const FnoptScene *scenes[4] = {scene, scene, scene, scene};
    const FnoptOptions options = {.solver = solver, .device = "cpu"};
    FnoptSimulation *simulation = NULL;
    EXPECT(fnopt_simulation_new(scenes, cloths, &options, &simulation) == FNOPT_STATUS_DONE);
    fnopt_scene_free(scene);
    return simulation;
}

int main(void) {
    EXPECT(strcmp(fnopt_last_error(), "") == 0);
    FnoptScene *scene = NULL;
    EXPECT(fnopt_scene_load("spere", &scene) == FNOPT_STATUS_BAD_INPUT && said("did you mean sphere"));
    EXPECT(fnopt_scene_load("no/such.json", &scene) == FNOPT_STATUS_BAD_INPUT && said("no/such.json: cannot read"));
    EXPECT(fnopt_scene_load(NULL, &scene) == FNOPT_STATUS_BAD_INPUT && said("path: expected a pointer"));
    EXPECT(fnopt_scene_load("\xff", &scene) == FNOPT_STATUS_BAD_INPUT && said("expected UTF-8"));
    EXPECT(fnopt_scene_parse("{\"grd\": 3}", NULL, &scene) == FNOPT_STATUS_BAD_INPUT && said("did you mean grid"));
    EXPECT(fnopt_scene_default(NULL) == FNOPT_STATUS_BAD_INPUT && said("scene: expected a pointer"));
    EXPECT(scene == NULL);

    EXPECT(fnopt_scene_load("twist", &scene) == FNOPT_STATUS_DONE);
    EXPECT(fnopt_scene_set_grid(scene, 3, 3) == FNOPT_STATUS_BAD_INPUT && said("expected 8 to 4096"));
    EXPECT(fnopt_scene_set_frames(scene, 0) == FNOPT_STATUS_BAD_INPUT && said("frames"));
    EXPECT(fnopt_scene_set_grid(scene, 16, 16) == FNOPT_STATUS_DONE);
    EXPECT(fnopt_scene_set_frames(scene, 10) == FNOPT_STATUS_DONE);

    FnoptSimulation *simulation = NULL;
    const FnoptScene *scenes[] = {scene, NULL};
    const FnoptOptions wrong = {.device = "cuda"};
    EXPECT(fnopt_simulation_new(scenes, 2, NULL, &simulation) == FNOPT_STATUS_BAD_INPUT && said("scenes"));
    EXPECT(fnopt_simulation_new(scenes, 1, &wrong, &simulation) == FNOPT_STATUS_BAD_INPUT && said("unknown device 'cuda'"));
    EXPECT(fnopt_simulation_new(scenes, 0, NULL, &simulation) == FNOPT_STATUS_BAD_INPUT && said("at least one"));
    EXPECT(simulation == NULL && fnopt_cloths(NULL) == 0 && fnopt_step(NULL, NULL) == FNOPT_STATUS_BAD_INPUT);
    const FnoptOptions options = {.solver = "spectral", .device = "cpu", .iterations = 5};
    EXPECT(fnopt_simulation_new(scenes, 1, &options, &simulation) == FNOPT_STATUS_DONE);
    EXPECT(fnopt_frames(simulation) == 10 && fnopt_particles(simulation) == 256 && fnopt_cloths(simulation) == 1);
    for (int frame = 1; frame <= 12; ++frame) EXPECT(fnopt_step(simulation, NULL) == FNOPT_STATUS_DONE);
    EXPECT(fnopt_frame(simulation) == 12);
    fnopt_simulation_free(simulation);
    fnopt_scene_free(scene);

    /* Two cloths, of which one is moved. */
    simulation = simulation_of("{\"grid\": [8, 9]}", 2, "spectral");
    static float buffer[2 * 72 * 3], moved[2 * 72 * 3];
    static double positions[72 * 3];
    EXPECT(fnopt_positions(simulation, buffer, 72 * 3) == FNOPT_STATUS_BAD_INPUT && said("room for 432 numbers"));
    EXPECT(fnopt_positions(simulation, buffer, 432) == FNOPT_STATUS_DONE);
    EXPECT(memcmp(buffer, buffer + 216, 216 * sizeof *buffer) == 0);
    for (int k = 0; k < 216; ++k) positions[k] = buffer[k] + 1.0;
    EXPECT(fnopt_set_state(simulation, 2, positions, NULL, 216) == FNOPT_STATUS_BAD_INPUT && said("cloth: expected 0 to 1"));
    EXPECT(fnopt_set_state(simulation, 1, positions, NULL, 215) == FNOPT_STATUS_BAD_INPUT && said("count: expected 216"));
    EXPECT(fnopt_set_state(simulation, 1, positions, NULL, 216) == FNOPT_STATUS_DONE);
    EXPECT(fnopt_positions(simulation, moved, 432) == FNOPT_STATUS_DONE);
    for (int k = 0; k < 216; ++k) EXPECT(moved[k] == buffer[k] && fabs(moved[216 + k] - buffer[k] - 1.0) < 1e-5);
    const double one_target[3] = {0};
    const FnoptControl control = {.handles = one_target, .handle_count = 1};
    EXPECT(fnopt_step(simulation, &control) == FNOPT_STATUS_BAD_INPUT && said("control: handles: expected 4, one for each handle of all cloths together, found 1"));
    uint32_t held[4], faces[2 * 7 * 8][3];
    EXPECT(fnopt_handles(simulation, NULL, 0) == 4 && fnopt_handles(simulation, held, 4) == 4);
    EXPECT(held[0] == 63 && held[1] == 0 && held[2] == 63 && held[3] == 0);
    EXPECT(fnopt_faces(simulation, &faces[0][0], 2 * 7 * 8 * 3) == 2 * 7 * 8 && faces[111][0] < 72);
    EXPECT(fnopt_reset(simulation) == FNOPT_STATUS_DONE);
    EXPECT(fnopt_positions(simulation, moved, 432) == FNOPT_STATUS_DONE && memcmp(buffer, moved, sizeof buffer) == 0);
    fnopt_simulation_free(simulation);

    /* A ball that the host leads. */
    simulation = simulation_of("{\"grid\": [8, 9], \"bodies\": [{\"shape\": \"sphere\", \"radius_m\": 0.1, \"position_m\": [3, 0, 0]}]}", 2, "spectral");
    double poses[14] = {3, 0.5, 0, 0, 0, 0, 2, 4, 0, 0, 0, 0, 0, 1}, found[14];
    const FnoptControl led = {.bodies = poses, .body_count = 2}, short_of_one = {.bodies = poses, .body_count = 1};
    EXPECT(fnopt_step(simulation, &short_of_one) == FNOPT_STATUS_BAD_INPUT && said("bodies: expected 2"));
    EXPECT(fnopt_step(simulation, &led) == FNOPT_STATUS_DONE);
    EXPECT(fnopt_bodies(simulation, NULL, 0) == 2 && fnopt_bodies(simulation, found, 14) == 2);
    poses[6] = 1;
    for (int k = 0; k < 14; ++k) EXPECT(fabs(found[k] - poses[k]) < 1e-12);
    fnopt_simulation_free(simulation);

    /* One that explodes. */
    simulation = simulation_of("{\"grid\": [8, 9]}", 1, "gd");
    for (int k = 0; k < 216; ++k) positions[k] *= 1e18;
    EXPECT(fnopt_set_state(simulation, 0, positions, NULL, 216) == FNOPT_STATUS_DONE);
    FnoptStatus status = FNOPT_STATUS_DONE;
    for (int frame = 0; frame < 50 && status == FNOPT_STATUS_DONE; ++frame) status = fnopt_step(simulation, NULL);
    EXPECT(status == FNOPT_STATUS_NON_FINITE && said("cloth 0 became non-finite"));
    EXPECT(fnopt_reset(simulation) == FNOPT_STATUS_DONE && fnopt_step(simulation, NULL) == FNOPT_STATUS_DONE);
    fnopt_simulation_free(simulation);
    puts("errors: done");
    return 0;
}
